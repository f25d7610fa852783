"""The core of one robot: map, planner, mission, link and motion, stepped with sensor readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onboard.core.config import Config, MapSettings, RobotSettings
from onboard.core.geometry import Pose
from onboard.mapping.room import room
from onboard.mission import ABOARD, Facts, Phase, next_phase
from onboard.planning.air_space import Area
from onboard.planning.cycle import TOO_LATE
from onboard.planning.deployment import flight_time
from onboard.planning.explorer import Explorer
from onboard.planning.follower import HALT, Velocity
from onboard.planning.homing import stop_short
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan, described
from onboard.robot.arrival import Arrival
from onboard.robot.carrier import Carrier
from onboard.robot.flyer import Flyer
from onboard.robot.interface import Inputs, Log, Outputs, Profile
from onboard.robot.keep_clear import keep_clear
from onboard.robot.map_frame import Given, MapFrame
from onboard.robot.mapper import Mapper
from onboard.robot.motion import Motion
from onboard.robot.roles import Role, Team, vector
from onboard.robot.sensing import Sensing
from onboard.robot.soloist import Soloist
from onboard.sharing import LinkCore
from onboard.sharing.messages import Bids, Corrections, Message, Status

RETURN_CHECK_S = 1.0
IDLE_CYCLES = 3
LOOK_AGAIN_S = 10.0
WORTH_RESUMING_M3 = 10.0
MOVING = frozenset({Phase.CARRYING, Phase.EXPLORING})
STILL = ABOARD | {Phase.DEPLOYING, Phase.TAKING_OFF, Phase.DONE}
"""Phases in which the planner moves nothing: a take-off is the autopilot's."""
AHEAD_S = 0.4
"""The room around the place where a flying robot will be after this is what its setpoints are judged by."""

PlannerFactory = Callable[[RobotSettings, MapSettings, int, Area | None], Explorer]
"""Makes the planner of a robot from its settings, the map's, the seed and the area to explore."""


class RobotCore:
    """Everything a robot thinks. No I/O: sensor readings and frames go in, commands and frames come out."""

    def __init__(
        self,
        config: Config,
        settings: RobotSettings,
        seed: int,
        start: Pose,
        log: Log,
        clock: Callable[[], float],
        planner: PlannerFactory = Explorer,
        frame: MapFrame | None = None,
    ) -> None:
        """`planner` exists so that other planners can be compared on the same robot. `frame`: what its poses
        mean, by default that they are right."""
        self.settings = settings
        self.explorer = planner(settings, config.map, seed, config.mission.area_m)
        self.sensing = Sensing(settings, self.explorer.map)
        peers = [robot.id for robot in config.robots if robot.name != settings.name]
        self.link = LinkCore(settings.id, peers, contact_timeout_s=config.mission.contact_timeout_s)
        self.motion = Motion(settings, self.explorer)
        self.profile = Profile(clock)
        self.team = Team(config, settings.name, self.explorer, self.sensing, self.link, log, self.profile)
        self.team.frame = frame or Given()
        self.mapper = Mapper(self.team)
        self.role = self._role(seed, start)
        self.phase = self.role.first_phase
        self.arrived_s: float | None = None
        self._log = log
        self._idle = 0
        self._return_checked_s = -np.inf
        self._must_return = False
        self._arrival = Arrival(settings, config.mission.regroup_radius_m)
        self._way_told = (False, False)
        self._looked_s = -np.inf
        self._epoch = 0
        if settings.kind == "ground":
            self.explorer.begin(start.position, start.yaw)
            self.sensing.assume_floor(start.position)

    def _role(self, seed: int, start: Pose) -> Role:
        if self.settings.kind == "ground":
            return Carrier(self.team, seed, start)
        return Flyer(self.team) if self.team.config.carries(self.settings) else Soloist(self.team, start)

    def step(self, inputs: Inputs) -> Outputs:
        """One control cycle (10 Hz)."""
        now_s, pose = inputs.now_s, self.team.frame.pose(inputs.told)
        located = self.role.located
        self.role.sensed(self.phase, inputs, pose)
        self._epoch += located != self.role.located
        frames = self.link.step(now_s, inputs.frames)
        for source, message in self.link.take_messages():
            self._heard(now_s, source, message, pose)
        pose = self._see(inputs)
        if self.explorer.graph is not None:
            self.explorer.observe(pose.position)
        self._budget(inputs)
        self._advance(now_s, pose)
        velocity = self._move(now_s, pose)
        self.role.tick(now_s, self.phase, pose)
        self.link.set_status(self._status(inputs, pose))
        return Outputs(
            pose,
            velocity,
            self.role.release,
            frames,
            self._epoch,
            self.role.flight(),
            self._room_m(pose, velocity),
            self.role.walk(now_s, self.phase),
        )

    def _room_m(self, pose: Pose, velocity: Velocity) -> float:
        """Distance to what is occupied where a flying robot will be in a moment."""
        if self.settings.kind != "aerial" or self.phase in STILL:
            return 0.0
        ahead = pose.position + AHEAD_S * velocity.linear
        return float(room(self.explorer.map, ahead[None])[0])

    def _heard(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        if isinstance(message, Bids):
            self.team.bidding.came(now_s, message)
        elif isinstance(message, Corrections):
            self.mapper.came(source, message)
        else:
            self.role.handle(now_s, source, message, pose)

    def _see(self, inputs: Inputs) -> Pose:
        """Draw what was seen and heard of; the pose in the map as it then is."""
        mapper, frame, told = self.mapper, self.team.frame, inputs.told
        mapper.receive()
        if inputs.scan is not None and self.maps():
            scan = self.team.without_peers(inputs.scan, frame.pose(told), inputs.now_s)
            mapper.draw(scan, told, self.phase)
        moved = mapper.step(inputs.now_s)
        if moved is not None:
            self._epoch += 1
            self.role.redrawn(moved)
            self.motion.adopt(inputs.now_s - 10.0, None)
        return frame.pose(told)

    def maps(self) -> bool:
        """A robot aboard maps once its carrier has begun to hand over and its own place is known."""
        return self.phase not in ABOARD or (len(self.link.store) > 0 and self.role.located)

    def looks(self) -> bool:
        """Whether scans are wanted."""
        return self.maps() or self.role.searching

    def _budget(self, inputs: Inputs) -> None:
        remaining = self.team.remaining(inputs.now_s)
        if self.settings.kind == "aerial":
            remaining = min(remaining, flight_time(self.settings, inputs.charge))
        self.explorer.budget.remaining_s = remaining
        point = self.role.regroup_point()
        self.explorer.budget.back_to = None if point is None else point - self._regroup_offset()
        self.explorer.peer_goals = self.team.peer_goals(inputs.now_s)

    def _regroup_offset(self) -> FloatArray:
        """Regrouping points are LiDAR positions of the ground robot; a flying one goes there itself."""
        return np.array(self.settings.lidar.mount_m) if self.settings.kind == "ground" else np.zeros(3)

    def _advance(self, now_s: float, pose: Pose) -> None:
        facts = replace(
            self.role.facts(now_s, self.phase, pose),
            nothing_left=self._idle >= IDLE_CYCLES,
            more=self._something_new(now_s, pose),
            must_return=self.phase in MOVING and self._must_go(now_s, pose),
            arrived=self._arrived(now_s, pose),
        )
        following = next_phase(self.phase, facts)
        if following == self.phase:
            return
        if following == Phase.RETURNING:
            self._looked_s = now_s
        self._log("phase", phase=following.name.lower(), position=vector(pose.position), **self._why(facts))
        self.phase = following
        self._idle = 0
        self.motion.adopt(now_s - 10.0, None)
        if following == Phase.WAITING:
            self.arrived_s = now_s
        self.role.entered(now_s, following, pose)

    def _something_new(self, now_s: float, pose: Pose) -> bool:
        """Having run out of goals, look again now and then: peers' keyframes may have opened up new ones."""
        if self.phase not in (Phase.RETURNING, Phase.WAITING) or self._must_return:
            return False
        if now_s - self._looked_s < LOOK_AGAIN_S:
            return False
        self._looked_s = now_s
        plan = self.profile.timed("plan", self.explorer.explore, now_s, pose.position, None)
        return bool(plan.gain_m3 >= WORTH_RESUMING_M3)

    def _why(self, facts: Facts) -> dict[str, object]:
        if self.phase not in MOVING or facts.fire:
            return {}
        if facts.must_return:
            return {"reason": "time to return"}
        left = self.explorer.left
        reason = "no time for what is left to explore" if TOO_LATE in left else "nothing left to explore"
        return {"reason": reason, "left_m3": left}

    def _must_go(self, now_s: float, pose: Pose) -> bool:
        """Once a second: does the way back need all the time that is left?"""
        if now_s - self._return_checked_s >= RETURN_CHECK_S and self.explorer.graph is not None:
            self._return_checked_s = now_s
            self.explorer.verify_ways()
            here = Plan(pose.position[None], "here")
            self._must_return = not self.explorer.affordable(here)
        return self._must_return

    def _arrived(self, now_s: float, pose: Pose) -> bool:
        target = self.explorer.budget.back_to
        at_end = self.phase == Phase.RETURNING and self.motion.plan is not None and self.motion.at_end(pose)
        return self._arrival.at(now_s, self.phase, pose.position, target, at_end=at_end)

    def _move(self, now_s: float, pose: Pose) -> Velocity:
        if self.phase in STILL:
            return HALT
        if self.phase == Phase.WAITING:
            return self._gated(now_s, pose, HALT)
        if self.motion.due(now_s, pose):
            self.motion.adopt(now_s, self._plan(now_s, pose))
        stuck = self.motion.stuck_events
        velocity = self.motion.step(now_s, pose)
        if self.motion.stuck_events > stuck:
            self._log("stuck", position=vector(pose.position))
        return self._gated(now_s, pose, velocity)

    def _gated(self, now_s: float, pose: Pose, velocity: Velocity) -> Velocity:
        """The command of a flying robot after the gate that keeps it clear of the others."""
        if self.settings.kind != "aerial":
            return velocity
        others, braking_m_s2 = self.team.others(now_s), self.settings.acceleration_m_s2
        return keep_clear(velocity, pose.position, others, self._may_fly_to, braking_m_s2)

    def _may_fly_to(self, point: FloatArray) -> bool:
        return bool(self.explorer.passable(point[None], point[None] + 1e-3)[0])

    def _plan(self, now_s: float, pose: Pose) -> Plan | None:
        insisted: Plan | None = self.role.plan(now_s, self.phase, pose)
        if insisted is not None or self.phase == Phase.LANDING:
            return insisted
        if self.phase == Phase.RETURNING:
            return self._plan_return(pose)
        ahead = self.motion.ahead(pose)
        plan: Plan = self.profile.timed("plan", self.explorer.explore, now_s, ahead, self.motion.plan)
        plan = self.motion.joined(pose, plan)
        starting = self.explorer.startup.active(now_s, pose.position)
        self._idle = 0 if len(plan.path) or starting else self._idle + 1
        self.role.planned(now_s, self.phase, pose, plan)
        self.team.bidding.planned(now_s, self.explorer.cycle.candidates, self.team.exploring_peers())
        self._log("plan", **described(plan))
        self._log("cycle", **self.explorer.cycle.described())
        return plan

    def _plan_return(self, pose: Pose) -> Plan | None:
        """Way to the regrouping point; an aerial robot stops short of it and leaves the place itself to
        the other."""
        target = self.explorer.budget.back_to
        assert target is not None
        plan = self.explorer.go_to(pose.position, target)
        self._report_way_back(pose, plan)
        if self.settings.kind == "ground" or len(plan.path) == 0:
            return plan
        near_m = self.team.config.mission.regroup_radius_m * 0.7
        return stop_short(plan, target, near_m, self.explorer.visible)

    def _report_way_back(self, pose: Pose, plan: Plan) -> None:
        """Tell when the way back begins or ceases to look blocked, or too long for the time that is left."""
        blocked, late = self.explorer.way_blocked, self.explorer.budget.too_late(plan.time_s)
        if (blocked, late) != self._way_told:
            self._way_told = blocked, late
            self._log("way_back", blocked=blocked, late=late, position=vector(pose.position))

    def _status(self, inputs: Inputs, pose: Pose) -> Status:
        plan = self.motion.plan
        return Status(
            stamp_s=inputs.now_s,
            phase=int(self.phase),
            position_m=vector(pose.position),
            battery_ratio=float(np.clip(inputs.charge, 0.0, 1.0)),
            goal_m=None if plan is None else vector(plan.goal),
            remaining_s=max(0.0, self.team.remaining(inputs.now_s)),
            keyframes=len(self.team.keyframe_positions),
        )
