"""The carried robot's side of a co-localisation: receive the carrier's cloud, find itself in it, say so."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onboard.core.errors import WireError
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.colocalise import Colocalisation
from onboard.localization.surroundings import surroundings_from_bytes
from onboard.localization.verdict import Reason, words_of
from onboard.mission import Phase
from onboard.planning.local_graph import FloatArray
from onboard.robot.interface import Inputs
from onboard.robot.roles import Team
from onboard.sharing.messages import Chunk, Located, Offer
from onboard.sharing.transfer import DataReceiver

REPEAT_S = 1.0
STILL_M, STILL_S = 0.05, 1.0
"""Who has kept within this distance for this time stands."""


@dataclass
class _Try:
    """What is forgotten when all begins anew."""

    receiver: DataReceiver = field(default_factory=DataReceiver)
    carrier: int | None = None
    process: Colocalisation | None = None
    code: Reason | None = None
    was_deploying: bool = False
    offered_s: float = 0.0
    received_s: float = 0.0
    told_s: float = -np.inf


class Finding:
    """Where a carried robot's odometry lies in the map. Call `sensed` in every step while it is carried.

    A new offer, or the end of the carrier's deployment without release, makes it begin anew.
    """

    def __init__(self, team: Team) -> None:
        self.map_from_odometry: Pose | None = None
        """Leads from the frame of the own odometry to the map, None until two scans have agreed on it."""
        self._team = team
        self._required = team.config.deployment.colocalise
        self._still = Standstill()
        self._try = _Try()

    @property
    def located(self) -> bool:
        """Whether the robot's pose in the map can be trusted."""
        return not self._required or self.map_from_odometry is not None

    @property
    def searching(self) -> bool:
        """Whether scans are wanted."""
        return self._try.receiver.data is not None and self._try.code is None

    def handle(self, now_s: float, source: int, message: Offer | Chunk) -> None:
        """A part of the carrier's cloud."""
        if not self._required:
            return
        if isinstance(message, Offer) and message != self._try.receiver.offer:
            self._forget()
            self._try.offered_s, self._try.carrier = now_s, source
        if source == self._try.carrier:
            self._try.receiver.handle(message)

    def sensed(self, inputs: Inputs) -> None:
        """Look for itself where the cloud is there and the carrier stands, and tell what has come of it."""
        if self._try.carrier is None:
            return
        odometry = inputs.told.pose
        still = self._still.now(inputs.now_s, odometry.position)
        if self._given_up():
            self._forget()
            return
        if self.searching and still:
            self._search(inputs.now_s, inputs.scan, self._team.sensing.sensor_pose(odometry))
        self._tell(inputs.now_s)

    def _search(self, now_s: float, scan: Scan | None, sensor: Pose) -> None:
        """Either prepare the cloud or take a scan: each is heavy enough for one step."""
        timed = self._team.profile.timed
        if self._try.process is None:
            timed("cloud", self._prepare, now_s, sensor)
            return
        points = None if scan is None else scan.points()
        verdict = timed("colocalise", self._try.process.step, now_s, points, sensor)
        if verdict is not None:
            self._found(verdict.map_from_odometry)
            self._end(now_s, verdict.reason, verdict.words)

    def _prepare(self, now_s: float, sensor: Pose) -> None:
        assert self._try.receiver.data is not None
        try:
            offered = surroundings_from_bytes(self._try.receiver.data)
        except WireError as error:
            self._end(now_s, Reason.NO_CLOUD, f"{words_of(Reason.NO_CLOUD)}: {error}")
            return
        self._try.received_s = now_s
        self._try.process = Colocalisation(offered.cloud, offered.sensor.compose(sensor.inverse()))

    def _end(self, now_s: float, reason: Reason, words: str) -> None:
        assert self._try.receiver.data is not None
        self._try.code = reason
        self._team.log(
            "located",
            accepted=reason == Reason.ACCEPTED,
            reason=words,
            bytes=len(self._try.receiver.data),
            transfer_s=round(self._try.received_s - self._try.offered_s, 2),
            took_s=round(now_s - self._try.offered_s, 2),
        )

    def _tell(self, now_s: float) -> None:
        """The answers are repeated until the carrier has released or given up: any may be lost."""
        assert self._try.carrier is not None
        answer, offer = self._try.receiver.answer(), self._try.receiver.offer
        if answer is not None:
            self._team.link.post(answer, self._try.carrier)
        if self._try.code is not None and offer is not None and now_s - self._try.told_s >= REPEAT_S:
            self._try.told_s = now_s
            self._team.link.post(Located(offer.name, self._try.code), self._try.carrier)

    def _given_up(self) -> bool:
        """Whether the carrier was about to release and is not any longer."""
        assert self._try.carrier is not None
        deploying = self._team.peer_phase(self._try.carrier) == Phase.DEPLOYING
        self._try.was_deploying |= deploying
        return self._try.was_deploying and not deploying

    def _found(self, map_from_odometry: Pose | None) -> None:
        self.map_from_odometry = map_from_odometry
        self._team.frame.locate(map_from_odometry)

    def _forget(self) -> None:
        self._found(None)
        self._try = _Try()


class Standstill:
    """Tells from positions whether their robot stands."""

    def __init__(self) -> None:
        self._near: FloatArray | None = None
        self._since_s = 0.0

    def now(self, now_s: float, position: FloatArray) -> bool:
        """Whether the robot has stood for a while, with its newest `position` (3,) taken in."""
        if self._near is None or float(np.linalg.norm(position - self._near)) > STILL_M:
            self._near, self._since_s = position, now_s
        return now_s - self._since_s >= STILL_S
