"""The back end of localisation: keyframes in, closed loops, corrected poses and a map rebuilt from them.

Two sets of poses live side by side. The estimates follow every closure. What the map was drawn with and the
robot steers by stays as it is until a rebuilt map is ready; then map, keyframes and the robot's own pose move
together (`adopt`), so that nothing is ever planned with the pose of one and the map of the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.localization.archive import Archive, Kept
from onboard.localization.closer import CloserSettings, LoopCloser
from onboard.localization.corrections import Correction, correction_of, moved_far
from onboard.localization.pose_graph import Key, Step
from onboard.localization.reintegration import Reintegration
from onboard.mapping.replacement import replace_contents
from onboard.mapping.voxel_map import VoxelMap


@dataclass(frozen=True, slots=True)
class BackendSettings:
    """Tuning of what is kept and when the map is rebuilt."""

    closer: CloserSettings = field(default_factory=CloserSettings)
    between_m: float = 0.5
    between_rad: float = 0.35
    """A scan is kept for the map after so much motion since the last kept one."""
    correct_m: float = 0.1
    correct_rad: float = 0.01
    """The map is rebuilt once a keyframe has moved or turned by so much."""
    peer_m: float = 0.05
    peer_rad: float = 0.01
    """How well a peer is taken to know where its keyframes are."""
    max_knots: int = 1000


class Backend:
    """One robot's keyframes, their poses, and how robot and map get to new ones. No clock, no I/O."""

    def __init__(self, robot: int, start: Pose, settings: BackendSettings | None = None) -> None:
        """`start` is where the sensor is in the map frame before the first keyframe."""
        self.settings = settings or BackendSettings()
        self.archive = Archive(robot)
        self.closer = LoopCloser(self.archive.scan, self.settings.closer)
        self.used: dict[Key, Pose] = {}
        """Poses that the map in use is drawn with."""
        self.sent: dict[int, Pose] = {}
        """Poses of the own keyframes when they were new: what peers have been sent."""
        self.revision = 0
        """Corrections adopted so far."""
        self._robot = robot
        self._start = start
        self._last: Key | None = None
        self._odometry = Pose.identity()
        self._kept_at = Pose.identity()
        self._target: dict[Key, Pose] | None = None
        self._job: Reintegration | None = None

    def pose(self, odometry: Pose) -> Pose:
        """Where the sensor is in the frame of the map in use, odometry saying `odometry`."""
        if self._last is None:
            return self._start
        return self.used[self._last].compose(self._since(odometry))

    def add_keyframe(self, sequence: int, scan: Scan, odometry: Pose, covariance: FloatArray) -> Pose:
        """A new own keyframe and its pose in the map in use.

        `odometry` is the sensor's pose in odometry's frame, `covariance` (6, 6) that of its small motion
        (shift, rotation vector) since the keyframe before. Raises InputError for a sequence that is not new.
        """
        key, pose, last = (self._robot, sequence), self.pose(odometry), self._last
        if last is not None and sequence <= last[1]:
            raise InputError(f"keyframe {sequence} after {last[1]}: sequences must ascend")
        if last is None:
            self.closer.begin(key, pose)
        else:
            motion = self._since(odometry)
            self.closer.go_on(Step(last, key, motion, covariance))
            if self._target is not None:
                self._target[key] = self._target[last].compose(motion)
        self.used[key] = self.sent[sequence] = pose
        self._last, self._odometry, self._kept_at = key, odometry, odometry
        self._draw(self.archive.add_keyframe(key, scan))
        return pose

    def keep_between(self, scan: Scan, odometry: Pose) -> bool:
        """Keep a scan between keyframes for the map if the sensor has moved enough; whether it was kept."""
        limits = self.settings
        if self._last is None or not moved_far(self._kept_at, odometry, limits.between_m, limits.between_rad):
            return False
        self._draw(self.archive.add_between(self._last, self._since(odometry), scan))
        self._kept_at = odometry
        return True

    def add_peer_keyframe(self, key: Key, pose: Pose, scan: Scan, along_m: float) -> None:
        """A decoded keyframe of a peer, where that peer says it is, so far along the peer's way."""
        self.used[key] = pose
        if self._target is not None:
            self._target[key] = pose
        self.closer.put(key, pose, self._peer_covariance(), along_m)
        self._draw(self.archive.add_keyframe(key, scan))

    def move_peer_keyframe(self, key: Key, pose: Pose, along_m: float) -> None:
        """What a peer's correction says of one of its keyframes."""
        self.closer.put(key, pose, self._peer_covariance(), along_m)

    def work(self) -> bool:
        """Do one piece of what is waiting: a fraction of a second at most. Whether there was anything."""
        busy = self.closer.busy
        self.closer.work()
        return busy

    @property
    def outdated(self) -> bool:
        """Whether the map in use should be drawn anew."""
        limits = self.settings.correct_m, self.settings.correct_rad
        poses = self.closer.graph.poses
        return any(moved_far(pose, poses[key], *limits) for key, pose in self.used.items() if key in poses)

    def rebuild(self, like: VoxelMap) -> Reintegration:
        """Begin to draw a map like this one at the estimated poses; scans to come are drawn as well."""
        self._target = dict(self.closer.graph.poses)
        self._job = Reintegration(like, self.archive.pieces(self._target))
        return self._job

    def adopt(self, used: VoxelMap) -> Correction:
        """Put the rebuilt map, which must be done, into `used`, and move everything to its poses.

        The correction tells peers; the robot's own pose is another from now on. Raises InputError before.
        """
        if self._job is None or self._target is None or not self._job.done:
            raise InputError("no rebuilt map is ready: finish rebuild() first")
        replace_contents(used, self._job.map)
        self.used = self._target
        self._job = self._target = None
        self.revision += 1
        return self.correction()

    def correction(self) -> Correction:
        """Where the own keyframes are now, to be sent to peers."""
        poses = {sequence: self.used[self._robot, sequence] for sequence in self.sent}
        return correction_of(self._robot, self.revision, self.sent, poses, self.settings.max_knots)

    def _draw(self, kept: Kept) -> None:
        """Let a map that is being rebuilt have a new scan, too."""
        if self._job is not None and self._target is not None:
            self._job.add(self.archive.piece(kept, self._target[kept.key]))

    def _since(self, odometry: Pose) -> Pose:
        """Motion since the last keyframe."""
        return self._odometry.inverse().compose(odometry)

    def _peer_covariance(self) -> FloatArray:
        shift, turn = self.settings.peer_m**2, self.settings.peer_rad**2
        return np.asarray(np.diag([shift] * 3 + [turn] * 3))
