"""Gate, driver and bracket together: the latch moves only while every condition of the release holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from bracket_bench import Bench
from release_cases import RELEASE, RELEASE_VIOLATIONS

from drivers.bracket_types import State
from onboard.safety import Verdict, allow_release

OF_THE_BRACKET = ("bracket", "bracket_stamp_s")


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    bench.run(0.6)
    yield bench
    bench.close()


def verdict(bench: Bench, change: dict[str, Any]) -> Verdict:
    """The gate's answer to what the bracket reports, and good facts but for a change."""
    report, facts = bench.host.report(), {"bracket": bench.host.report().state.name}
    age_s = None if report.heartbeat_s is None else report.heartbeat_s - bench.now_s
    return allow_release(replace(RELEASE, **facts, **({"bracket_stamp_s": age_s} | change)))


def gated(bench: Bench, seconds: float, change: dict[str, Any]) -> None:
    for _ in range(round(seconds / bench.step_s)):
        bench.tick(permitted=verdict(bench, change).ok)


def test_with_all_conditions_it_opens(bench):
    gated(bench, 1.0, {})
    assert bench.host.report().is_open


def test_with_any_condition_violated_it_never_moves(bench):
    for _, change in RELEASE_VIOLATIONS:
        if not change.keys() & set(OF_THE_BRACKET):
            gated(bench, 1.0, change)
    assert bench.node.state == State.LOCKED
    assert bench.node.latch.position == 0.0
    assert bench.sent("BracketArm") == []


def test_a_condition_that_ends_between_the_steps_ends_the_release(bench):
    for _, change in RELEASE_VIOLATIONS:
        if change.keys() & set(OF_THE_BRACKET):
            continue
        assert verdict(bench, {})
        bench.until_sent("BracketArm", len(bench.sent("BracketArm")) + 1)
        gated(bench, 0.1, change)
        assert bench.node.state == State.LOCKED, change
        assert not bench.node.energised
        gated(bench, 0.2, change)
    assert bench.node.latch.position == 0.0
    assert bench.sent("BracketLock") != []
    assert bench.sent("BracketFire") == []
