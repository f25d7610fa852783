"""One simulated robot: the real core on a simulated body with a simulated LiDAR."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from onboard.core.config import Config, RobotSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.bracket import carried_pose
from onboard.mission import Phase
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory, RobotCore
from onboard.robot.interface import Inputs, Log, Outputs
from simulation.aerial_robot import AerialRobot
from simulation.ground_robot import GroundRobot
from simulation.lidar import Body, LidarSimulator
from simulation.scene import Scene

STAND_M = 0.5
"""Height of a flying robot's centre over the floor on the stand from which it takes off by itself."""


class Agent:
    """Steps core and body together. `pose` is what the (perfect) localisation tells the core."""

    def __init__(
        self,
        config: Config,
        settings: RobotSettings,
        scene: Scene,
        seed: int,
        start: Pose,
        log: Log,
        planner: PlannerFactory = Explorer,
    ) -> None:
        self.settings = settings
        noise = np.random.default_rng([seed, settings.id, 7])
        self._lidar = LidarSimulator(scene, settings.lidar, noise)
        self._scan_period_s = 1.0 / settings.lidar.rate_hz
        self._next_scan_s = 0.0
        self.body: GroundRobot | AerialRobot
        if settings.kind == "ground":
            self.body = GroundRobot(settings, scene, start.position, start.yaw)
        else:
            self.body = AerialRobot(settings, scene, start)
        self.core = RobotCore(config, settings, seed, self.body.pose, log, time.perf_counter, planner)
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
        return isinstance(self.body, AerialRobot) and self.body.attached

    def box(self) -> Body:
        """Centre and size of the body, as other robots' LiDARs see it."""
        if self.settings.kind == "aerial":
            return self.pose, self.settings.size_m
        lift = Pose.from_rpy(np.array([0.0, 0.0, self.settings.size_m[2] / 2]))
        return self.pose.compose(lift), self.settings.size_m

    def scan(self, now_s: float, others: Sequence[Body]) -> tuple[Scan, Scan] | None:
        """The measured and the perfect scan if one is due and the core maps."""
        if now_s + 1e-9 < self._next_scan_s or not self.core.maps():
            return None
        self._next_scan_s = now_s + self._scan_period_s
        return self._lidar.scan(self.core.sensing.sensor_pose(self.pose), now_s, others)

    def think(self, now_s: float, scan: Scan | None) -> Outputs:
        """One cycle of the core on what the sensors say."""
        frames, self.inbox = tuple(self.inbox), []
        return self.core.step(Inputs(now_s, self.pose, self.body.battery_left, scan, frames))

    def move(self, now_s: float, dt_s: float, outputs: Outputs) -> None:
        """Move the body as commanded."""
        if isinstance(self.body, GroundRobot):
            self.body.step(dt_s, outputs.velocity.linear[:2], outputs.velocity.yaw_rate)
        else:
            self.body.step(dt_s, outputs.velocity.linear, outputs.velocity.yaw_rate)
        x, y, z = self.pose.position
        self.path.append((now_s, float(x), float(y), float(z)))

    def finished(self) -> bool:
        """Whether this robot has nothing more to do."""
        return self.core.phase == Phase.DONE or self.carried


def bracket_of(robot_id: int, robots: Sequence[RobotSettings]) -> int:
    """Which of the carrier's places an aerial robot has."""
    return [robot.id for robot in robots if robot.kind == "aerial"].index(robot_id)


def launch_pose(start: Pose, config: Config, place: int = 0) -> Pose:
    """Where an aerial robot's centre is at first: in the first ground robot's bracket, or on a stand."""
    for robot in config.robots:
        if robot.kind == "ground":
            return carried_pose(start, robot.size_m[2], config.bracket, place)
    return start.compose(Pose.from_rpy(np.array([0.0, 0.0, STAND_M])))
