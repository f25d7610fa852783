"""Following the current plan: when to plan again, when to stop, what to do when the robot does not get on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose
from onboard.planning.explorer import Explorer
from onboard.planning.follower import HALT, Velocity, finished, follow, stopping_path
from onboard.planning.local_graph import FloatArray, truncate
from onboard.planning.plan import Plan, onward, remaining_path
from onboard.planning.selection import travel_time
from onboard.planning.startup import LOOK_AROUND
from onboard.robot.monitor import Outlook, look_ahead, void_ahead
from onboard.robot.progress import BackOff, Pacing, Retreats, Watchdog

REVIEW_S = 0.5
AHEAD_S = 0.3
"""Time that a planning cycle may take: it plans from where the robot will be by then."""
RETRY_S = 1.0
NEAR_END_M = 0.8
TURNING_RAD_S = 0.3
CREEPING_M_S = 0.15
GROUND_LOOK_M = 3.0
"""A walking robot's map farther ahead is too rough to stop for."""
SETTLING_S = 1.0
"""The last second of a plan says nothing about the pace: the robot brakes there."""
BLIND = "take-off"
"""Kind of plan that leads through space which another robot has seen."""


class Motion:
    """Holds the plan of one robot and turns it into velocity commands."""

    def __init__(self, settings: RobotSettings, explorer: Explorer) -> None:
        self._settings = settings
        self._explorer = explorer
        self.plan: Plan | None = None
        self.stuck_events = 0
        self._planned_s = -np.inf
        self._reviewed_s = -np.inf
        self._anew = False
        self._accepted_blocked = False
        self._moving: FloatArray = np.zeros(3)
        self._last: tuple[float, FloatArray] = (-np.inf, np.zeros(3))
        self._left_s = np.inf
        self._left_at_s = -np.inf
        self._watchdog = Watchdog()
        self._pacing = Pacing()
        self._back_off = BackOff()
        self._left = Retreats()

    def adopt(self, now_s: float, plan: Plan | None) -> None:
        """Follow this plan from now on; None or an empty one stops the robot."""
        self.plan = plan if plan is not None and len(plan.path) else None
        self._planned_s = now_s
        self._reviewed_s = now_s
        self._accepted_blocked = self._anew = False
        self._left_s = np.inf
        if self.plan is None:
            self._watchdog.idle()
        elif self._settings.kind == "ground":
            # the planner took it knowing the map (a trail that was walked): feel the way, do not wait
            explorer, near = self._explorer, truncate(self.plan.path, GROUND_LOOK_M)
            blocked = explorer.path_blocked(near, GROUND_LOOK_M)
            self._accepted_blocked = blocked or void_ahead(self._settings, explorer.map, near)

    def due(self, now_s: float, pose: Pose) -> bool:
        """Whether it is time to plan."""
        if self._back_off.command(now_s, pose) is not None:
            return False
        since = now_s - self._planned_s
        if self.plan is None:
            return since >= RETRY_S
        if self.plan.kind == LOOK_AROUND:
            return False
        if since < RETRY_S:
            return False
        if self._anew or self._outdated(now_s, pose, self.plan):
            return True
        return since >= self._settings.planner.replan_s or stopping_path(self.plan.path, pose, NEAR_END_M)

    def _outdated(self, now_s: float, pose: Pose, plan: Plan) -> bool:
        """Whether the plan is no longer the one to follow, asked every REVIEW_S."""
        if self._accepted_blocked or now_s - self._reviewed_s < REVIEW_S - 1e-6:
            return False
        self._reviewed_s = now_s
        return self._explorer.review(now_s, pose.position, plan) is not None

    def ahead(self, pose: Pose) -> FloatArray:
        """Reference point (3,) where a flying robot will be after AHEAD_S on its plan; where another is."""
        if self._settings.kind != "aerial" or self.plan is None:
            return pose.position
        way = remaining_path(pose.position, self.plan.path)
        speed = float(np.linalg.norm(self._moving))
        return np.asarray(truncate(way, max(1e-3, speed * AHEAD_S))[-1])

    def joined(self, pose: Pose, plan: Plan) -> Plan:
        """A plan made from where the robot will be, beginning where it is."""
        if len(plan.path) == 0 or np.linalg.norm(plan.path[0] - pose.position) < 1e-6:
            return plan
        return replace(plan, path=np.concatenate([pose.position[None], plan.path]))

    def at_end(self, pose: Pose) -> bool:
        """Whether the plan has been followed to its end."""
        return self.plan is None or finished(self._settings, pose, self.plan.path)

    def step(self, now_s: float, pose: Pose) -> Velocity:
        """Velocity command of this step; drops a plan that is blocked or does not get on."""
        moving = self._velocity(now_s, pose)
        backwards = self._back_off.command(now_s, pose)
        if backwards is not None:
            return backwards
        if self.plan is None or self.plan.kind == LOOK_AROUND:
            return HALT if self.plan is None else self._look_around(now_s)
        if not self.at_end(pose) and self._watchdog.stuck(now_s, pose, self.plan):
            self._give_up(now_s, pose, self.plan)
            return HALT
        if self._pacing.going_round(now_s, pose.position, self.plan.goal):
            self._explorer.refuse(now_s, self.plan.goal)
            self._anew = True
        return self._follow(now_s, pose, self.plan, moving)

    def _follow(self, now_s: float, pose: Pose, plan: Plan, moving: FloatArray) -> Velocity:
        """Along the plan, no faster than the collision monitor allows."""
        plan = self.plan = replace(plan, path=onward(pose.position, plan.path))
        self._learn_pace(now_s, pose, plan)
        outlook = self._outlook(pose, plan)
        if outlook is not None and outlook.stop:
            self.drop(now_s)
            return HALT
        command = follow(self._settings, pose, plan.path, moving)
        if outlook is not None:
            self._anew |= outlook.blocked
            command = _slowed(command, outlook.speed_m_s)
        if self._cramped(pose, command):
            self._leave(now_s, pose)
            return HALT
        return command

    def _learn_pace(self, now_s: float, pose: Pose, plan: Plan) -> None:
        """Compare the time that has passed on this plan with the time that the plan gave for it."""
        left_s = travel_time(remaining_path(pose.position, plan.path), self._settings.speed_m_s)
        if SETTLING_S < self._left_s < np.inf:
            self._explorer.budget.pace.observe(now_s - self._left_at_s, self._left_s - left_s)
        self._left_s, self._left_at_s = left_s, now_s

    def _look_around(self, now_s: float) -> Velocity:
        """Once around on the spot, then plan anew."""
        rate = self._settings.yaw_rate_rad_s
        if now_s - self._planned_s > 2 * np.pi / rate:
            self.drop(now_s)
            return HALT
        return Velocity(np.zeros(3), rate)

    def _velocity(self, now_s: float, pose: Pose) -> FloatArray:
        """Velocity (3,) by the difference of the last two poses."""
        last_s, last = self._last
        self._last = now_s, pose.position.copy()
        self._moving = (pose.position - last) / (now_s - last_s) if now_s > last_s else np.zeros(3)
        return self._moving

    def _cramped(self, pose: Pose, command: Velocity) -> bool:
        """Whether the ground robot is about to turn on the spot where its corners would hit something."""
        if self._settings.kind != "ground" or abs(command.yaw_rate) < TURNING_RAD_S:
            return False
        # where going back did not help either, turning is what is left
        if np.linalg.norm(command.linear) > CREEPING_M_S or not self._back_off.useful(pose):
            return False
        if self._explorer.body.room_to_turn(self._explorer.map, pose.position):
            return False
        return self._left.again(pose.position)

    def _outlook(self, pose: Pose, plan: Plan) -> Outlook | None:
        """What the collision monitor says about the next metres, at every step; None: nobody asks it."""
        if self._accepted_blocked or plan.kind == BLIND:
            return None
        way = remaining_path(pose.position, plan.path)
        if self._settings.kind == "ground":
            way = truncate(way, GROUND_LOOK_M)
        return look_ahead(self._settings, self._explorer.body, self._explorer.map, way)

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


def _slowed(command: Velocity, limit_m_s: float) -> Velocity:
    """The command at most this fast."""
    speed = float(np.linalg.norm(command.linear))
    if speed <= limit_m_s:
        return command
    return Velocity(command.linear * (limit_m_s / speed), command.yaw_rate)
