"""A made-up run in a two-level building, for the tests of report and exports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground_station.record import Marker, RunRecord

VOXEL_M = 0.2
LENGTH_M, WIDTH_M, STOREY_M = 40.0, 24.0, 3.4


def _grid(low: tuple[float, ...], high: tuple[float, ...]) -> NDArray[np.float32]:
    """Voxel centres of a box given in metres."""
    axes = [
        np.arange(round(a / VOXEL_M), max(round(b / VOXEL_M), round(a / VOXEL_M) + 1))
        for a, b in zip(low, high, strict=True)
    ]
    return ((np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * VOXEL_M).astype(
        np.float32
    )


def _storey(floor_m: float) -> NDArray[np.float32]:
    top = floor_m + STOREY_M
    walls = [_grid((x, 0, floor_m), (x + 0.2, WIDTH_M, top)) for x in (0, LENGTH_M)]
    walls += [_grid((0, y, floor_m), (LENGTH_M, y + 0.2, top)) for y in (0, WIDTH_M)]
    walls += [_grid((0, y, floor_m), (LENGTH_M, y + 0.2, top)) for y in (10, 13.4)]
    walls += [_grid((x, 0, floor_m), (x + 0.2, 9, top)) for x in (8, 16, 24, 32)]
    walls += [_grid((x, 14.4, floor_m), (x + 0.2, WIDTH_M, top)) for x in (10, 20, 30)]
    slab = _grid((0, 0, floor_m - 0.2), (LENGTH_M, WIDTH_M, floor_m))
    return np.concatenate([*walls, slab])


def _path(points: list[tuple[float, float, float]], start_s: float, speed_m_s: float) -> NDArray[np.float64]:
    corners = np.array(points)
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    along = np.arange(0, arc[-1], speed_m_s * 0.5)
    columns = [np.interp(along, arc, corners[:, axis]) for axis in range(3)]
    return np.stack([start_s + along / speed_m_s, *columns], axis=1)


def _building_record(**changes: Any) -> RunRecord:
    """Ground robot on the lower floor, aerial robot on the upper one; `changes` replace fields."""
    rng = np.random.default_rng(7)
    occupied = np.unique(np.concatenate([_storey(0.0), _storey(STOREY_M)]), axis=0)
    noise = rng.normal(0, 1.5, len(occupied))
    ground = (occupied[:, 2] < STOREY_M) & (occupied[:, 0] < 30 + noise)
    aerial = (occupied[:, 2] > STOREY_M - 0.3) | (occupied[:, 0] > 18 + noise)
    seen_by = (ground + 2 * aerial).astype(np.uint8)
    time_s = np.arange(0.0, 600.0, 2.0)
    union = 4000 * (1 - np.exp(-time_s / 220))
    paths = {
        "ground": _path([(2, 12, 0), (36, 12, 0), (36, 20, 0), (36, 12, 0), (8, 12, 0), (8, 6, 0)], 0, 0.35),
        "aerial": _path(
            [(30, 12, 1), (38, 12, 1.4), (38, 12, 5), (4, 12, 5), (4, 20, 5), (4, 12, 5), (20, 5, 5)],
            240,
            0.8,
        ),
    }
    values: dict[str, Any] = {
        "title": "building, seed 1",
        "metrics": {
            "explored_m3": {"ground": 2210.4, "aerial": 1990.0, "union": 3800.2},
            "robots": {
                "ground": {"path_m": 91.2, "battery_wh": 801.0},
                "aerial": {"path_m": 120.0, "battery_wh": 31.0},
            },
            "overlap_ratio": 0.104,
            "replans": 311,
            "radio": {"sent_bytes": 812_345, "lost_frames": 12},
        },
        "parameters": {
            "mission": {"duration_s": 600.0},
            "robots": [{"name": "ground", "size_m": [0.9, 0.5, 0.8]}],
        },
        "timeline": {
            "time_s": time_s.tolist(),
            "explored_m3/ground": (union * 0.6).tolist(),
            "explored_m3/aerial": (np.clip(time_s - 240, 0, None) * 4.5).tolist(),
            "explored_m3/union": union.tolist(),
            "bytes/keyframe": (time_s * 900).tolist(),
            "bytes/digest": (time_s * 210).tolist(),
            "bytes/status": (time_s * 60).tolist(),
        },
        "paths": paths,
        "occupied": occupied,
        "seen_by": seen_by,
        "robots": ["ground", "aerial"],
        "markers": [
            Marker("start of the mission", "start", (2, 12, 0), 0.0),
            Marker("aerial released", "deploy", (30, 12, 1), 240.0),
            Marker("first target of aerial", "target", (38, 12, 5), 240.0),
            Marker("contact, maps exchanged", "regroup", (20, 5, 5), 520.0),
            Marker("ground back at the start", "home", (8, 6, 0), 598.0),
        ],
        "complete": True,
    }
    return RunRecord(**(values | changes))


@pytest.fixture(scope="session")
def building_record() -> Callable[..., RunRecord]:
    """Makes a run in a two-storey building; keyword arguments replace fields."""
    return _building_record
