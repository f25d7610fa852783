"""Measuring the codec: the numbers of the table and the picture."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground_station.codec_files import PosedScan
from ground_station.codec_scores import Score, Setting, draw, measure, plain, settings_for, similarity
from onboard.codec import decode, encode
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import VLP_16, Scan

SCORE = Score("auto, 100 B", 2, 99.0, 0.9, 0.01, 0.8, 20.0, 3.0)


def wall(distance_m: float) -> PosedScan:
    with np.errstate(divide="ignore"):
        ranges = distance_m / np.abs(VLP_16.directions[..., 0].astype(np.float64))
    return PosedScan(Scan(0.0, np.minimum(ranges, 18.0).astype(np.float32), VLP_16), Pose.identity())


def test_settings() -> None:
    assert settings_for("auto", [100, 200]) == [Setting("auto", 100), Setting("auto", 200)]
    assert settings_for("exact", [100, 200]) == [Setting("exact", None)]
    assert settings_for("quadtree", []) == [Setting("quadtree", None)]
    assert [setting.label for setting in (Setting("auto", 100), Setting("exact", None))] == [
        "auto, 100 B",
        "exact",
    ]


def test_means_over_scans_and_progress() -> None:
    scans, told = [wall(3.0), wall(5.0)], []
    (score,) = measure(scans, [Setting("quadtree", 150)], lambda *numbers: told.append(numbers))
    decoded = [(item, encode(item.scan, item.pose, codec="quadtree", budget_bytes=150)) for item in scans]
    expected = [similarity(item, decode(data)) for item, data in decoded]
    assert score.scans == 2
    assert score.bytes == np.mean([len(data) for _, data in decoded])
    assert score.f1 == pytest.approx(np.mean([s.f1 for s in expected]))
    assert score.unsafe26 == pytest.approx(np.mean([s.unsafe26 for s in expected]))
    assert score.free_iou == pytest.approx(np.mean([s.free_iou for s in expected]))
    assert score.encode_ms > 0 < score.decode_ms
    assert told == [(1, 2), (2, 2)]
    assert plain([score])[0]["bytes"] == score.bytes


def test_a_scan_is_like_itself() -> None:
    item = wall(3.0)
    keyframe = decode(encode(item.scan, item.pose))
    same = similarity(PosedScan(Scan(0.0, keyframe.ranges, VLP_16), keyframe.pose), keyframe)
    assert (same.f1, same.unsafe26, same.free_iou) == (1.0, 0.0, 1.0)


def test_the_picture(tmp_path: Path) -> None:
    draw([SCORE], tmp_path / "a.png", "two scans")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="cannot write there"):
        draw([SCORE], tmp_path / "absent" / "a.png", "two scans")


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"marsupial\[station\]"):
        draw([SCORE], tmp_path / "a.png", "two scans")
