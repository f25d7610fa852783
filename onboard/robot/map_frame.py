"""Which frame a robot's poses come in, and how pose and map follow when they turn out to be others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from onboard.codec import Keyframe
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.localization.backend import Backend, NewKeyScan
from onboard.localization.corrections import Correction
from onboard.localization.lie import transport
from onboard.localization.pose_graph import Key
from onboard.mapping.voxel_map import VoxelMap

LEAST_M, LEAST_RAD = 0.01, 0.001
"""However sure the odometry is: its motion between two keyframes is off by this (one sigma)."""


@dataclass(frozen=True, eq=False)
class Told:
    """What localisation says: the body's `pose`, and where it is not given, how sure that is.

    `covariance` (6, 6): of the LiDAR's small motion (metres, radians, its own frame) from where it truly is,
    relative to where the odometry began.
    """

    pose: Pose
    covariance: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Moves:
    """The map has been drawn anew: own keyframes are elsewhere, and peers must be told."""

    pairs: list[tuple[Pose, Pose]]
    """Of every own keyframe, before and after."""
    correction: Correction

    def __call__(self, points: FloatArray) -> FloatArray:
        """Where places (N, 3) of the old map are in the new one: each goes with the nearest keyframe."""
        old = np.stack([before.position for before, _ in self.pairs])
        new = np.stack([after.position for _, after in self.pairs])
        turns = np.stack([after.rotation @ before.rotation.T for before, after in self.pairs])
        near = cKDTree(old).query(points)[1]
        return np.asarray(new[near] + np.einsum("nij,nj->ni", turns[near], points - old[near]))


class MapFrame(Protocol):
    """Takes what localisation says to the map that is in use."""

    def locate(self, map_from_odometry: Pose | None) -> None:
        """Begin at this pose of the odometry's frame in the map; None: unknown again, `pose` says nothing."""
        ...

    def pose(self, told: Told) -> Pose:
        """Reference point of the body in the map."""
        ...

    def scan(self, scan: Scan, told: Told, sequence: int | None) -> None:
        """A scan has been drawn; `sequence` if it became a keyframe."""
        ...

    def peer(self, key: Key, keyframe: Keyframe) -> Pose:
        """Where the sensor of a peer's keyframe was, by what that peer has said of it so far."""
        ...

    def take(self, correction: Correction) -> None:
        """A peer says where its keyframes are by now."""
        ...

    def step(self, used: VoxelMap) -> Moves | None:
        """Do a piece of what waits; not None where `used` has been replaced by a better map."""
        ...


class Given:
    """Poses come in the map's frame and are right: a simulator's truth, or a motion capture system's."""

    def locate(self, map_from_odometry: Pose | None) -> None:
        pass

    def pose(self, told: Told) -> Pose:
        return told.pose

    def scan(self, scan: Scan, told: Told, sequence: int | None) -> None:
        pass

    def peer(self, key: Key, keyframe: Keyframe) -> Pose:
        return keyframe.pose

    def take(self, correction: Correction) -> None:
        pass

    def step(self, used: VoxelMap) -> Moves | None:
        return None


class Estimated:
    """Poses come in the odometry's frame; closed loops put them and the map right."""

    def __init__(self, robot: int, mount: Pose, map_from_odometry: Pose | None) -> None:
        """`mount`: the LiDAR in the body's frame. `map_from_odometry`: None for a robot that has yet to find
        itself in the map of its carrier."""
        self._robot = robot
        self._mount, self._body = mount, mount.inverse()
        self._first = map_from_odometry
        self.backend: Backend | None = None
        self._peers: list[tuple[Key, Pose, Scan]] = []
        self._covariance = np.zeros((6, 6))
        self._keyframe = Pose.identity()

    def locate(self, map_from_odometry: Pose | None) -> None:
        """Counts until the first keyframe."""
        self._first = map_from_odometry

    def pose(self, told: Told) -> Pose:
        if self.backend is None:
            return told.pose if self._first is None else self._first.compose(told.pose)
        return self.backend.pose(told.pose.compose(self._mount)).compose(self._body)

    def scan(self, scan: Scan, told: Told, sequence: int | None) -> None:
        sensor = told.pose.compose(self._mount)
        covariance = np.zeros((6, 6)) if told.covariance is None else told.covariance
        if sequence is None:
            if self.backend is not None:
                self.backend.keep_between(scan, sensor)
            return
        backend = self._begun(sensor)
        motion = self._keyframe.inverse().compose(sensor)
        since = grown(self._covariance, covariance, motion)
        self._keyframe, self._covariance = sensor, covariance
        backend.add_keyframe(NewKeyScan(sequence, scan, sensor, since))

    def _begun(self, sensor: Pose) -> Backend:
        """The back end, which begins with the first keyframe."""
        if self.backend is None:
            if self._first is None:
                raise InputError("no keyframe before the robot has found itself in the map")
            self.backend = Backend(self._robot, self._first.compose(sensor))
            for key, pose, scan in self._peers:
                self.backend.add_peer_keyframe(key, pose, scan)
            self._peers.clear()
        return self.backend

    def peer(self, key: Key, keyframe: Keyframe) -> Pose:
        scan = Scan(0.0, keyframe.ranges, keyframe.model)
        if self.backend is None:
            self._peers.append((key, keyframe.pose, scan))
            return keyframe.pose
        return self.backend.add_peer_keyframe(key, keyframe.pose, scan)

    def take(self, correction: Correction) -> None:
        if self.backend is not None:
            self.backend.take_correction(correction)

    def step(self, used: VoxelMap) -> Moves | None:
        if self.backend is None:
            return None
        before = dict(self.backend.used)
        progress = self.backend.step(used)
        if progress.correction is None:
            return None
        own = [key for key in before if key[0] == self._robot]
        return Moves([(before[key], self.backend.used[key]) for key in own], progress.correction)


def grown(before: FloatArray, now: FloatArray, motion: Pose) -> FloatArray:
    """Covariance (6, 6) of the small motion between two poses whose own covariances are these.

    What both share cancels: the difference, where it is less than the least error the least error.
    """
    move = transport(motion)
    values, axes = np.linalg.eigh(_symmetric(now - move @ before @ move.T) / _LEAST)
    return np.asarray((axes * np.maximum(values, 1.0)) @ axes.T * _LEAST)


def _symmetric(matrix: FloatArray) -> FloatArray:
    return (matrix + matrix.T) / 2


_LEAST = np.outer(*2 * (np.repeat([LEAST_M, LEAST_RAD], 3),))
