"""One carrier and three aerial robots: released one after the other, they share the work and meet again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from onboard.mission import Phase
from simulation.mission import Mission
from tests.simulation.small_mission import Event, flock, played, quarters

FLYERS = ("aerial-0", "aerial-1", "aerial-2")


@pytest.fixture(scope="module")
def flown() -> tuple[Mission, list[Event]]:
    return played(flock(3, 100.0), quarters())


def test_all_three_are_released_one_after_the_other_from_the_same_carrier(flown):
    _, events = flown
    releases = [(time_s, fields["deployed"]) for time_s, kind, fields in events if kind == "release"]
    assert [name for _, name in releases] == list(FLYERS)
    assert all(later - sooner > 2.0 for (sooner, _), (later, _) in itertools.pairwise(releases))


def test_everybody_explores_meets_and_has_everything_of_everybody(flown):
    mission, events = flown
    assert [agent.core.phase for agent in mission.agents] == [Phase.DONE] * 4
    for name in FLYERS:
        phases = [f["phase"] for _, kind, f in events if kind == "phase" and f["robot"] == name]
        assert phases[:3] == ["ready", "taking_off", "exploring"]
    stores = [{(k.source, k.sequence) for k in agent.core.link.store} for agent in mission.agents]
    assert stores[0] == stores[1] == stores[2] == stores[3]
    assert {source for source, _ in stores[0]} == {1, 2, 3, 4}


def test_nobody_touched_the_world_or_another_robot(flown):
    mission, _ = flown
    assert mission.meetings == 0
    assert [agent.body.collisions for agent in mission.agents] == [0] * 4


def test_flying_robots_bid_and_keep_apart(flown):
    mission, _ = flown
    assert all(agent.core.link.bytes_sent["bids"] > 0 for agent in mission.agents[1:])
    paths = [np.array(agent.path)[:, 1:] for agent in mission.agents[1:]]
    both_out = [np.abs(np.diff(path, axis=0)).sum(axis=1) > 0 for path in paths]
    for (a, out_a), (b, out_b) in itertools.combinations(zip(paths, both_out, strict=True), 2):
        together = out_a[: len(out_b)] & out_b[: len(out_a)]
        gaps = np.linalg.norm(a[1:][: len(together)] - b[1:][: len(together)], axis=1)
        assert gaps[together].min() > 0.38
