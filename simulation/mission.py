"""The lock-step mission: robots, radio and scoring advance together, one tick after the other, by seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from drivers.bracket_wire import load_wire
from onboard.core.config import Config, RobotSettings
from onboard.core.geometry import Pose
from onboard.localization.bracket import bracket_of, carried_pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.mission import Phase
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory
from onboard.robot.interface import BracketState
from onboard.robot.sensing import CLEARING_M
from simulation.aerial_robot import AerialRobot
from simulation.agent import Agent, launch_pose
from simulation.bodies import ContactCounter
from simulation.localisation import Poses
from simulation.radio import Radio
from simulation.release import ReleaseRig
from simulation.scene import Scene
from simulation.worlds import World

TICK_S = 0.1
SEPARATION_S = 3.0
"""So long after it has left its carrier, contact of a robot with another one counts as a collision."""
LANDING_S = 40.0
"""A robot that is coming down when the time is over does so."""

EventSink = Callable[..., None]


def with_colocalisation(config: Config) -> Config:
    """The configuration for robots of which those aboard do not know where they are."""
    deployment = config.deployment.model_copy(update={"colocalise": True})
    return config.model_copy(update={"deployment": deployment})


class Mission:
    """All state of one simulated mission. `events` is called as events(time_s, kind, **fields)."""

    def __init__(
        self,
        config: Config,
        world: World,
        scene: Scene,
        seed: int,
        events: EventSink,
        planner: PlannerFactory = Explorer,
        poses: Poses = "estimated",
    ) -> None:
        self.config = config if poses == "true" else with_colocalisation(config)
        self.world = world
        self.now_s = 0.0
        self.ticks = 0
        self._events = events
        self._wire = load_wire()
        self._start = Pose.from_rpy(world.start, yaw_rad=world.start_yaw_rad)
        self.agents = [self._make(settings, scene, seed, planner, poses) for settings in config.robots]
        self.rigs = {
            agent.settings.id: self._rig(agent) for agent in self.agents if config.carries(agent.settings)
        }
        """Brackets by the ids of the robots that begin in them."""
        self.by_id = {agent.settings.id: agent for agent in self.agents}
        self.carriers = [agent for agent in self.agents if agent.settings.kind == "ground"]
        self.lead = self.carriers[0] if self.carriers else self.agents[0]
        """The robot whose map is the team's at the end."""
        self.radio = Radio(config.radio, scene, np.random.default_rng([seed, 99]))
        # what a perfect sensor would have built along the same paths: only the final score reads it
        self.reference = VoxelMap(config.map.voxel_m, config.map.max_range_m)
        self._contacts = ContactCounter()
        self.meetings = 0
        self.deployment: dict[str, Any] | None = None
        self.seed = seed

    def _make(
        self, settings: RobotSettings, scene: Scene, seed: int, planner: PlannerFactory, poses: Poses
    ) -> Agent:
        def log(kind: str, **fields: Any) -> None:
            self._events(round(self.now_s, 3), kind, robot=settings.name, **fields)

        start = self._start
        if settings.kind == "aerial":
            start = launch_pose(start, self.config, bracket_of(settings.id, self.config.robots))
        return Agent(self.config, settings, scene, seed, start, log, planner, poses)

    def _rig(self, agent: Agent) -> ReleaseRig:
        assert isinstance(agent.body, AerialRobot)
        agent.body.attached = True
        return ReleaseRig(self._wire, agent.settings.id)

    def done(self) -> bool:
        """Whether every robot has finished or the time is over."""
        late_s = self.now_s - self.config.mission.duration_s
        landing = any(agent.core.phase == Phase.LANDING for agent in self.agents)
        over = late_s >= (LANDING_S if landing else 0.0) - 1e-9
        return over or all(agent.finished() for agent in self.agents)

    def tick(self) -> None:
        """Advance by TICK_S."""
        positions = {agent.settings.id: agent.pose.position for agent in self.agents}
        for _, target, frame in self.radio.deliver(self.now_s, positions):
            self.by_id[target].inbox.append(frame)
        brackets = {robot: rig.state for robot, rig in self.rigs.items()}
        for agent in self.agents:
            self._tick_agent(agent, brackets)
        self._carry()
        self._count_meetings()
        self.ticks += 1
        self.now_s = self.ticks * TICK_S

    def _tick_agent(self, agent: Agent, brackets: Mapping[int, BracketState]) -> None:
        others = [other.box() for other in self.agents if other is not agent]
        scans = agent.scan(self.now_s, others)
        if scans is not None:
            sensor = agent.core.sensing.sensor_pose(agent.pose).matrix()
            perfect = scans[1]
            self.reference.integrate(
                perfect.rays(self.config.map.max_range_m * CLEARING_M),
                sensor,
                min_range_m=perfect.model.min_range_m,
            )
        outputs = agent.think(self.now_s, TICK_S, None if scans is None else scans[0], brackets)
        for target, frame in outputs.frames:
            self.radio.send(self.now_s, agent.settings.id, target, frame)
        if agent is self.lead:
            for robot, rig in self.rigs.items():
                rig.step(self.now_s, TICK_S, permitted=outputs.release == robot)
        before = agent.body.collisions
        agent.move(self.now_s, TICK_S, outputs)
        if agent.body.collisions > before:
            place = [round(float(value), 2) for value in agent.pose.position]
            self._events(round(self.now_s, 3), "collision", robot=agent.name, position=place)

    def _carry(self) -> None:
        """Who begins on the carrier's back goes with it until it flies off; the latch allows that or not."""
        for robot, rig in self.rigs.items():
            body = self.by_id[robot].body
            assert isinstance(body, AerialRobot)
            body.attached = rig.holds
            place = bracket_of(robot, self.config.robots)
            height_m = self.lead.settings.size_m[2]
            body.carry(carried_pose(self.lead.pose, height_m, self.config.bracket, place))

    def _count_meetings(self) -> None:
        """Contact between a flying robot and the body of another robot."""
        for flyer in self.agents:
            left_s = flyer.body.left_s if isinstance(flyer.body, AerialRobot) else None
            if left_s is None or self.now_s - left_s < SEPARATION_S:
                continue
            for other in self.agents:
                if other is flyer:
                    continue
                pose, size = other.box()
                local = np.abs(pose.rotation.T @ (flyer.pose.position - pose.position)) - np.array(size) / 2
                gap = float(np.linalg.norm(np.maximum(local, 0.0))) - max(flyer.settings.size_m) / 2
                if gap < 0:
                    self._contacts.touch(self.now_s, flyer.pose.position)
        self.meetings = self._contacts.events

    def phase(self) -> str:
        """Phases of all robots in words."""
        return "/".join(agent.core.phase.name.lower() for agent in self.agents)
