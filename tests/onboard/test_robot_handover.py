"""One deployment from the carrier's side: the gate in every step, the bracket, and the way out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.core.base import BaseOdometry
from onboard.core.geometry import Pose
from onboard.localization.verdict import Reason
from onboard.mission import Phase
from onboard.robot.handover import GIVE_UP_S, LINGERS_S, LOST_S, SILENT_S, HandOver, Outcome, Stance, Standing
from onboard.robot.interface import BracketState
from onboard.robot.localised import Localised, Veto
from onboard.sharing.messages import Located, Release, Status, Target

ROBOT = 2
LOCKED = BracketState("LOCKED", 0.0, is_open=False)
OPEN = BracketState("RELEASED", 0.0, is_open=True)


class Link:
    """A link on which everything has arrived; `status` is what the aerial robot says of itself."""

    def __init__(self) -> None:
        self.sharing: list[tuple[Any, ...]] = []
        self.posted: list[Any] = []
        self.contact = True
        self.unsent = 0
        self.status: Status | None = Status(0.0, Phase.READY, (0.0, 0.0, 0.95), 1.0, None, 0.0, 0)

    def set_sharing(self, *arguments: Any) -> None:
        self.sharing.append(arguments)

    def in_contact(self, peer: int, now_s: float) -> bool:
        return self.contact

    def post(self, message: Any, to: int) -> None:
        assert to == ROBOT
        self.posted.append(message)

    def unshared(self, peer: int) -> int:
        return self.unsent

    def peer_status(self, peer: int) -> Status | None:
        return self.status


class Play:
    """A deployment with the readings of every step; change what is to be otherwise."""

    def __init__(self, localised: Localised | None = None) -> None:
        self.link = Link()
        self.events: list[tuple[str, dict[str, Any]]] = []
        self.localised = localised or Localised(required=False)
        team: Any = SimpleNamespace(
            link=self.link,
            log=lambda kind, **fields: self.events.append((kind, fields)),
            keyframe_positions=[],
            settings=SimpleNamespace(size_m=(0.93, 0.53, 0.8)),
            config=SimpleNamespace(
                deployment=SimpleNamespace(keyframes_sent=10), bracket=SimpleNamespace(height_m=0.15)
            ),
        )
        robot: Any = SimpleNamespace(id=ROBOT, name="aerial")
        outlook: Any = SimpleNamespace(targets=np.zeros((1, 3)))
        self.hand_over = HandOver(
            team, robot, outlook, np.zeros(3), 0.0, lambda now_s: self.localised.veto(ROBOT, now_s)
        )
        self.stance = Stance(0.0, Pose.identity(), 0.0, -5.0, LOCKED)
        self.now_s = 0.0
        self.released_s: float | None = None
        self.outcome = Outcome.UNDER_WAY

    def until(self, end_s: float) -> Outcome:
        """Steps of 0.1 s with fresh readings, until it is over or `end_s`."""
        while self.now_s < end_s - 1e-9 and self.outcome == Outcome.UNDER_WAY:
            self.now_s = round(self.now_s + 0.1, 3)
            if self.link.contact and self.link.status is not None:
                self.link.status = Status(self.now_s, *self._rest(self.link.status))
            bracket = self.stance.bracket
            if bracket is not None and bracket.heartbeat_s is not None:
                bracket = replace(bracket, heartbeat_s=self.now_s)
            now = replace(self.stance, now_s=self.now_s, odometry_s=self.now_s, bracket=bracket)
            self.outcome = self.hand_over.step(now)
            if self.hand_over.release is not None and self.released_s is None:
                self.released_s = self.now_s
        return self.outcome

    @staticmethod
    def _rest(status: Status) -> tuple[Any, ...]:
        return tuple(getattr(status, name) for name in status.__struct_fields__[1:])

    def says(self, phase: Phase, position: tuple[float, float, float]) -> None:
        self.link.status = Status(self.now_s, phase, position, 1.0, None, 0.0, 0)

    @property
    def abort(self) -> str:
        return next(str(fields["reason"]) for kind, fields in self.events if kind == "abort")


def asked(*codes: int, name: int | None = None) -> Localised:
    localised = Localised(required=True)
    localised.begin()
    for code in codes:
        localised.told(0.0, ROBOT, Located(localised.name if name is None else name, code))
    return localised


def test_the_bracket_may_open_as_soon_as_the_map_is_over_and_for_as_long_as_all_holds():
    play = Play()
    play.link.unsent = 3
    play.until(4.0)
    assert play.released_s is None
    play.link.unsent = 0
    play.until(5.0)
    assert play.released_s == pytest.approx(4.1)
    assert play.hand_over.release == ROBOT
    play.link.unsent = 1
    play.until(5.1)
    assert play.hand_over.release is None
    assert any(isinstance(message, Target) for message in play.link.posted)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"still_since_s": None}, "base is not still"),
        ({"still_since_s": 1e6}, "base is not still"),
        ({"pose": Pose.from_rpy(np.zeros(3), pitch_rad=0.1)}, "base is tilted"),
        ({"bracket": None}, "bracket"),
        ({"bracket": BracketState("LOCKED", None, is_open=False)}, "bracket is silent"),
        ({"bracket": BracketState("RELEASING", 0.0, is_open=False)}, "neither locked nor armed"),
    ],
)
def test_any_reading_that_forbids_it_keeps_it_shut_and_is_named_in_the_end(change, reason):
    play = Play()
    play.stance = replace(play.stance, **change)
    assert play.until(GIVE_UP_S - 1.0) == Outcome.UNDER_WAY
    assert play.until(GIVE_UP_S + 1.0) == Outcome.ABORTED
    assert play.released_s is None
    assert reason in play.abort


def test_a_robot_that_is_not_armed_or_not_heard_stays():
    play = Play()
    play.says(Phase.CARRIED, (0.0, 0.0, 0.95))
    play.until(GIVE_UP_S + 1.0)
    assert play.released_s is None
    assert "aerial robot is not ready" in play.abort
    silent = Play()
    silent.link.contact = False
    silent.until(GIVE_UP_S + 1.0)
    assert silent.released_s is None
    assert "no contact" in silent.abort


def test_a_bracket_at_fault_ends_it_at_once():
    play = Play()
    play.stance = replace(
        play.stance, bracket=BracketState("FAULT", 0.0, False, "jam: motor stalls at 12.0 A")
    )
    assert play.until(2.0) == Outcome.ABORTED
    assert play.now_s == pytest.approx(0.1)
    assert "jam" in play.abort


def opened() -> Play:
    play = Play()
    play.until(2.0)
    play.stance = replace(play.stance, bracket=OPEN)
    play.until(2.5)
    assert play.hand_over.opened_s == pytest.approx(2.1)
    assert play.hand_over.release is None
    return play


def test_nothing_is_said_to_the_robot_before_the_bracket_is_open_or_while_the_carrier_moves():
    play = Play()
    play.until(2.0)
    assert not any(isinstance(message, Release) for message in play.link.posted)
    play.stance = replace(play.stance, bracket=OPEN, still_since_s=None)
    play.until(4.0)
    assert not any(isinstance(message, Release) for message in play.link.posted)
    play.stance = replace(play.stance, still_since_s=0.0)
    play.until(7.05)
    assert 3 <= sum(isinstance(message, Release) for message in play.link.posted) <= 4


@pytest.mark.parametrize(
    ("phase", "position", "gone"),
    [
        (Phase.READY, (9.0, 0.0, 3.0), False),
        (Phase.TAKING_OFF, (0.0, 0.0, 1.9), False),
        (Phase.TAKING_OFF, (0.5, 0.0, 2.1), True),
        (Phase.EXPLORING, (2.0, 0.0, 1.0), False),
        (Phase.EXPLORING, (3.1, 0.0, 0.0), True),
    ],
)
def test_it_ends_when_the_robot_is_far_enough_away(phase, position, gone):
    play = opened()
    play.says(phase, position)
    assert (play.until(play.now_s + LINGERS_S + 5.0) == Outcome.DONE) is gone
    assert [kind for kind, _ in play.events].count("lingers") == (0 if gone else 1)


@pytest.mark.parametrize(("height_m", "gone"), [(1.2, False), (1.3, True)])
def test_who_flew_when_it_fell_silent_is_taken_for_gone_after_a_while(height_m, gone):
    play = opened()
    play.says(Phase.TAKING_OFF, (0.0, 0.0, height_m))
    play.link.contact = False
    assert play.until(play.now_s + SILENT_S - 0.5) == Outcome.UNDER_WAY
    assert (play.until(play.now_s + 1.5) == Outcome.DONE) is gone


def test_who_was_never_heard_in_the_air_is_given_up_much_later():
    play = opened()
    play.link.contact = False
    assert play.until(play.now_s + LOST_S - 1.0) == Outcome.UNDER_WAY
    assert play.until(play.now_s + 2.0) == Outcome.DONE


def test_a_robot_that_found_itself_is_released():
    play = Play(asked(Reason.ACCEPTED))
    play.until(3.0)
    assert play.released_s is not None


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason != Reason.ACCEPTED])
def test_a_refusal_ends_the_deployment_at_once_and_says_why(reason):
    play = Play(asked(reason))
    assert play.until(5.0) == Outcome.ABORTED
    assert play.released_s is None
    assert "cannot find itself" in play.abort


def test_without_any_word_the_carrier_waits_and_then_gives_up():
    play = Play(asked())
    assert play.until(GIVE_UP_S - 1.0) == Outcome.UNDER_WAY
    assert play.until(GIVE_UP_S + 5.0) == Outcome.ABORTED
    assert play.released_s is None
    assert "not found itself in the map yet" in play.abort


def test_where_poses_are_given_nothing_is_asked():
    assert Localised(required=False).veto(ROBOT, 0.1) is None


def test_word_of_another_deployment_or_robot_does_not_count():
    other = Play(asked(Reason.ACCEPTED, name=7))
    other.until(5.0)
    assert other.released_s is None
    localised = asked()
    localised.told(0.0, ROBOT + 1, Located(localised.name, Reason.ACCEPTED))
    assert localised.veto(ROBOT, 0.1) is not None
    localised = asked(Reason.ACCEPTED)
    assert localised.veto(ROBOT, 0.1) is None
    localised.begin()
    assert localised.veto(ROBOT, 0.1) == Veto(
        "the aerial robot has not found itself in the map yet", final=False
    )


def test_the_last_word_counts_and_unknown_codes_are_refusals():
    for codes, may in (
        ((Reason.ACCEPTED, Reason.AMBIGUOUS), False),
        ((Reason.AMBIGUOUS, 0), True),
        ((250,), False),
    ):
        play = Play(asked(*(Reason.ACCEPTED if code == 0 else code for code in codes)))
        play.until(3.0)
        assert (play.released_s is not None) is may


def sample(stamp_s: float, speed: float, turn: float = 0.0) -> BaseOdometry:
    twist = np.array([0.0, speed, 0.0]), np.array([0.0, 0.0, turn])
    return BaseOdometry(stamp_s, stamp_s, Pose.identity(), *twist, np.eye(6), np.eye(6))


def test_standing_is_felt_through_noise_and_ended_by_motion():
    standing, rng = Standing(), np.random.default_rng(3)
    standing.sensed(None)
    assert standing.since_s is None
    for step in range(60):
        standing.sensed(sample(0.1 * step, 0.03 * rng.normal(), 0.03 * rng.normal()))
    assert standing.since_s is not None
    assert standing.since_s < 2.0
    standing.sensed(sample(6.0, 0.4))
    assert standing.since_s is None
    before = standing.odometry_s
    standing.sensed(sample(6.0, 0.0))
    assert standing.odometry_s == before
