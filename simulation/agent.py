"""One simulated robot: the real core on a simulated body with a simulated LiDAR."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np

from onboard.core.config import Config, RobotSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.bracket import carried_pose
from onboard.mission import ABOARD, Phase
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory, RobotCore
from onboard.robot.interface import BracketState, Inputs, Log, Outputs
from onboard.robot.map_frame import Estimated, Given, MapFrame
from simulation.aerial_robot import AerialRobot
from simulation.lidar import Body, LidarSimulator
from simulation.localisation import EstimatedLocalisation, Localisation, Poses, TrueLocalisation
from simulation.scene import Scene
from simulation.walked import WalkedBase

STAND_M = 0.5
"""Height of a flying robot's centre over the floor on the stand from which it takes off by itself."""


class Agent:
    """Steps core and body together. `pose` is the true one; the core is told what `localisation` says."""

    def __init__(
        self,
        config: Config,
        settings: RobotSettings,
        scene: Scene,
        seed: int,
        start: Pose,
        log: Log,
        planner: PlannerFactory = Explorer,
        poses: Poses = "estimated",
    ) -> None:
        self.settings = settings
        noise = np.random.default_rng([seed, settings.id, 7])
        self._lidar = LidarSimulator(scene, settings.lidar, noise)
        self._scan_period_s = 1.0 / settings.lidar.rate_hz
        self._next_scan_s = 0.0
        self.body: WalkedBase | AerialRobot
        if settings.kind == "ground":
            self.body = WalkedBase(settings, scene, start.position, start.yaw, seed=seed)
        else:
            self.body = AerialRobot(settings, scene, start, seed, log, config.mission.area_m)
        carried = config.carries(settings)
        self.localisation, frame = localised(poses, settings, self.body.pose, seed, carried=carried)
        self.core = RobotCore(config, settings, seed, self.body.pose, log, time.perf_counter, planner, frame)
        self.pose_error_m = self.worst_pose_error_m = 0.0
        """Distance between where the core believes the body to be and where it is: now, and at most."""
        self.inbox: list[bytes] = []
        self.path: list[tuple[float, float, float, float]] = []

    @property
    def name(self) -> str:
        return self.settings.name

    @property
    def pose(self) -> Pose:
        return self.body.pose

    @property
    def carried(self) -> bool:
        """Whether it stands on its carrier, held by the bracket or not."""
        return isinstance(self.body, AerialRobot) and self.body.aboard

    def box(self) -> Body:
        """Centre and size of the body, as other robots' LiDARs see it."""
        if self.settings.kind == "aerial":
            return self.pose, self.settings.size_m
        lift = Pose.from_rpy(np.array([0.0, 0.0, self.settings.size_m[2] / 2]))
        return self.pose.compose(lift), self.settings.size_m

    def scan(self, now_s: float, others: Sequence[Body]) -> tuple[Scan, Scan] | None:
        """The measured and the perfect scan if one is due and the core wants it."""
        if now_s + 1e-9 < self._next_scan_s or not self.core.looks():
            return None
        self._next_scan_s = now_s + self._scan_period_s
        return self._lidar.scan(self.core.sensing.sensor_pose(self.pose), now_s, others)

    def think(
        self, now_s: float, dt_s: float, scan: Scan | None, brackets: Mapping[int, BracketState]
    ) -> Outputs:
        """One cycle of the core on what the sensors say, `dt_s` after the one before."""
        self.localisation.moved(self.pose, dt_s)
        if scan is not None:
            self.localisation.scanned(scan)
        frames, self.inbox = tuple(self.inbox), []
        told, charge = self.localisation.told(), self.body.battery_left
        if isinstance(self.body, AerialRobot):
            inputs = Inputs(now_s, told, charge, scan, frames, flight=self.body.report)
        else:
            base = self.body.odometry
            inputs = Inputs(now_s, told, charge, scan, frames, base=base, brackets=brackets)
        outputs = self.core.step(inputs)
        if self.core.phase not in ABOARD:
            self.pose_error_m = float(np.linalg.norm(outputs.pose.position - self.pose.position))
            self.worst_pose_error_m = max(self.worst_pose_error_m, self.pose_error_m)
        return outputs

    def move(self, now_s: float, dt_s: float, outputs: Outputs) -> None:
        """Let the body live on with what the core has said."""
        if isinstance(self.body, AerialRobot):
            self.body.step(now_s, dt_s, outputs)
        else:
            assert outputs.walk is not None
            self.body.step(now_s, dt_s, outputs.velocity, outputs.pose, outputs.walk)
        x, y, z = self.pose.position
        self.path.append((now_s, float(x), float(y), float(z)))

    def finished(self) -> bool:
        """Whether this robot has nothing more to do."""
        return self.core.phase == Phase.DONE or self.core.phase in ABOARD


def localised(
    poses: Poses, settings: RobotSettings, start: Pose, seed: int, carried: bool
) -> tuple[Localisation, MapFrame]:
    """The localisation of a robot at `start` in the map's frame, and what its core makes of the poses.

    One that is carried has to find out by itself where it is.
    """
    if poses == "true":
        return TrueLocalisation(start), Given()
    mount = Pose.from_rpy(np.array(settings.lidar.mount_m))
    noise = np.random.default_rng([seed, settings.id, 13])
    known = None if carried else start
    return EstimatedLocalisation(start, mount, noise), Estimated(settings.id, mount, known)


def launch_pose(start: Pose, config: Config, place: int = 0) -> Pose:
    """Where an aerial robot's centre is at first: in the first ground robot's bracket, or on a stand."""
    for robot in config.robots:
        if robot.kind == "ground":
            return carried_pose(start, robot.size_m[2], config.bracket, place)
    return start.compose(Pose.from_rpy(np.array([0.0, 0.0, STAND_M])))
