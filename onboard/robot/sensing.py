"""From scans to the map and to keyframes, and from received keyframes to the map."""

from __future__ import annotations

import numpy as np

from onboard.codec import Keyframe, decode, encode
from onboard.core.config import RobotSettings
from onboard.core.errors import WireError
from onboard.core.geometry import Pose, apart
from onboard.core.lidar import Scan
from onboard.mapping.voxel_map import PEER, VoxelMap
from onboard.planning.local_graph import FloatArray

CLEARING_M = 1.25
"""Rays without return are drawn this much longer than the map's range, so that they clear and never
occupy."""


START_DISC_M = 3.0
"""The floor around the start is taken as flat: the lowest beam of a LiDAR on a walking robot first meets
it there."""


class Sensing:
    """Feeds one voxel map from the robot's own LiDAR and from its peers' keyframes."""

    def __init__(self, settings: RobotSettings, voxel_map: VoxelMap) -> None:
        self._settings = settings
        self._map = voxel_map
        self._mount = Pose.from_rpy(np.array(settings.lidar.mount_m))
        self._last_keyframe: Pose | None = None
        self.frames_bad = 0

    def sensor_pose(self, body: Pose) -> Pose:
        """Pose of the LiDAR when the body's reference point is at `body`."""
        return body.compose(self._mount)

    def assume_floor(self, start: FloatArray) -> None:
        """Take the ground around the floor point `start` (3,) for flat."""
        steps = np.arange(-START_DISC_M, START_DISC_M, 0.1)
        grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        disc = grid[np.hypot(*grid.T) <= START_DISC_M]
        self._map.assume_occupied(start + np.column_stack([disc, np.full(len(disc), -0.02)]))

    def integrate(self, scan: Scan, body: Pose) -> None:
        """Add an own scan to the map."""
        points = scan.rays(self._map.max_range_m * CLEARING_M)
        self._map.integrate(points, self.sensor_pose(body).matrix(), min_range_m=scan.model.min_range_m)

    def keyframe_due(self, scan: Scan, body: Pose) -> bool:
        """Whether the LiDAR sees a thing and moved by tau_t or turned by tau_r since the last keyframe."""
        if not (scan.ranges > 0).any():
            return False
        if self._last_keyframe is None:
            return True
        moved_m, turned_rad = apart(self.sensor_pose(body), self._last_keyframe)
        limits = self._settings.keyframes
        return moved_m > limits.translation_m or turned_rad > limits.rotation_rad

    def make_keyframe(self, scan: Scan, body: Pose) -> tuple[bytes, FloatArray]:
        """Encode a scan; its bytes and the LiDAR position (3,) that they carry."""
        self._last_keyframe = self.sensor_pose(body)
        wanted = self._settings.keyframes
        data = encode(
            scan,
            self._last_keyframe,
            budget_bytes=wanted.budget_bytes,
            quality=wanted.quality,
            codec=wanted.codec,
        )
        return data, self._last_keyframe.position

    def decoded(self, payload: bytes) -> Keyframe | None:
        """A peer's keyframe, None if its bytes are bad."""
        try:
            return decode(payload)
        except WireError:
            self.frames_bad += 1
            return None

    def receive(self, keyframe: Keyframe, pose: Pose) -> None:
        """Draw a peer's keyframe whose sensor was at `pose`."""
        points = keyframe.scan_rays(self._map.max_range_m * CLEARING_M)
        self._map.integrate(points, pose.matrix(), min_range_m=keyframe.model.min_range_m, source=PEER)
