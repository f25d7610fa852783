"""Walks of the simulated base through a building, on paths of the ground planner, commanded on the wire."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from drivers.ros_messages import encode_command
from onboard.core.config import BaseLink, RobotSettings
from onboard.core.geometry import FloatArray, Pose, tilt
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.ground_graph import build_ground_graph
from onboard.planning.plan import onward
from onboard.robot.tracker import BaseTracker, Stamped, StampedPath
from simulation.base_node import BaseNode
from simulation.ground_robot import GroundRobot
from simulation.legged_base import BaseTraits, LeggedBase
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds import World

DT_S = 0.02
COMMAND_STEPS = 2
"""A command every 40 ms."""
POSE_AGE_STEPS = 3
"""Poses are 60 ms old when they are used: registration takes its time."""
SCAN_STEPS = 50
LEG_S = 90.0
STAND_S = 2.0
LEVEL_WORTH = 4.0
"""Metres of way that a metre of climb is worth when the next goal is chosen: stairs are to be walked."""


@dataclass(slots=True)
class Track:
    """What was measured while the base followed its paths."""

    across_m: list[float] = field(default_factory=list)
    """Horizontal distance from the path."""
    speed_m_s: list[float] = field(default_factory=list)
    """Horizontal."""
    tilt_rad: list[float] = field(default_factory=list)
    path_m: float = 0.0
    climbed_m: float = 0.0
    legs: int = 0
    arrived: int = 0


class BuildingWalk:
    """One robot in one world: scans, plans, walks."""

    def __init__(self, world: World, settings: RobotSettings, traits: BaseTraits, seed: int = 0) -> None:
        scene = Scene(world.vertices, world.triangles)
        link = BaseLink(bridge="ros2dds")
        self._settings = settings
        self._link = link
        self.robot = GroundRobot(settings, scene, world.start, world.start_yaw_rad)
        self.node = BaseNode(LeggedBase(self.robot, traits, seed), link)
        self.tracker = BaseTracker(settings, link.stairs_speed_m_s)
        self._lidar = LidarSimulator(scene, settings.lidar, np.random.default_rng(seed))
        self._map = VoxelMap(0.2, settings.planner.gain_range_m)
        self._poses: deque[Stamped] = deque(maxlen=POSE_AGE_STEPS + 1)
        self._seen: list[FloatArray] = []
        self._steps = 0
        self.track = Track()
        self._stand_up()

    def _stand_up(self) -> None:
        self.node.serve("stand")
        steps = np.arange(-1.5, 1.5, 0.1)
        disc = np.stack(np.meshgrid(steps, steps, [-0.02]), axis=-1).reshape(-1, 3)
        self._map.assume_occupied(self.robot.pose.position + disc)  # no LiDAR sees the floor at its feet
        while self.node.base.clock_s < STAND_S:
            self._advance(None)

    def leg(self) -> bool:
        """Plan to the most promising place and walk there; False where there is none."""
        path = self._plan()
        if path is None:
            return False
        self.track.legs += 1
        end_s = self.node.base.clock_s + LEG_S
        while self.node.base.clock_s < end_s:
            if self._advance(path) == "arrived":
                self.track.arrived += 1
                break
        return True

    def _plan(self) -> FloatArray | None:
        here = self.robot.pose.position
        graph = build_ground_graph(self._map, here, self._settings.planner)
        best, worth = None, 1.0
        for vertex in range(len(graph.points)):
            point = graph.points[vertex]
            near = min((float(np.linalg.norm(point - seen)) for seen in self._seen), default=20.0)
            value = min(near, 8.0) + LEVEL_WORTH * abs(float(point[2] - here[2]))
            if near > 2.0 and value > worth:
                best, worth = vertex, value
        if best is None:
            return None
        self._seen.append(graph.points[best])
        return np.concatenate([here[None], graph.path(best)])

    def _advance(self, path: FloatArray | None) -> str:
        """One step of time; what the tracker said."""
        now_s = self.node.base.clock_s
        self._poses.append(Stamped(now_s, self.robot.pose))
        halt = ""
        if self._steps % COMMAND_STEPS == 0:
            halt = self._command(now_s, path)
        if self._steps % SCAN_STEPS == 0:
            self._scan()
        before = self.robot.pose.position
        self.node.step(DT_S)
        self._steps += 1
        if path is not None:
            self._measure(path, before)
        return halt

    def _command(self, now_s: float, path: FloatArray | None) -> str:
        given = None if path is None else StampedPath(now_s, path)
        standing = self.node.base.posture == "stand"
        drive = self.tracker.step(now_s, self._poses[0], given, standing, self.robot.velocity_m_s)
        self.node.receive(encode_command("TwistStamped", drive.velocity, now_s, "base_link"), None)
        return drive.halt

    def _scan(self) -> None:
        mount = Pose.from_rpy(np.array(self._settings.lidar.mount_m))
        pose = self.robot.pose.compose(mount)
        scan, _ = self._lidar.scan(pose, 0.0)
        self._map.integrate(scan.rays(25.0), pose.matrix(), min_range_m=0.6)

    def _measure(self, path: FloatArray, before: FloatArray) -> None:
        track, after = self.track, self.robot.pose
        step = after.position - before
        track.across_m.append(across(after.position, path))
        track.speed_m_s.append(float(np.hypot(step[0], step[1])) / DT_S)
        track.tilt_rad.append(tilt(after))
        track.path_m += float(np.hypot(step[0], step[1]))
        track.climbed_m += abs(float(step[2]))


def across(position: FloatArray, path: FloatArray) -> float:
    """Horizontal distance (m) of a position from the nearest leg of a path (M, 3)."""
    legs = onward(position, path)
    start, leg = legs[0, :2], legs[1, :2] - legs[0, :2]
    along = float(np.clip((position[:2] - start) @ leg / max(float(leg @ leg), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(position[:2] - start - along * leg))
