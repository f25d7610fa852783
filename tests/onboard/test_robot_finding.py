"""A carrier offers its cloud over a bad link, the robot aboard finds itself in it and says so."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.core.crc import crc32c
from onboard.core.geometry import Pose, rotation_angle
from onboard.localization.verdict import Reason
from onboard.mission import Phase
from onboard.robot.cloud_offer import RATE_SHARE, CloudOffer
from onboard.robot.finding import Finding, Standstill
from onboard.robot.interface import Inputs, Profile
from onboard.robot.localised import FRESH_S, Localised
from onboard.robot.map_frame import Estimated, Told
from onboard.sharing import LinkCore
from onboard.sharing.frames import kind_name, unpack
from onboard.sharing.messages import Chunk, Located, Missing, Offer, Status
from tests.onboard.colocalisation_scenes import Place, corridor, furnished

CARRIER, FLYER = 1, 2
TICK_S = 0.1
RATE_BYTES_S = 60_000.0
START = Pose.from_rpy(np.array([20.0, -7.0, 3.0]), yaw_rad=2.0)
"""Where the map's origin lies in the frame of the flyer's odometry."""
places = {"furnished": cache(furnished), "corridor": cache(corridor)}


def status(phase: Phase, now_s: float) -> Status:
    return Status(now_s, int(phase), (0.0, 0.0, 0.0), 1.0, None, 100.0, 0)


class Couple:
    """A carrier that stands and a robot in its bracket, in lock step, with frames lost at random."""

    def __init__(self, place: Place, loss: float = 0.0, shift: tuple[float, float, float] = (0.8, -0.5, 0.1)):
        self.now_s = 0.0
        self.phase = Phase.DEPLOYING
        self.events: list[dict[str, Any]] = []
        self.sent: list[tuple[float, str, int]] = []
        self.localised = Localised(required=True)
        self._place = place
        self.loss = loss
        self._rng = np.random.default_rng(3)
        self._scan: Any = SimpleNamespace(points=lambda: place.scan(place.truth))
        self._carrier_link = LinkCore(CARRIER, [FLYER])
        self.offer = CloudOffer(self._carrier_link, RATE_BYTES_S)
        self.offer.saw(SimpleNamespace(points=lambda: place.cloud), Pose.identity())  # type: ignore[arg-type]
        self._guess = Pose(place.truth.position + np.array(shift), place.truth.quaternion)
        self._air: list[tuple[int, bytes]] = []
        self.restart()

    def restart(self) -> None:
        """The flyer's computer begins anew."""
        self._link = LinkCore(FLYER, [CARRIER])
        self.frame = Estimated(FLYER, Pose.identity(), None)
        team: Any = SimpleNamespace(
            config=SimpleNamespace(deployment=SimpleNamespace(colocalise=True)),
            link=self._link,
            log=lambda kind, **fields: self.events.append(fields),
            profile=Profile(lambda: 0.0),
            sensing=SimpleNamespace(sensor_pose=lambda body: body),
            peer_phase=self._phase_of,
            frame=self.frame,
        )
        self.finding = Finding(team)

    def _phase_of(self, peer: int) -> Phase | None:
        told = self._link.peer_status(peer)
        return None if told is None else Phase(told.phase)

    def begin(self) -> None:
        self.localised.begin()
        self.offer.begin(self.now_s, self.localised.name, FLYER, self._guess)

    def tick(self) -> None:
        self.now_s += TICK_S
        here = [[f for to, f in self._air if to == robot] for robot in (CARRIER, FLYER)]
        self._air = []
        self._step_carrier(here[0])
        self._step_flyer(here[1])

    def _step_carrier(self, frames: list[bytes]) -> None:
        self._carrier_link.set_status(status(self.phase, self.now_s))
        self._transmit(self._carrier_link.step(self.now_s, frames))
        for source, message in self._carrier_link.take_messages():
            if isinstance(message, Located):
                self.localised.told(self.now_s, source, message)
                self.offer.told(self.now_s, source)
            elif isinstance(message, Missing):
                self.offer.handle(self.now_s, source, message)
        self.offer.step(self.now_s)

    def _step_flyer(self, frames: list[bytes]) -> None:
        odometry = START.compose(self._place.truth)
        scan = self._scan if self.finding.searching and round(self.now_s * 10) % 5 == 0 else None
        self.finding.sensed(Inputs(self.now_s, Told(odometry), 1.0, scan))
        self._link.set_status(status(Phase.CARRIED, self.now_s))
        self._transmit(self._link.step(self.now_s, frames))
        for source, message in self._link.take_messages():
            if isinstance(message, Offer | Chunk):
                self.finding.handle(self.now_s, source, message)

    def _transmit(self, frames: list[tuple[int, bytes]]) -> None:
        for to, frame in frames:
            self.sent.append((self.now_s, kind_name(unpack(frame).message), len(frame)))
            if self._rng.random() >= self.loss:
                self._air.append((to, frame))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def run_until_told(self, limit_s: float = 40.0) -> None:
        """Until the carrier has heard what came of it."""
        end_s = self.now_s + limit_s
        while self.unheard() and self.now_s < end_s:
            self.tick()

    def unheard(self) -> bool:
        veto = self.localised.veto(FLYER, self.now_s)
        return veto is not None and not veto.final

    def free(self) -> bool:
        return self.localised.veto(FLYER, self.now_s) is None

    def count(self, kind: str) -> int:
        return sum(sent == kind for _, sent, _ in self.sent)

    def pose(self) -> Pose:
        return self.frame.pose(Told(START.compose(self._place.truth)))


def couple(name: str = "furnished", loss: float = 0.0) -> Couple:
    made = Couple(places[name](), loss)
    made.run(2.0)
    made.begin()
    return made


def test_it_finds_itself_and_takes_its_poses_from_its_odometry_from_then_on():
    both = couple()
    assert both.finding.map_from_odometry is None
    assert not both.finding.located
    both.run_until_told()
    assert both.free()
    truth = furnished().truth
    assert np.linalg.norm(both.pose().position - truth.position) < 0.03
    assert rotation_angle(both.pose().quaternion, truth.quaternion) < np.deg2rad(0.3)
    (event,) = both.events
    assert event["accepted"]
    assert 0 < event["transfer_s"] < event["took_s"] < 15.0


def test_lost_chunks_are_repeated():
    clean, lossy = couple(), couple(loss=0.3)
    clean.run_until_told()
    lossy.run_until_told()
    assert lossy.free()
    assert lossy.events[0]["bytes"] == clean.events[0]["bytes"]
    assert lossy.count("chunk") > 1.2 * clean.count("chunk")


def test_chunks_leave_half_of_the_radio_to_keyframes():
    both = couple()
    both.run_until_told()
    for start_s in np.arange(2.0, both.now_s, 1.0):
        sent = sum(n for t, kind, n in both.sent if kind == "chunk" and start_s <= t < start_s + 1.0)
        assert sent < RATE_SHARE * RATE_BYTES_S * 1.35  # what was saved up for 0.25 s, and frames' heads


def test_nothing_is_sent_without_contact_and_all_goes_on_with_it():
    both = couple()
    both.run(1.0)
    both.loss = 1.0
    both.run(5.0)
    before = both.count("chunk")
    both.run(20.0)
    assert both.count("chunk") == before > 0
    both.loss = 0.0
    both.run_until_told()
    assert both.free()


def test_a_robot_restarted_in_the_middle_begins_anew():
    both = couple()
    both.run(1.0)
    assert both.count("chunk") > 0
    both.restart()
    both.run_until_told()
    assert both.free()
    assert both.finding.located


def test_a_robot_restarted_after_its_word_is_not_released_before_it_has_found_itself_again():
    both = couple()
    both.run_until_told()
    both.restart()
    both.run(FRESH_S + 1.0)
    assert not both.free()
    both.run_until_told()
    assert both.free()
    assert both.finding.located
    assert len(both.events) == 2


def test_the_word_is_repeated_until_the_deployment_ends():
    both = couple()
    both.run_until_told()
    both.run(20.0)
    assert both.free()
    assert both.count("located") > 15
    both.phase = Phase.CARRYING
    both.offer.end()
    both.run(2.0)
    told = both.count("located")
    both.run(5.0)
    assert both.count("located") == told
    assert not both.finding.located


def test_in_a_corridor_that_looks_the_same_everywhere_it_refuses():
    both = couple("corridor")
    both.run_until_told()
    veto = both.localised.veto(FLYER, both.now_s)
    assert veto is not None
    assert veto.final
    assert "too few directions" in veto.words
    assert not both.finding.located


def test_data_that_is_no_cloud_is_a_refusal():
    both = couple()
    both.offer.end()
    data = b"nonsense" * 100
    both.finding.handle(both.now_s, CARRIER, Offer(1, len(data), crc32c(data)))
    both.finding.handle(both.now_s, CARRIER, Chunk(1, crc32c(data), 0, data))
    both.run(3.0)
    assert both.events[0]["accepted"] is False
    veto = both.localised.veto(FLYER, both.now_s)
    assert veto is not None
    assert veto.final


def test_it_does_not_look_while_the_carrier_moves():
    still = Standstill()
    walked = [still.now(0.1 * k, np.array([0.05 * k, 0.0, 0.0])) for k in range(30)]
    assert not any(walked)
    stood = [still.now(3.0 + 0.1 * k, np.array([1.5 + 0.01 * (k % 2), 0.0, 0.0])) for k in range(30)]
    assert not stood[5]
    assert stood[-1]


@pytest.mark.parametrize("reason", [Reason.AMBIGUOUS, Reason.LATE])
def test_a_refusal_needs_no_repetition(reason):
    localised = Localised(required=True)
    localised.begin()
    localised.told(0.0, FLYER, Located(localised.name, reason))
    veto = localised.veto(FLYER, 100.0)
    assert veto is not None
    assert veto.final
