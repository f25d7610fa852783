"""The back end of localisation: keyframes in, closed loops, corrected poses and a map rebuilt from them.

Two sets of poses live side by side. The estimates follow every closure. What the map was drawn with and the
robot steers by stays as it is until a rebuilt map is ready; then map, keyframes and the robot's own pose move
together (`adopt`), so that nothing is ever planned with the pose of one and the map of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.localization.archive import Archive, Kept
from onboard.localization.closer import CloserSettings, LoopCloser
from onboard.localization.corrections import Correction, CorrectionBook, correction_of, moved_far
from onboard.localization.pose_graph import Key, Step
from onboard.localization.reintegration import Piece, Reintegration
from onboard.mapping.replacement import replace_contents
from onboard.mapping.voxel_map import VoxelMap


@dataclass(frozen=True, slots=True)
class BackendSettings:
    """Tuning of what is kept and when the map is rebuilt."""

    closer: CloserSettings = field(default_factory=CloserSettings)
    between_m: float = 0.5
    between_rad: float = 0.35
    """A scan is kept for the map after so much motion since the last kept one."""
    correct_m: float = 0.15
    correct_rad: float = 0.015
    """The map is rebuilt once a keyframe has moved or turned by so much."""
    peer_m: float = 0.05
    peer_rad: float = 0.01
    """How well a peer is taken to know where its keyframes are."""
    max_knots: int = 1000
    settled: int = 20
    """A new map waits for so many steps without anything to do for the loops: closures come in series."""
    scans_a_step: int = 4
    """Kept scans that are drawn into a new map in one step."""
    redraws: int = 4
    redraws_a_step: float = 0.7
    """For every kept scan and for every step so many may be drawn anew: large maps wait longer."""


@dataclass(frozen=True, slots=True, eq=False)
class NewKeyScan:
    """An own keyframe: the sensor's pose in odometry's frame, and the covariance (6, 6) of its small motion
    (shift, rotation vector, in the sensor's frame) since the keyframe before."""

    sequence: int
    scan: Scan
    odometry: Pose
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """What a step has led to."""

    map_from_odometry: Pose
    """Takes poses in odometry's frame to the map that is in use from now on."""
    corrected: Mapping[Key, Pose]
    """Keyframes whose poses are others than before: none but in a step that has replaced the map."""
    correction: Correction | None
    """In such a step: what peers must be told."""


class Backend:
    """One robot's keyframes, their poses, and how robot and map get to new ones. No clock, no I/O."""

    def __init__(self, robot: int, start: Pose, settings: BackendSettings | None = None) -> None:
        """`start` is where the sensor is in the map frame before the first keyframe."""
        self.settings = settings or BackendSettings()
        self.robot = robot
        self.start = start
        self.archive = Archive(robot)
        self.closer = LoopCloser(robot, self.archive.scan, self.settings.closer)
        self.used: dict[Key, Pose] = {}
        """Poses that the map in use is drawn with."""
        self.sent: dict[Key, Pose] = {}
        """Poses of keyframes when they were new: what own ones were sent with, and peers' came with."""
        self.book = CorrectionBook()
        """What peers have said of theirs since."""
        self.revision = 0
        """Corrections adopted so far."""
        self.last: Key | None = None
        self.odometry = Pose.identity()
        """What odometry said at the last keyframe."""
        self._kept_at = Pose.identity()
        self._target: dict[Key, Pose] | None = None
        self._job: Reintegration | None = None
        self._redrawn = 0
        self._steps = 0
        self._idle = 0
        self._judged = 0

    def step(self, used: VoxelMap, new: Sequence[NewKeyScan] = ()) -> Progress:
        """Take new keyframes in and do one piece of what waits: less than 0.1 s of computing.

        `used` is the map in use; when a better one is ready it takes its place in this very step. Raises
        InputError for a sequence that is not new.
        """
        for item in new:
            self.add_keyframe(item)
        self.closer.work()
        self._steps += 1
        before = self.used
        correction = self._go_on_drawing(used)
        moved = {} if correction is None else {k: p for k, p in self.used.items() if _differs(before, k, p)}
        return Progress(self.map_from_odometry, moved, correction)

    @property
    def map_from_odometry(self) -> Pose:
        """Takes poses in odometry's frame to the map in use."""
        return self.pose(Pose.identity())

    def pose(self, odometry: Pose) -> Pose:
        """Where the sensor is in the frame of the map in use, odometry saying `odometry`."""
        if self.last is None:
            return self.start
        return self.used[self.last].compose(self._since(odometry))

    def add_keyframe(self, new: NewKeyScan) -> Pose:
        """A new own keyframe and its pose in the map in use. Raises InputError for a sequence not new."""
        key, pose, last = (self.robot, new.sequence), self.pose(new.odometry), self.last
        if last is not None and new.sequence <= last[1]:
            raise InputError(f"keyframe {new.sequence} after {last[1]}: sequences must ascend")
        if last is None:
            self.closer.begin(key, pose)
        else:
            motion = self._since(new.odometry)
            self.closer.go_on(Step(last, key, motion, new.covariance))
            if self._target is not None:
                self._target[key] = self._target[last].compose(motion)
        self.used[key] = self.sent[key] = pose
        self.last, self.odometry, self._kept_at = key, new.odometry, new.odometry
        self._draw(self.archive.add_keyframe(key, new.scan))
        return pose

    def keep_between(self, scan: Scan, odometry: Pose) -> bool:
        """Keep a scan between keyframes for the map if the sensor has moved enough; whether it was kept."""
        limits = self.settings
        if self.last is None or not moved_far(self._kept_at, odometry, limits.between_m, limits.between_rad):
            return False
        self._draw(self.archive.add_between(self.last, self._since(odometry), scan))
        self._kept_at = odometry
        return True

    def add_peer_keyframe(self, key: Key, pose: Pose, scan: Scan) -> Pose:
        """A decoded keyframe of a peer with the pose that it carries; where it is by what that peer has said.

        One that is held already changes nothing.
        """
        if key in self.sent:
            return self.used[key]
        here = self.book.pose(*key, pose)
        self.sent[key], self.used[key] = pose, here
        if self._target is not None:
            self._target[key] = here
        self.closer.put(key, here, self._peer_covariance())
        self._draw(self.archive.add_keyframe(key, scan))
        return here

    def take_correction(self, correction: Correction) -> bool:
        """What a peer says of its keyframes; whether it is news. Steps to come draw the map accordingly."""
        if correction.source == self.robot or not self.book.take(correction):
            return False
        for key, pose in self.sent.items():
            if key[0] == correction.source:
                self.closer.put(key, self.book.pose(*key, pose), self._peer_covariance())
        self._judged = -1
        return True

    def resume(self, last: Key | None, odometry: Pose) -> None:
        """Go on after a crash: the last keyframe and what odometry said then."""
        self.last, self.odometry, self._kept_at = last, odometry, odometry
        self._judged = -1

    def pieces(self) -> list[Piece]:
        """What the map in use is drawn of, in order."""
        return self.archive.pieces(self.used)

    @property
    def drawing(self) -> bool:
        """Whether a new map is being drawn."""
        return self._job is not None

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
        self._redrawn += len(self._job)
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
        self._judged = -1
        self.revision += 1
        return self.correction()

    def correction(self) -> Correction:
        """Where the own keyframes are now, to be sent to peers."""
        sent = {sequence: pose for (robot, sequence), pose in self.sent.items() if robot == self.robot}
        poses = {sequence: self.used[self.robot, sequence] for sequence in sent}
        return correction_of(self.robot, self.revision, sent, poses, self.settings.max_knots)

    def _go_on_drawing(self, used: VoxelMap) -> Correction | None:
        if self._job is None:
            self._idle = 0 if self.closer.busy else self._idle + 1
            settled = self._idle >= self.settings.settled and self._judged != self.closer.changes
            if settled and self._may_redraw():
                self._judged = self.closer.changes
                if self.outdated:
                    self.rebuild(used)
            return None
        return self.adopt(used) if self._job.advance(self.settings.scans_a_step) else None

    def _may_redraw(self) -> bool:
        count = len(self.archive)
        allowed = self.settings.redraws * count + self.settings.redraws_a_step * self._steps
        return self._redrawn + count <= allowed

    def _draw(self, kept: Kept) -> None:
        """Let a map that is being rebuilt have a new scan, too."""
        if self._job is not None and self._target is not None:
            self._job.add(self.archive.piece(kept, self._target[kept.key]))

    def _since(self, odometry: Pose) -> Pose:
        """Motion since the last keyframe."""
        return self.odometry.inverse().compose(odometry)

    def _peer_covariance(self) -> FloatArray:
        shift, turn = self.settings.peer_m**2, self.settings.peer_rad**2
        return np.asarray(np.diag([shift] * 3 + [turn] * 3))


def _differs(before: Mapping[Key, Pose], key: Key, pose: Pose) -> bool:
    old = before.get(key)
    return old is None or not (
        np.array_equal(old.position, pose.position) and np.array_equal(old.quaternion, pose.quaternion)
    )
