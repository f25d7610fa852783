"""What one run leaves behind: the data that the report and the exports are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MarkerKind = Literal["start", "deploy", "target", "regroup", "home"]


@dataclass(frozen=True)
class Marker:
    """A place and moment worth showing on the map; `position` in metres in the world frame (ENU)."""

    label: str
    kind: MarkerKind
    position: tuple[float, float, float]
    time_s: float


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Everything about one run, finished or not.

    `timeline` holds equally long series: 'time_s', 'explored_m3/<robot>', 'explored_m3/union' and
    'bytes/<kind>' (cumulative bytes sent by all robots). `paths` maps a robot to (N, 4) t, x, y, z.
    `occupied` is (N, 3), the voxel centres of the merged map in metres; bit i of `seen_by` (N,) says
    that `robots[i]` saw the voxel. `complete` is false for a run that ended early: interrupted, or out of
    time before everybody was back.
    """

    title: str
    metrics: dict[str, Any]
    parameters: dict[str, Any]
    timeline: dict[str, list[float]]
    paths: dict[str, NDArray[np.float64]]
    occupied: NDArray[np.float32]
    seen_by: NDArray[np.uint8]
    robots: list[str]
    markers: list[Marker]
    complete: bool
