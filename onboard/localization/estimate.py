"""What the odometry says after a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose

Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Outcome of one step.

    `pose` is the sensor in the odometry frame (the first scan's sensor frame) at the scan's stamp, `twist`
    (6,) its velocity and turn rate in its own frame. `covariance` (6, 6) of the small motion (metres,
    radians, in the sensor's frame) from the true pose relative to the first scan. `degenerate` (k, 6):
    directions of such motions in which the scan tells nothing and the pose is that of the prediction. `ok`
    false: the scan did not fit, for the `reason` given; the pose is the prediction, or the last one where
    nothing was predicted. `jump`: the pose is not where prediction or motion led to. `points` are the scan's
    finite points, motion within the sweep taken out; `inlier_ratio` is the share of its thinned points that
    lie on a plane of the map.
    """

    stamp_s: float
    pose: Pose
    covariance: FloatArray
    twist: FloatArray
    degenerate: FloatArray
    ok: bool
    jump: bool
    reason: str
    inlier_ratio: float
    points: Points
