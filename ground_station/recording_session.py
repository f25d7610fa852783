"""Odometry, map and keyframes of a recording, scan by scan, and the numbers that come out."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass, field
from typing import Any, BinaryIO, TextIO

import numpy as np
from numpy.typing import NDArray

from drivers.types import LidarScan, Recording
from ground_station.range_image import likely_model_name, to_range_image
from onboard.codec import decode, encode
from onboard.core.geometry import Pose, apart
from onboard.core.lidar import LidarModel, lidar_model
from onboard.localization.estimate import Estimate
from onboard.localization.odometry import Odometry
from onboard.mapping.compare import compare_maps
from onboard.mapping.tsdf import TsdfBand
from onboard.mapping.voxel_map import VoxelMap

LENGTH = struct.Struct("<I")
"""What precedes every keyframe in keyframes.bin: its length in bytes."""

_EVERYWHERE_M = np.full(3, 1e5)


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """How a recording is mapped; the defaults are those of the ground robot."""

    voxel_m: float = 0.2
    max_range_m: float = 20.0
    keyframe_translation_m: float = 2.0
    keyframe_rotation_rad: float = 0.785
    keyframe_budget_bytes: int | None = None
    """The codec's default quality unless given."""
    octomap: bool = False
    mesh: bool = False
    """What to write besides the map: a tree for OctoMap, a mesh."""
    rate_hz: float | None = None
    """Scans a second of point cloud files; by their names, else 10, unless given."""


@dataclass(eq=False)
class RecordingSession:
    """Everything that grows scan by scan."""

    recording: Recording
    settings: RecordingSettings
    track: TextIO
    keyframes: BinaryIO
    complete: bool = False
    rows: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    keyframe_bytes: list[int] = field(default_factory=list)
    odometry_ms: list[float] = field(default_factory=list)
    map_ms: list[float] = field(default_factory=list)
    lost_scans: int = 0
    degenerate_scans: int = 0
    jumps: int = 0
    poses: list[Pose] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.odometry = Odometry()
        self.map = self._new_map()
        self.keyframe_map = self._new_map()
        self.surface = TsdfBand(self.settings.voxel_m) if self.settings.mesh else None
        self._keyframe_pose: Pose | None = None
        self._model: LidarModel | None = None
        warm = self._new_map()
        warm.integrate(np.ones((1, 3), dtype=np.float32), np.eye(4))  # compile before anything is timed

    def _new_map(self) -> VoxelMap:
        return VoxelMap(voxel_m=self.settings.voxel_m, max_range_m=self.settings.max_range_m)

    def model(self, points: NDArray[np.float32]) -> LidarModel:
        """The nominal LiDAR: the recording's, else what the first scan looks like."""
        if self._model is None:
            self._model = lidar_model(self.recording.model_name or likely_model_name(points))
        return self._model

    def add(self, scan: LidarScan) -> None:
        """Locate and map one scan; a scan that the odometry refuses is counted and left out."""
        start_s = time.perf_counter()
        located = self.odometry.step(scan.stamp_s, scan.points, scan.offsets_s)
        self.odometry_ms.append((time.perf_counter() - start_s) * 1e3)
        if not located.ok:
            self.lost_scans += 1
            return
        self.degenerate_scans += int(len(located.degenerate) > 0)
        self.jumps += int(located.jump)
        model = self.model(located.points)
        start_s = time.perf_counter()
        self.map.integrate(located.points, located.pose.matrix(), min_range_m=model.min_range_m)
        self.map_ms.append((time.perf_counter() - start_s) * 1e3)
        if self.surface is not None:
            limits = {"min_range_m": model.min_range_m, "max_range_m": self.settings.max_range_m}
            self.surface.integrate(located.points, located.pose.matrix(), **limits)
        if self._wants_keyframe(located.pose):
            self._add_keyframe(located, model, scan.stamp_s)
        self._note(located.pose, scan.stamp_s)

    def _wants_keyframe(self, pose: Pose) -> bool:
        last = self._keyframe_pose
        if last is None:
            return True
        moved_m, turned_rad = apart(pose, last)
        limits = self.settings
        return moved_m > limits.keyframe_translation_m or turned_rad > limits.keyframe_rotation_rad

    def _add_keyframe(self, located: Estimate, model: LidarModel, stamp_s: float) -> None:
        """Encode, store, and map what a peer would decode."""
        image = to_range_image(located.points, model, stamp_s)
        data = encode(image, located.pose, budget_bytes=self.settings.keyframe_budget_bytes)
        self.keyframes.write(LENGTH.pack(len(data)) + data)
        self.keyframes.flush()
        received = decode(data)
        rays = received.scan_rays(2 * self.settings.max_range_m)
        self.keyframe_map.integrate(rays, received.pose.matrix(), min_range_m=model.min_range_m)
        self.keyframe_bytes.append(len(data))
        self._keyframe_pose = located.pose

    def _note(self, pose: Pose, stamp_s: float) -> None:
        x, y, z = (float(v) for v in pose.position)
        numbers = " ".join(f"{v:.6f}" for v in (x, y, z, *pose.quaternion))
        self.track.write(f"{stamp_s:.6f} {numbers}\n")
        self.track.flush()
        # the row last: an interrupt never leaves more rows than poses
        self.poses.append(pose)
        self.rows.append((stamp_s, x, y, z, self.known_m3(), float(sum(self.keyframe_bytes))))

    def table(self) -> NDArray[np.float64]:
        """(N, 6) per located scan: stamp, x, y, z, observed m^3, keyframe bytes so far."""
        return np.array(self.rows, dtype=np.float64).reshape(-1, 6)

    def known_m3(self) -> float:
        """Volume observed so far."""
        return float(self.map.known_count(-_EVERYWHERE_M, _EVERYWHERE_M) * self.settings.voxel_m**3)

    def metrics(self) -> dict[str, Any]:
        """The numbers of the run; times are of this machine."""
        track = self.table()
        steps_m = np.linalg.norm(np.diff(track[:, 1:4], axis=0), axis=1)
        score = compare_maps(self.map, self.keyframe_map, -_EVERYWHERE_M, _EVERYWHERE_M)
        return {
            "sensor": self.recording.sensor_name,
            "model": self._model.name if self._model else self.recording.model_name,
            "complete": self.complete,
            "scans": len(self.odometry_ms),
            "lost_scans": self.lost_scans,
            "degenerate_scans": self.degenerate_scans,
            "jumps": self.jumps,
            "duration_s": float(track[-1, 0] - track[0, 0]) if len(track) else 0.0,
            "path_m": float(steps_m.sum()),
            "keyframes": len(self.keyframe_bytes),
            "keyframe_bytes": sum(self.keyframe_bytes),
            "map_m3": self.known_m3(),
            "occupied_voxels": len(self.map.occupied_indices()),
            "map_ms_p50": _median(self.map_ms),
            "odometry_ms_p50": _median(self.odometry_ms),
            "keyframe_map": {
                "occ_f1": float(score.occ_f1),
                "free_iou": float(score.free_iou),
                "unsafe26": float(score.unsafe26),
            },
        }


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else 0.0
