"""Our pose for the vehicle's estimator: a steady stream of ODOMETRY that never jumps.

Between scans the pose is predicted, and every sample is of the moment in which it is sent. So it is right
both before TIMESYNC has converged, when a PX4 takes the time of arrival for the sample's, and after, when the
stamp counts: no delay is left to be configured (EKF2_EV_DELAY 0).

A jump of the source (a closed loop, a new estimate) moves the map, not the robot. It goes into a bridge
between the two frames; the vehicle sees no jump, and setpoints go over the same bridge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from drivers.mavlink.dialect import message
from drivers.mavlink.frames import Bridge, Pose, Vector, into_body, minus, swap, to_ned

LOCAL_NED, BODY_FRD, VIO = 1, 12, 3
"""MAV_FRAME and MAV_ESTIMATOR_TYPE: a PX4 refuses LIDAR (8), and headings in LOCAL_FRD do not let it arm."""


@dataclass(frozen=True)
class FeedSettings:
    """How the pose is streamed, and what counts as a jump."""

    rate_hz: float = 30.0
    horizon_s: float = 0.35
    """A pose older than this is not predicted any further: the vehicle shall notice that it is blind."""
    jump_m: float = 0.35
    jump_rad: float = 0.35
    jump_m_s2: float = 4.0
    """Acceleration that the prediction between two poses does not know."""
    gap_s: float = 1.0
    """After a longer silence nobody knows how far the robot went: poses are taken as they come."""


class PoseFeed:
    """Keeps the newest pose and the bridge between the map's frame and the vehicle's."""

    def __init__(self, settings: FeedSettings | None = None) -> None:
        self._settings = settings or FeedSettings()
        self._pose: Pose | None = None
        self._due_s = -math.inf
        self.bridge = Bridge()
        self.reset_counter = 0
        """Tells the vehicle to take the next pose as it is."""
        self.jumps = 0
        self.jump_s = -math.inf

    @property
    def pose(self) -> Pose | None:
        """The newest pose, as it came."""
        return self._pose

    def update(self, pose: Pose) -> bool:
        """Take a new pose. Returns whether the map has jumped; older ones than the newest are ignored."""
        before = self._pose
        if before is None:
            self._pose = pose
            return False
        gap_s = pose.stamp_s - before.stamp_s
        if gap_s <= 0.0:
            return False
        self._pose = pose
        if gap_s > self._settings.gap_s:
            self.reset_counter = (self.reset_counter + 1) & 0xFF
        elif self._jumped(pose, before.at(pose.stamp_s), gap_s):
            self.bridge = Bridge.joining(pose, self.bridge.pose(before.at(pose.stamp_s)))
            self.jumps, self.jump_s = self.jumps + 1, pose.stamp_s
            return True
        return False

    def _jumped(self, new: Pose, expected: Pose, gap_s: float) -> bool:
        if new.epoch != expected.epoch:
            return True
        slack_m = self._settings.jump_m + 0.5 * self._settings.jump_m_s2 * gap_s**2
        turn = math.remainder(new.yaw - expected.yaw, math.tau)
        return math.dist(new.position, expected.position) > slack_m or abs(turn) > self._settings.jump_rad

    def next(self, now_s: float) -> Any:
        """The ODOMETRY that is due now, or None."""
        pose = self._pose
        if pose is None or now_s < self._due_s - 1e-9 or now_s - pose.stamp_s > self._settings.horizon_s:
            return None
        period_s = 1.0 / self._settings.rate_hz
        self._due_s = (
            max(self._due_s + period_s, now_s - period_s / 2) if self._due_s > 0 else now_s + period_s
        )
        return odometry(self.bridge.pose(pose.at(now_s)), self.reset_counter)


def odometry(pose: Pose, reset_counter: int) -> Any:
    """External vision as a PX4 takes it: LOCAL_NED, BODY_FRD, velocities along the body."""
    front, left, up = into_body(pose.velocity, pose.quaternion)
    rates = (0.0, 0.0, -pose.yaw_rate)
    spread = covariance(pose.variance)
    head = (round(pose.stamp_s * 1e6), LOCAL_NED, BODY_FRD, *swap(pose.position), to_ned(pose.quaternion))
    return message["ODOMETRY"](
        *head, front, -left, -up, *rates, spread, [math.nan] * 21, reset_counter, VIO, 0
    )


def covariance(variance: tuple[float, float]) -> list[float]:
    """The 21 numbers of a 6 x 6 covariance of which only the diagonal is known."""
    rows = [0.0] * 21
    for place in (0, 6, 11):
        rows[place] = variance[0]
    for place in (15, 18, 20):
        rows[place] = variance[1]
    return rows


class ResetWatch:
    """Follows the vehicle's estimate; a reset of it shifts the setpoints, and the shift then fades away.

    A reset moves the vehicle's frame under setpoints that stay: it would fly the difference at once.
    """

    FADE_M_S = 0.3
    RESET_M = 0.05

    def __init__(self) -> None:
        self._counter: int | None = None
        self._last: tuple[float, Vector, Vector] | None = None
        self._shift: Vector = (0.0, 0.0, 0.0)
        self.resets = 0

    def note(self, now_s: float, position: Vector, velocity: Vector, counter: int) -> None:
        """The vehicle's own estimate (its frame, ENU) with its count of resets."""
        if self._counter is not None and counter != self._counter and self._last is not None:
            stamp_s, before, speed = self._last
            gap_s = now_s - stamp_s
            expected = tuple(p + v * gap_s for p, v in zip(before, speed, strict=True))
            moved = minus(position, (expected[0], expected[1], expected[2]))
            if math.hypot(*moved) > self.RESET_M:
                self._shift = (
                    self._shift[0] + moved[0],
                    self._shift[1] + moved[1],
                    self._shift[2] + moved[2],
                )
                self.resets += 1
        self._counter, self._last = counter, (now_s, position, velocity)

    def shift(self, dt_s: float) -> Vector:
        """What to add to setpoints now, after it has faded for `dt_s`."""
        size = math.hypot(*self._shift)
        keep = max(0.0, 1.0 - self.FADE_M_S * dt_s / size) if size > 0.0 else 0.0
        self._shift = (self._shift[0] * keep, self._shift[1] * keep, self._shift[2] * keep)
        return self._shift

    def clear(self) -> None:
        """Forget the shift: nothing is being flown."""
        self._shift = (0.0, 0.0, 0.0)
