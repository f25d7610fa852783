"""The fuzzer itself: its streams are damaged, counted and judged."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.codec import fuzz
from onboard.codec import Keyframe, encode
from onboard.core.errors import CodecError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16


@pytest.mark.parametrize(("codecs", "count"), [(("quadtree",), 2500), (fuzz.CODECS, 500)])
def test_a_few_thousand_streams_are_refused_or_sound(codecs: tuple[str, ...], count: int) -> None:
    outcome = fuzz.attack(count, 5, codecs)
    assert outcome.refused + outcome.decoded == count
    assert outcome.refused > count / 4
    assert outcome.decoded > 0
    assert outcome.slowest_ms > 0


def test_streams_differ_and_follow_from_the_seed() -> None:
    one, two = fuzz.Fuzzer(1), fuzz.Fuzzer(1)
    streams = [one.stream(number) for number in range(20)]
    assert streams[5:] == [two.stream(number) for number in range(5, 20)]
    assert len(set(streams)) == 20


def test_a_run_can_be_split_and_tells_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []
    first = fuzz.attack(15, 3, ("quadtree",), report=lambda number, _: told.append(number))
    second = fuzz.attack(15, 3, ("quadtree",), start=15, report=lambda number, _: told.append(number))
    whole = fuzz.attack(30, 3, ("quadtree",))
    assert first.refused + second.refused == whole.refused
    assert told == list(range(1, 31))
    monkeypatch.setattr(fuzz, "REPORT_S", 0.0)
    with fuzz.console.capture() as captured, fuzz.console.status("") as status:
        fuzz.Reporter(30, status)(7, whole)
    assert f"stream 7 of 30: {whole.refused} refused" in captured.get()


def test_sound_keyframes_survive() -> None:
    data = encode(fuzz.made_up_scan(VLP_16, 3), Pose.identity())
    assert fuzz.Fuzzer(1).survives(data)


def test_ranges_beyond_reason_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = Keyframe(OS0_64, "quadtree", Pose.identity(), np.full((64, 512), 99.0, np.float32))
    fuzzer = fuzz.Fuzzer(1)
    monkeypatch.setattr(fuzz, "decode", lambda *_: broken)
    with pytest.raises(AssertionError, match="beyond reason: 00ff"):
        fuzzer.survives(b"\x00\xff")


def test_other_errors_are_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> Keyframe:
        raise IndexError("out of the image")

    fuzzer = fuzz.Fuzzer(1)
    monkeypatch.setattr(fuzz, "decode", fail)
    with pytest.raises(IndexError):
        fuzzer.survives(b"")
    monkeypatch.setattr(fuzz, "decode", lambda *_: (_ for _ in ()).throw(CodecError("no")))
    assert not fuzzer.survives(b"")


@pytest.mark.parametrize(("limit", "code"), [("1e9", 0), ("0", 1)])
def test_the_exit_code_tells(limit: str, code: int) -> None:
    assert fuzz.main(["--count", "20", "--limit-ms", limit, "--limit-mb", "1e9", "--start", "7"]) == code
