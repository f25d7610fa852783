"""Getting going: what a robot does when there is no flight or walk from where it begins.

Each way out has a reason code, which goes into the record of the planning cycle. The ladder is climbed while
nothing is found and the robot is still where it began; nothing waits for more than the mission allows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.planning.body import Body
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import NOTHING, Plan

SCANS = 5
WAIT_S = 1.0
"""So long a robot waits for SCANS scans before it plans on what it has."""
UNDER_WAY_M = 2.0
PATIENCE_S = 15.0
SPHERE_M = 0.3
CONE_M = 1.5
CONE_RAD = 0.5
SEEN_BEYOND_M = 3.0
CLIMB_M = 0.5
BLOCKING = 12
RETREAT_M = 5.0
LOOK_AROUND = "look-around"
"""Kind of plan that turns on the spot."""


class Reason(StrEnum):
    """Why the start is not an ordinary planning cycle."""

    SCANS = "WAITING_FOR_SCANS"
    SPHERE = "CLEARED_BODY_SPHERE"
    RETREAT = "RETREAT_TO_FREE_PLACE"
    CONE = "CLEARED_FORWARD_CONE"
    CLIMB = "CLIMB"
    LOOK = "YAW_SCAN"
    STUCK = "STUCK_AT_START"


@dataclass(frozen=True)
class Step:
    """What to do at the start: a code, a small plan (NOTHING: plan again on the changed map), and for STUCK
    the voxels (N, 3), their centres in metres, nearest first, that are in the way."""

    reason: Reason
    plan: Plan = NOTHING
    blocking: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


class Startup:
    """The ladder of one robot: body sphere, retreat, forward cone, climb, yaw scan, report; then again."""

    def __init__(self, body: Body, voxel_map: VoxelMap) -> None:
        self._body = body
        self._map = voxel_map
        self._origin: FloatArray | None = None
        self._since_s: float | None = None
        self._rung = 0

    def begin(self, point: FloatArray) -> None:
        """The robot is put down, or let go, at this reference point (3,)."""
        self._origin, self._since_s, self._rung = point.copy(), None, 0

    def active(self, now_s: float, point: FloatArray) -> bool:
        """Whether the robot is still starting: near where it began, and not for too long."""
        if self._origin is None:
            return False
        self._since_s = now_s if self._since_s is None else self._since_s
        gone = float(np.linalg.norm(point - self._origin)) > UNDER_WAY_M
        if gone or now_s - self._since_s > PATIENCE_S:
            self._origin = None
        return self._origin is not None

    def done(self) -> None:
        """A path was found: from now on nothing left means nothing left."""
        self._origin = None

    def waits(self, now_s: float) -> bool:
        """Whether it is too early to plan: fewer scans than SCANS, and less than WAIT_S since the start."""
        assert self._since_s is not None
        return self._map.version < SCANS and now_s - self._since_s < WAIT_S

    def help(self, now_s: float, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step:
        """The next way out for a robot at `point` (3,) that can reach nothing; `trail`: where it has been."""
        if self.waits(now_s):
            return Step(Reason.SCANS)
        ladder = (self._sphere, self._retreat, self._cone, self._climb, self._look)
        while self._rung < len(ladder):
            rung = ladder[self._rung]
            self._rung += 1
            step = rung(point, heading_rad, trail)
            if step is not None:
                return step
        self._rung = 0
        return Step(Reason.STUCK, blocking=self._blocking(point))

    def _sphere(self, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step | None:
        """What is unknown within the body's half size and 0.3 m is free: the body is there."""
        if self._body.settings.kind == "ground":
            return None
        radius = max(self._body.settings.size_m) / 2 + SPHERE_M
        cells = self._around(point, radius)
        return Step(Reason.SPHERE) if self._free(cells[self._map.status(cells) == UNKNOWN]) else None

    def _retreat(self, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step | None:
        """Where the body stands in something known: back to the newest place of the trail that is free."""
        half, centre = self._body.half_extent, self._body.box_centre
        if self._map.box_status(point[None] + centre, half)[0] != OCCUPIED:
            return None
        for place in reversed(trail[-50:]):
            distance = float(np.linalg.norm(place - point))
            if 0.3 < distance < RETREAT_M and self._map.box_status(place[None] + centre, half)[0] != OCCUPIED:
                return Step(Reason.RETREAT, Plan(np.stack([point, place]), "retreat"))
        return None

    def _cone(self, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step | None:
        """Unknown voxels up to 1.5 m ahead are free where something is known beyond them on the same ray."""
        sensor = point + self._body.mount
        angles = np.linspace(-CONE_RAD, CONE_RAD, 21)
        yaw, pitch = (grid.ravel() for grid in np.meshgrid(heading_rad + angles, angles))
        rays = np.column_stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        lengths = np.arange(0.1, SEEN_BEYOND_M, self._map.voxel_m / 2)
        places = sensor + rays[:, None] * lengths[:, None]
        status = self._map.status(places.reshape(-1, 3)).reshape(places.shape[:2])
        met = np.maximum.accumulate(status == OCCUPIED, axis=1)
        beyond = ((status != UNKNOWN) & (lengths > CONE_M)).any(axis=1)
        chosen = (status == UNKNOWN) & (lengths <= CONE_M) & ~met & beyond[:, None]
        return Step(Reason.CONE) if self._free(places[chosen]) else None

    def _climb(self, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step | None:
        """A flying robot rises half a metre where nothing is known to be above it."""
        above = point + np.array([0.0, 0.0, CLIMB_M])
        if self._body.settings.kind == "ground":
            return None
        if self._map.segment_status(point[None], above[None], self._body.half_extent)[0] == OCCUPIED:
            return None
        return Step(Reason.CLIMB, Plan(np.stack([point, above]), "take-off"))

    def _look(self, point: FloatArray, heading_rad: float, trail: list[FloatArray]) -> Step | None:
        """Turn on the spot: a beam that was lost or blocked comes from elsewhere."""
        return Step(Reason.LOOK, Plan(np.stack([point, point]), LOOK_AROUND))

    def _free(self, places: FloatArray) -> bool:
        """Assume the voxels of these places (N, 3) free; whether there were any."""
        voxel_m = self._map.voxel_m
        voxels = np.unique(np.floor(places / voxel_m).astype(np.int64), axis=0)
        for voxel in voxels:
            self._map.assume_free(voxel * voxel_m, (voxel + 1) * voxel_m)
        return len(voxels) > 0

    def _around(self, point: FloatArray, radius_m: float) -> FloatArray:
        """Centres (N, 3) of the voxels that a sphere around a point touches."""
        voxel_m = self._map.voxel_m
        reach = int(np.ceil(radius_m / voxel_m)) + 1
        grid = np.arange(-reach, reach + 1)
        offsets = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
        centres = (np.floor(point / voxel_m) + offsets + 0.5) * voxel_m
        gaps = np.maximum(np.abs(centres - point) - voxel_m / 2, 0.0)
        return np.asarray(centres[np.linalg.norm(gaps, axis=1) < radius_m])

    def _blocking(self, point: FloatArray) -> FloatArray:
        """Centres (N, 3) of the nearest voxels around the body that are not free."""
        centre = point + self._body.box_centre
        cells = self._around(centre, max(self._body.settings.size_m) / 2 + 1.0)
        cells = cells[self._map.status(cells) != FREE]
        order = np.argsort(np.linalg.norm(cells - centre, axis=1), kind="stable")
        return np.asarray(cells[order[:BLOCKING]])
