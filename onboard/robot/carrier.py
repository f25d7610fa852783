"""The ground robot's role: carry, decide when to release, hand over map and target, agree on where to
meet."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose
from onboard.localization.bracket import bracket_of, carried_sensor_pose
from onboard.mapping.voxel_map import FREE
from onboard.mission import FLYING, Facts, Phase
from onboard.planning.body import Body
from onboard.planning.deployment import TAKE_OFF_M, AerialOutlook, Decision, Trigger, aerial_outlook
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.regroup import Acceptor, thinned
from onboard.planning.relocation import Moved
from onboard.robot.cloud_offer import CloudOffer
from onboard.robot.handover import HandOver, Outcome, Stance, Standing
from onboard.robot.interface import BracketState, FlightOrders, Inputs
from onboard.robot.localised import Localised
from onboard.robot.roles import Team, vector
from onboard.safety import BRACKET_AT_REST, NO_BRACKET
from onboard.safety_facts import BaseFacts
from onboard.sharing.messages import Ack, Commit, Located, Message, Missing, Propose, Times, TravelTime

RETRY_S = 120.0
TIMES_SPACING_M = 3.0
MAX_OFFERED = 60
DOUBT_WAIT_S = 20.0


class Carrier:
    """Role of a ground robot with any number of aerial robots aboard, released one after the other."""

    located = True
    searching = False

    def __init__(self, team: Team, seed: int, start: Pose) -> None:
        self._team = team
        self._aboard = [peer for peer in team.peers if peer.kind == "aerial"]
        self.first_phase = Phase.CARRYING if self._aboard else Phase.EXPLORING
        home = team.sensing.sensor_pose(start).position
        self._acceptor = Acceptor([home])
        self._doubt_since_s: float | None = None
        self._deployed: list[RobotSettings] = []
        self._hand_over: HandOver | None = None
        self._localised = Localised(required=team.config.deployment.colocalise)
        self._offer: CloudOffer | None = None
        if team.config.deployment.colocalise:
            self._offer = CloudOffer(team.link, team.config.radio.rate_bytes_s)
        self._standing = Standing()
        self._brackets: Mapping[int, BracketState] = {}
        self._not_before_s = 0.0
        self._times_sent_s = -np.inf
        self._decision: Decision | None = None
        self._outlook: AerialOutlook | None = None
        self._rng = np.random.default_rng([seed, team.settings.id, 1])
        self._trigger: Trigger | None = None
        self._virtual: Body | None = None
        self._prepare_next()

    def _prepare_next(self) -> None:
        if self._aboard:
            settings = self._aboard[0]
            self._trigger = Trigger(self._team.config.deployment, settings)
            self._virtual = Body(settings, self._team.config.map.voxel_m, self._team.config.mission.area_m)

    def regroup_point(self) -> FloatArray | None:
        return self._acceptor.points[0]

    @property
    def release(self) -> int | None:
        """The robot whose bracket may open now."""
        return None if self._hand_over is None else self._hand_over.release

    def flight(self) -> FlightOrders:
        """It does not fly."""
        return FlightOrders()

    def walk(self, now_s: float, phase: Phase) -> BaseFacts:
        """For the gate of the base: a bracket that holds a robot must be at rest."""
        states = [self._state_of(robot) for robot in self._aboard]
        worst = next((state for state in states if state not in BRACKET_AT_REST), "LOCKED")
        opened = self._hand_over is not None and self._hand_over.opened_s is not None
        return BaseFacts(
            now_s=now_s,
            phase=phase,
            bracket=worst if self._aboard else NO_BRACKET,
            bracket_empty=not self._aboard,
            departed=not opened,
        )

    def _state_of(self, robot: RobotSettings) -> str:
        bracket = self._brackets.get(robot.id)
        return "" if bracket is None else bracket.state

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Keep how the base stands and what the LiDAR sees around the carrier for whoever is aboard."""
        self._standing.sensed(inputs.base)
        self._brackets = inputs.brackets
        if self._offer is not None and self._aboard and inputs.scan is not None:
            self._offer.saw(inputs.scan, self._team.sensing.sensor_pose(pose))

    def redrawn(self, moved: Moved) -> None:
        if self._offer is not None:
            self._offer.follow(moved)

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        decision = self._decision
        self._decision = None
        outcome = self._deploy(now_s, pose) if phase == Phase.DEPLOYING else Outcome.UNDER_WAY
        return Facts(
            fire=decision is not None and decision.fire,
            shared=self._team.all_shared(),
            peer_clear=outcome == Outcome.DONE,
            aborted=outcome == Outcome.ABORTED,
            aboard=bool(self._aboard),
            peers_arrived=self._team.peers_arrived(now_s),
            complete=self._team.all_received(),
        )

    def planned(self, now_s: float, phase: Phase, pose: Pose, plan: Plan) -> None:
        """Ask the deployment question after every planning cycle while carrying."""
        if phase != Phase.CARRYING or self._trigger is None or self._virtual is None:
            return
        if now_s < self._not_before_s:
            return
        team = self._team
        take_off = pose.position + np.array([0.0, 0.0, team.settings.size_m[2] + TAKE_OFF_M])
        settings = team.config.deployment
        self._outlook = None
        if self._overhead_clear(pose):
            self._outlook = team.profile.timed(
                "outlook",
                aerial_outlook,
                team.explorer.map,
                self._virtual,
                take_off,
                self._rng,
                settings.launch_s,
                team.explorer.left_by_peers,
                settings.rule == "paper",
            )
        ground = self._ground_gain(plan, settings.rule)
        status = team.link.peer_status(self._aboard[0].id)
        charge = None if status is None else status.battery_ratio
        self._decision = self._trigger.evaluate(ground, self._outlook, team.remaining(now_s), pose, charge)
        team.log(
            "trigger",
            fire=self._decision.fire,
            reason=self._decision.reason,
            ground=round(self._decision.ground, 3),
            aerial=round(self._decision.aerial, 3),
            threshold=round(self._decision.threshold, 3),
        )

    def _overhead_clear(self, pose: Pose) -> bool:
        """Whether the clearance above the carrier's back is known to be free."""
        clearance_m = self._team.config.deployment.overhead_clearance_m
        back = pose.position + np.array([0.0, 0.0, self._team.settings.size_m[2] + clearance_m / 2])
        box = np.array([0.2, 0.2, clearance_m / 2])
        return bool(self._team.explorer.map.box_status(back[None], box)[0] == FREE)

    def _ground_gain(self, plan: Plan, rule: str) -> float:
        explorer = self._team.explorer
        if len(plan.path) == 0:
            return 0.0
        if rule == "paper":
            body = explorer.body
            counts = body.gain_model.ray_count(explorer.map, plan.path + body.mount, body.area_m)
            return float(np.sum(counts))
        return plan.gain_m3 / (plan.time_s + explorer.settings.planner.start_up_s)

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        team = self._team
        if phase == Phase.WAITING:
            for peer in team.peer_ids:
                if team.peer_phase(peer) in FLYING:
                    team.link.set_sharing(peer, True)
        if phase != Phase.DEPLOYING:
            return
        assert self._outlook is not None
        if not self._deployed:
            self._acceptor = Acceptor([team.sensing.sensor_pose(pose).position])
        place = self._acceptor.points[0]
        robot = self._aboard[0]
        self._localised.begin()
        if self._offer is not None:
            self._offer.begin(now_s, self._localised.name, robot.id, self._aboard_at(pose, robot))
        veto = partial(self._localised.veto, robot.id)
        self._hand_over = HandOver(team, robot, self._outlook, place, now_s, veto)

    def _aboard_at(self, pose: Pose, robot: RobotSettings) -> Pose:
        """The LiDAR of a robot in the bracket."""
        team = self._team
        place = bracket_of(robot.id, team.config.robots)
        return carried_sensor_pose(pose, team.settings.size_m[2], team.config.bracket, robot, place)

    def _deploy(self, now_s: float, pose: Pose) -> Outcome:
        """Go on with the deployment; its end changes who is aboard or when the next try is due."""
        assert self._hand_over is not None
        bracket = self._brackets.get(self._hand_over.robot.id)
        standing = self._standing
        stance = Stance(now_s, pose, standing.odometry_s, standing.since_s, bracket)
        outcome = self._hand_over.step(stance)
        if self._offer is not None:
            self._offer.step(now_s)
            if outcome != Outcome.UNDER_WAY:
                self._offer.end()
        if outcome != Outcome.UNDER_WAY:
            self._hand_over = None
        if outcome == Outcome.DONE:
            self._deployed += self._aboard[:1]
            self._aboard = self._aboard[1:]
            self._prepare_next()
        elif outcome == Outcome.ABORTED:
            self._not_before_s = now_s + RETRY_S
        return outcome

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        match message:
            case Propose():
                point = np.array(message.position_m)
                if self._acceptor.proposed(message.epoch, point, self._can_hold(pose, point)):
                    self._team.link.post(Ack(message.epoch), source)
                    self._doubt_since_s = now_s if self._acceptor.in_doubt else None
            case Commit():
                before = len(self._acceptor.points)
                self._acceptor.committed(message.epoch)
                if len(self._acceptor.points) < before:
                    self._team.log("regroup", position=message.position_m, epoch=message.epoch)
            case Located():
                self._localised.told(now_s, source, message)
                if self._offer is not None:
                    self._offer.told(now_s, source)
            case Missing() if self._offer is not None:
                self._offer.handle(now_s, source, message)
            case _:
                pass

    def _can_hold(self, pose: Pose, point: FloatArray) -> bool:
        """Whether there is time to look for the other robot at a new point (3,), wait, and then go to the
        point agreed on before: in doubt it may be at either."""
        explorer = self._team.explorer
        places = np.stack([point, self._acceptor.points[0]]) - explorer.body.mount
        return explorer.budget.affords(DOUBT_WAIT_S, explorer.time_through(pose.position, places))

    def tick(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """Offer travel times to the own keyframes, and after a fruitless wait try the other doubtful
        point."""
        mission = self._team.config.mission
        # with several aerial robots the meeting place stays where the first one was released
        one = len(self._deployed) == 1
        if phase == Phase.EXPLORING and one and now_s - self._times_sent_s > mission.regroup_period_s:
            self._times_sent_s = now_s
            for peer in self._team.peers:
                if (
                    self._team.link.in_contact(peer.id, now_s)
                    and self._team.peer_phase(peer.id) == Phase.EXPLORING
                ):
                    self._team.link.post(self._times(pose), peer.id)
        if phase != Phase.WAITING or not self._acceptor.in_doubt:
            self._doubt_since_s = now_s
        elif self._doubt_since_s is not None and now_s - self._doubt_since_s > DOUBT_WAIT_S:
            self._acceptor.points.reverse()
            self._acceptor.epochs.reverse()
            self._doubt_since_s = now_s

    def _times(self, pose: Pose) -> Times:
        """Travel times to the newest keyframes, spaced, that this robot can reach over its global graph."""
        team = self._team
        positions = np.stack(team.keyframe_positions)
        chosen = thinned(positions, TIMES_SPACING_M)[:MAX_OFFERED]
        times = team.explorer.times_to(pose.position, positions[chosen] - team.explorer.body.mount)
        return Times(
            tuple(
                TravelTime(int(index), vector(positions[index]), float(time))
                for index, time in zip(chosen, times, strict=True)
                if np.isfinite(time) and time < 6000
            )
        )

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        return None
