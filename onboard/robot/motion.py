"""Following the current plan: when to plan again, when to stop, what to do when the robot does not get on."""

from __future__ import annotations

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose
from onboard.planning.explorer import Explorer
from onboard.planning.follower import HALT, Velocity, finished, follow, stopping_path
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan, remaining_path
from onboard.robot.progress import BackOff, Watchdog

MONITOR_S = 0.5
MONITOR_AHEAD_M = 3.0
RETRY_S = 1.0
NEAR_END_M = 0.8
TURNING_RAD_S = 0.3
CREEPING_M_S = 0.15


class Motion:
    """Holds the plan of one robot and turns it into velocity commands."""

    def __init__(self, settings: RobotSettings, explorer: Explorer) -> None:
        self._settings = settings
        self._explorer = explorer
        self.plan: Plan | None = None
        self.stuck_events = 0
        self._planned_s = -np.inf
        self._checked_s = -np.inf
        self._accepted_blocked = False
        self._last: tuple[float, FloatArray] = (-np.inf, np.zeros(3))
        self._watchdog = Watchdog()
        self._back_off = BackOff()

    def adopt(self, now_s: float, plan: Plan | None) -> None:
        """Follow this plan from now on; None or an empty one stops the robot."""
        self.plan = plan if plan is not None and len(plan.path) else None
        self._planned_s = now_s
        self._accepted_blocked = False
        if self.plan is None:
            self._watchdog.idle()
        elif self._settings.kind == "ground":
            # the planner took it knowing the map (a trail that was walked): feel the way, do not wait
            self._accepted_blocked = self._explorer.path_blocked(self.plan.path, MONITOR_AHEAD_M)

    def due(self, now_s: float, pose: Pose) -> bool:
        """Whether it is time to plan."""
        if self._back_off.command(now_s, pose) is not None:
            return False
        since = now_s - self._planned_s
        if self.plan is None:
            return since >= RETRY_S
        if since < RETRY_S:
            return False
        return since >= self._settings.planner.replan_s or stopping_path(self.plan.path, pose, NEAR_END_M)

    def at_end(self, pose: Pose) -> bool:
        """Whether the plan has been followed to its end."""
        return self.plan is None or finished(self._settings, pose, self.plan.path)

    def step(self, now_s: float, pose: Pose) -> Velocity:
        """Velocity command of this step; drops a plan that is blocked or does not get on."""
        moving = self._velocity(now_s, pose)
        backwards = self._back_off.command(now_s, pose)
        if backwards is not None:
            return backwards
        if self.plan is None:
            return HALT
        if not self.at_end(pose) and self._watchdog.stuck(now_s, pose, self.plan):
            self._give_up(now_s, pose, self.plan)
            return HALT
        if self._newly_blocked(now_s, pose, self.plan):
            self.drop(now_s)
            return HALT
        command = follow(self._settings, pose, self.plan.path, moving)
        if self._cramped(pose, command):
            self._leave(now_s, pose)
            return HALT
        return command

    def _velocity(self, now_s: float, pose: Pose) -> FloatArray:
        """Velocity (3,) by the difference of the last two poses."""
        last_s, last = self._last
        self._last = now_s, pose.position.copy()
        return (pose.position - last) / (now_s - last_s) if now_s > last_s else np.zeros(3)

    def _cramped(self, pose: Pose, command: Velocity) -> bool:
        """Whether the ground robot is about to turn on the spot where its corners would hit something."""
        if self._settings.kind != "ground" or abs(command.yaw_rate) < TURNING_RAD_S:
            return False
        # where going back did not help either, turning is what is left
        if np.linalg.norm(command.linear) > CREEPING_M_S or not self._back_off.useful(pose):
            return False
        return not self._explorer.body.room_to_turn(self._explorer.map, pose.position)

    def _newly_blocked(self, now_s: float, pose: Pose, plan: Plan) -> bool:
        """Collision monitor: whether the map now shows an obstacle on the next metres."""
        if self._accepted_blocked or now_s - self._checked_s < MONITOR_S:
            return False
        self._checked_s = now_s
        return self._explorer.path_blocked(remaining_path(pose.position, plan.path), MONITOR_AHEAD_M)

    def drop(self, now_s: float) -> None:
        """Stop and plan anew as soon as possible."""
        self.plan = None
        self._planned_s = now_s - RETRY_S

    def _give_up(self, now_s: float, pose: Pose, plan: Plan) -> None:
        """Something that the map does not show is in the way: remember it, leave this goal, back off."""
        self.stuck_events += 1
        self._explorer.refuse(now_s, plan.goal)
        if self._settings.kind == "ground" and self._back_off.useful(pose):
            # one barrier a place: more of them would wall the robot in
            self._explorer.map.assume_occupied(self._barrier(pose, plan))
        self._leave(now_s, pose)

    def _leave(self, now_s: float, pose: Pose) -> None:
        """Go back a little without turning and plan anew."""
        self._watchdog.idle()
        self.drop(now_s)
        body, voxel_map = self._explorer.body, self._explorer.map
        self._back_off.start(
            now_s, pose, self._explorer.trail, lambda target: body.sweep_blocked(voxel_map, pose, target)
        )

    def _barrier(self, pose: Pose, plan: Plan) -> FloatArray:
        """Points (N, 3) of a wall as wide as the body across the way, just ahead of it."""
        way = remaining_path(pose.position, plan.path)
        forward = way[min(1, len(way) - 1)] - way[0]
        heading = np.arctan2(forward[1], forward[0])
        length, width, height = self._settings.size_m
        across = np.arange(-width / 2, width / 2 + 0.1, 0.2)
        up = np.arange(0.5, height, 0.2)
        points = np.array([(length / 2 + 0.15, side, level) for side in across for level in up])
        return pose.position + points @ Pose.from_rpy(np.zeros(3), yaw_rad=float(heading)).rotation.T
