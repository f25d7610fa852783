"""One try: scans of a carrier that walked to a place, scans from its bracket, and a wrong first guess."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.colocalisation.worlds import Source
from models.places import MOUNT_M, Places
from onboard.core.config import Config, RobotSettings
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.bracket import carried_pose
from simulation.ground_robot import GroundRobot
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds.solids import up

STEP_S = 0.1
SCAN_PERIOD_S = 0.5
WALK_S = (4.0, 16.0)
AHEAD_M = 1.0
GUESS_M, GUESS_YAW_RAD, GUESS_TILT_RAD = 1.5, float(np.deg2rad(30.0)), float(np.deg2rad(5.0))
SWAY_M, SWAY_RAD = 0.03, float(np.deg2rad(1.0))
"""Between the two scans the carrier shifts its weight by so much (standard deviation)."""
ODOMETRY_M, ODOMETRY_RAD = 0.005, float(np.deg2rad(0.1))
"""Error (standard deviation) of the carried robot's own odometry from the one scan to the other."""

Points = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Shot:
    """A scan of the carried robot, its pose by its own odometry, and the true one in the carrier's map."""

    scan: Scan
    odometry: Pose
    truth: Pose


@dataclass(frozen=True, eq=False)
class Case:
    """`walked`: returns (N, 3) of the carrier's scans and where it believes its LiDAR to have been.

    `shots`: two scans of the carried robot; `guess`: what is believed of its pose at the first of them.
    """

    world: str
    self_similar: bool
    walked: list[tuple[Points, Pose]]
    shots: list[Shot]
    guess: Pose


class Tries:
    """Draws cases in one world. `drift`: share of the path by which the ground robot's odometry errs."""

    def __init__(self, source: Source, config: Config, rng: np.random.Generator, drift: float = 0.0) -> None:
        world = source.make()
        self._source = source
        self._config = config
        self._rng = rng
        self._drift = drift
        self._ground = next(robot for robot in config.robots if robot.kind == "ground")
        self._aerial = next(robot for robot in config.robots if robot.kind == "aerial")
        self._start = world.start
        self._places = None if source.self_similar else Places(world)
        self._scene = Scene(world.vertices, world.triangles) if self._places is None else self._places.scene

    def draw(self, count: int) -> Iterator[Case]:
        """`count` cases at places that the ground robot can stand in."""
        for pose in self._standing(count):
            yield self._case(self._walk(pose))

    def _standing(self, count: int) -> list[Pose]:
        """Floor poses (of the body's reference point) from which walks begin."""
        if self._places is None:
            shifts = self._rng.uniform([-10.0, -0.2, 0.0], [10.0, 0.2, 0.0], (count, 3))
            return [Pose.from_rpy(self._start + s, yaw_rad=self._rng.uniform(-0.3, 0.3)) for s in shifts]
        down = Pose.from_rpy(-up(MOUNT_M))
        return [pose.compose(down) for pose in self._places.standing(count, self._rng)]

    def _walk(self, start: Pose) -> list[Pose]:
        """Poses of the ground robot, one for each scan, on a walk that turns where it is narrow."""
        robot = GroundRobot(self._ground, self._scene, start.position, start.yaw)
        steps = int(self._rng.uniform(*WALK_S) / STEP_S)
        heading = self._heading(robot.pose)
        poses = [robot.pose]
        for step in range(1, steps):
            if robot.blocked or self._room_ahead(robot.pose, heading) < AHEAD_M:
                heading = self._heading(robot.pose)
            turn = float(np.angle(np.exp(1j * (heading - robot.pose.yaw))))
            speed = self._ground.speed_m_s * max(0.0, np.cos(turn))
            robot.step(STEP_S, speed * np.array([np.cos(heading), np.sin(heading)]), 2.0 * turn)
            if step % round(SCAN_PERIOD_S / STEP_S) == 0:
                poses.append(robot.pose)
        return poses

    def _room_ahead(self, pose: Pose, heading: float) -> float:
        ahead = np.array([[np.cos(heading), np.sin(heading), 0.0]])
        return float(self._scene.cast((pose.position + up(0.6))[None], ahead)[0])

    def _heading(self, pose: Pose) -> float:
        """One of the directions in which there is most room, at random."""
        choices = self._rng.uniform(-np.pi, np.pi, 6)
        room = [min(self._room_ahead(pose, float(choice)), 8.0) for choice in choices]
        return float(choices[int(np.argmax(room))])

    def _case(self, walk: list[Pose]) -> Case:
        lidar = LidarSimulator(self._scene, self._ground.lidar, self._rng)
        mount = Pose.from_rpy(np.array(self._ground.lidar.mount_m))
        believed = drifted(walk, self._drift, self._rng)
        walked = []
        for true, pose in zip(walk, believed, strict=True):
            scan, _ = lidar.scan(true.compose(mount), 0.0, [(self._carried(true), self._aerial.size_m)])
            walked.append((scan.points(), pose.compose(mount)))
        # the map is where the carrier believes to be: of a drifted walk only the last pose is exact
        to_map = believed[-1].compose(walk[-1].inverse())
        shots = self._shots(walk[-1], to_map)
        return Case(self._source.label, self._source.self_similar, walked, shots, self._wrong(shots[0].truth))

    def _carried(self, ground: Pose) -> Pose:
        return carried_pose(ground, self._ground.size_m[2], self._config.bracket)

    def _shots(self, ground: Pose, to_map: Pose) -> list[Shot]:
        """Two scans from the bracket, between which the carrier sways."""
        lidar = LidarSimulator(self._scene, self._aerial.lidar, self._rng)
        mount = Pose.from_rpy(np.array(self._aerial.lidar.mount_m))
        start = random_pose(self._rng, 20.0, np.pi, 0.1)
        sway = random_pose(self._rng, SWAY_M, SWAY_RAD, SWAY_RAD)
        error = random_pose(self._rng, ODOMETRY_M, ODOMETRY_RAD, ODOMETRY_RAD)
        shots: list[Shot] = []
        for moved, wrong in ((Pose.identity(), Pose.identity()), (sway, error)):
            body = ground.compose(moved)
            pose = self._carried(body).compose(mount)
            scan, _ = lidar.scan(pose, 0.0, [_box_of(body, self._ground)])
            truth = to_map.compose(pose)
            since = truth if not shots else shots[0].truth
            odometry = start.compose(since.inverse().compose(truth)).compose(wrong)
            shots.append(Shot(scan, odometry, truth))
        return shots

    def _wrong(self, truth: Pose) -> Pose:
        """Up to 1.5 m off in any direction, up to 30 deg in heading and a few in attitude."""
        rng = self._rng
        direction = rng.normal(size=3)
        shift = direction / np.linalg.norm(direction) * rng.uniform(0.0, GUESS_M)
        roll, pitch = rng.uniform(-GUESS_TILT_RAD, GUESS_TILT_RAD, 2)
        yaw = rng.uniform(-GUESS_YAW_RAD, GUESS_YAW_RAD)
        turn = Pose.from_rpy(np.zeros(3), float(roll), float(pitch), float(yaw))
        rotated = Pose(np.zeros(3), truth.quaternion).compose(turn)
        return Pose(truth.position + shift, rotated.quaternion)


def random_pose(rng: np.random.Generator, shift_m: float, yaw_rad: float, tilt_rad: float) -> Pose:
    """A normally distributed pose about the identity; the arguments are standard deviations."""
    roll, pitch, yaw = rng.normal(size=3) * (tilt_rad, tilt_rad, yaw_rad)
    return Pose.from_rpy(rng.normal(0.0, shift_m, 3), float(roll), float(pitch), float(yaw))


def drifted(walk: list[Pose], drift: float, rng: np.random.Generator) -> list[Pose]:
    """The walk as an odometry tells it that errs by `drift` of the path in a direction that stays.

    The heading errs along, by half a degree per metre of such errors.
    """
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    believed = walk[:1]
    for last, pose in pairwise(walk):
        step = last.inverse().compose(pose)
        error_m = drift * float(np.linalg.norm(step.position))
        error = Pose.from_rpy(error_m * direction, yaw_rad=error_m * np.deg2rad(30.0) * float(direction[0]))
        believed = [*believed, believed[-1].compose(step).compose(error)]
    return believed


def _box_of(body: Pose, robot: RobotSettings) -> tuple[Pose, tuple[float, float, float]]:
    return body.compose(Pose.from_rpy(up(robot.size_m[2] / 2))), robot.size_m


def drawn(source: Source, config: Config, number: int, count: int, drift: float = 0.0) -> Iterator[Case]:
    """`count` cases of one world, the same ones for the same number; none where nobody can stand."""
    rng = np.random.default_rng([number, 161])
    try:
        yield from Tries(source, config, rng, drift).draw(count)
    except InputError:
        return
