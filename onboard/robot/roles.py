"""What a robot does for the team besides exploring. A role answers questions of the core and handles
messages."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from onboard.core.config import Config, RobotSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.bracket import bracket_of, carried_pose
from onboard.mission import ABOARD, AT_REGROUP, FLYING, Facts, Phase, phase_of
from onboard.planning.explorer import Explorer
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.relocation import Moved
from onboard.planning.worth import PeerGoal
from onboard.robot.bidding import Bidding
from onboard.robot.interface import FlightOrders, Inputs, Log, Profile
from onboard.robot.map_frame import Given, MapFrame
from onboard.robot.sensing import Sensing
from onboard.safety_facts import BaseFacts
from onboard.sharing import LinkCore
from onboard.sharing.messages import Message, Status, Vector

PEER_MARGIN_M = 0.3
KEEP_CLEAR_M = 0.4


class Team:
    """What the roles share: configuration, planner, link and bookkeeping of one robot."""

    def __init__(
        self,
        config: Config,
        name: str,
        explorer: Explorer,
        sensing: Sensing,
        link: LinkCore,
        log: Log,
        profile: Profile,
    ) -> None:
        self.config = config
        self.settings = config.robot(name)
        self.explorer = explorer
        self.sensing = sensing
        self.link = link
        self.log = log
        self.profile = profile
        self.peers = [robot for robot in config.robots if robot.name != name]
        self.keyframe_positions: list[FloatArray] = []
        """LiDAR positions (3,) of the own keyframes by sequence."""
        self.keyframe_bytes = 0
        self.bidding = Bidding(self.settings, link)
        self.frame: MapFrame = Given()
        """What the poses mean that localisation tells."""
        self._trail: list[FloatArray] = []

    @property
    def peer_ids(self) -> list[int]:
        return [peer.id for peer in self.peers]

    def remaining(self, now_s: float) -> float:
        """Seconds until the mission ends."""
        return self.config.mission.duration_s - now_s

    def peer_phase(self, peer: int) -> Phase | None:
        """Phase in the newest beacon of a peer."""
        status = self.link.peer_status(peer)
        return phase_of(status.phase) if status is not None else None

    def peers_arrived(self, now_s: float) -> bool:
        """Whether all peers are in contact and say that they are at the regrouping point."""
        return all(self.link.in_contact(p, now_s) and self.peer_phase(p) in AT_REGROUP for p in self.peer_ids)

    def all_shared(self) -> bool:
        """Whether all peers that have left their carrier have acknowledged all keyframes."""
        return all(self.link.unshared(peer) == 0 or self.peer_phase(peer) in ABOARD for peer in self.peer_ids)

    def all_received(self) -> bool:
        """Whether every keyframe that the peers say they made has arrived here."""
        for peer in self.peer_ids:
            status = self.link.peer_status(peer)
            if status is None or self.link.store.next_sequence(peer) < status.keyframes:
                return False
            if any((peer, sequence) not in self.link.store for sequence in range(status.keyframes)):
                return False
        return True

    def remember_trail(self, places: list[FloatArray]) -> None:
        """Peers' keyframe positions (3,) are ways that an aerial robot can take too: join them to its
        global graph."""
        self._trail += places
        graph = self.explorer.graph
        if self.settings.kind != "aerial" or graph is None or len(self._trail) < 2:
            return
        graph.add_chain(np.stack(self._trail), self.explorer.passable)
        self._trail = self._trail[-1:]

    def exploring_peers(self) -> list[int]:
        """Peers that explore by themselves, whether in contact or not."""
        return [peer for peer in self.peer_ids if self.peer_phase(peer) not in {None, *ABOARD}]

    def peer_goals(self, now_s: float) -> list[PeerGoal]:
        """Places that peers are heading for and, in teams of more than two, have won in the auction.

        Between two robots the goals are enough: what is claimed beyond them only keeps the other one away.
        """
        claimed = self.bidding.taken(now_s) if len(self.exploring_peers()) > 1 else []
        statuses = [self.link.peer_status(peer) for peer in self.peer_ids]
        return [
            PeerGoal(np.array(status.goal_m), max(0.0, now_s - status.stamp_s))
            for status in statuses
            if status is not None and status.goal_m is not None
        ] + [PeerGoal(place) for place in claimed]

    def others(self, now_s: float) -> list[tuple[FloatArray, float]]:
        """Body centres (3,) of peers in contact that walk or fly, and the distance to keep, in metres."""
        found = []
        for peer in self.peers:
            status = self.link.peer_status(peer.id)
            if status is None or not self.link.in_contact(peer.id, now_s):
                continue
            if peer.kind == "aerial" and status.phase not in FLYING:
                continue
            lift = peer.size_m[2] / 2 if peer.kind == "ground" else 0.0
            centre = np.array(status.position_m) + np.array([0.0, 0.0, lift])
            reach = (np.hypot(*peer.size_m[:2]) + max(self.settings.size_m)) / 2 + KEEP_CLEAR_M
            found.append((centre, float(reach + (now_s - status.stamp_s) * peer.speed_m_s)))
        return found

    def without_peers(self, scan: Scan, pose: Pose, now_s: float) -> Scan:
        """The scan without the pixels that show a peer's body, whose place its beacon tells."""
        sensor = self.sensing.sensor_pose(pose)
        ranges = scan.ranges
        for peer in self.peers:
            status = self.link.peer_status(peer.id)
            if status is None or now_s - status.stamp_s > self.config.mission.contact_timeout_s:
                continue
            centre = self._centre(peer, status, pose)
            radius = max(peer.size_m) / 2 + PEER_MARGIN_M + (now_s - status.stamp_s) * peer.speed_m_s
            near = sensor.rotation.T @ (centre - sensor.position)
            ranges = np.where(inside_sphere(scan, near, radius), np.float32(0.0), ranges)
        return Scan(scan.stamp_s, ranges, scan.model)

    def _centre(self, peer: RobotSettings, status: Status, pose: Pose) -> FloatArray:
        """Centre (3,) of a peer's body; one aboard may not know, its carrier at `pose` does."""
        config = self.config
        aboard = self.settings.kind == "ground" and status.phase in ABOARD
        if aboard and config.deployment.colocalise:
            place = bracket_of(peer.id, config.robots)
            centre = carried_pose(pose, self.settings.size_m[2], config.bracket, place)
            return centre.position
        lift_m = peer.size_m[2] / 2 if peer.kind == "ground" else 0.0
        return np.asarray(np.array(status.position_m) + np.array([0.0, 0.0, lift_m]))


class Role(Protocol):
    """The part of a mission that differs between robots."""

    first_phase: Phase

    @property
    def release(self) -> int | None:
        """The robot whose bracket may open in this step."""
        ...

    @property
    def located(self) -> bool:
        """Whether the robot's pose in the map can be trusted."""
        ...

    @property
    def searching(self) -> bool:
        """Whether the role wants scans although the robot is not located."""
        ...

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Sensor readings have come, the body being at `pose` in the map, if that is known; called once a
        step, before everything else."""
        ...

    def redrawn(self, moved: Moved) -> None:
        """The map has been drawn anew: `moved` tells where places of the old one are."""
        ...

    def flight(self) -> FlightOrders:
        """What the autopilot shall do, after `tick`."""
        ...

    def walk(self, now_s: float, phase: Phase) -> BaseFacts | None:
        """What the gate of the base has to know; None for a robot that does not walk."""
        ...

    def regroup_point(self) -> FloatArray | None:
        """LiDAR position (3,) of the agreed regrouping point, None where there is none yet."""
        ...

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        """What the role knows for the state machine."""
        ...

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """The robot has just changed to this phase."""
        ...

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        """A small message of a peer."""
        ...

    def tick(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """Once a step, after everything else: orders to the autopilot, talk with the team."""
        ...

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        """A plan that the role insists on in this phase, None to let the robot explore or return."""
        ...

    def planned(self, now_s: float, phase: Phase, pose: Pose, plan: Plan) -> None:
        """A planning cycle of exploration has ended with this plan."""
        ...


def inside_sphere(
    scan: Scan, centre: FloatArray, radius_m: float
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Pixels (H, W) whose return lies within `radius_m` of a point (3,) of the sensor frame."""
    along = scan.model.directions @ centre.astype(np.float32)
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, np.float32(0.0))
    squared = ranges * (ranges - 2 * along) + np.float32(centre @ centre)
    return (ranges > 0) & (squared < radius_m**2)


def vector(point: FloatArray) -> Vector:
    """A point (3,) as plain numbers."""
    x, y, z = (float(c) for c in np.asarray(point))
    return (x, y, z)
