"""The bracket stays shut while the robot in it has not found itself in the carrier's map."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.core.geometry import Pose
from onboard.localization.verdict import Reason
from onboard.robot.handover import NO_CONTACT_S, HandOver, Outcome
from onboard.robot.localised import Localised, Veto
from onboard.sharing.messages import Located

ROBOT = 2
POSE = Pose.identity()


class Link:
    """A link on which everything has arrived."""

    def __init__(self) -> None:
        self.sharing: list[tuple[Any, ...]] = []

    def set_sharing(self, *arguments: Any) -> None:
        self.sharing.append(arguments)

    def in_contact(self, peer: int, now_s: float) -> bool:
        return True

    def post(self, message: Any, to: int) -> None:
        assert to == ROBOT

    def unshared(self, peer: int) -> int:
        return 0

    def peer_status(self, peer: int) -> None:
        return None


def hand_over(localised: Localised) -> tuple[HandOver, list[tuple[str, dict[str, Any]]]]:
    events: list[tuple[str, dict[str, Any]]] = []
    team: Any = SimpleNamespace(
        link=Link(),
        log=lambda kind, **fields: events.append((kind, fields)),
        keyframe_positions=[],
        config=SimpleNamespace(deployment=SimpleNamespace(keyframes_sent=10)),
    )
    robot: Any = SimpleNamespace(id=ROBOT, name="aerial")
    outlook: Any = SimpleNamespace(targets=np.zeros((1, 3)))
    return HandOver(
        team, robot, outlook, np.zeros(3), 0.0, lambda now_s: localised.veto(ROBOT, now_s)
    ), events


def played(localised: Localised, until_s: float, start_s: float = 0.0) -> tuple[bool, Outcome, str]:
    """Whether it released, how it ended and what it said."""
    process, events = hand_over(localised)
    outcome, released = Outcome.UNDER_WAY, False
    for now_s in np.arange(start_s, until_s, 0.1):
        outcome = process.step(float(now_s), POSE)
        released |= process.release
        if outcome == Outcome.ABORTED:
            break
    said = [str(fields["reason"]) for kind, fields in events if kind == "abort"]
    return released, outcome, said[0] if said else ""


def asked(*codes: int, name: int | None = None) -> Localised:
    localised = Localised(required=True)
    localised.begin()
    for code in codes:
        localised.told(0.0, ROBOT, Located(localised.name if name is None else name, code))
    return localised


def test_a_robot_that_found_itself_is_released():
    released, outcome, _ = played(asked(Reason.ACCEPTED), 5.0)
    assert released
    assert outcome == Outcome.UNDER_WAY


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason != Reason.ACCEPTED])
def test_a_refusal_ends_the_deployment_at_once_and_says_why(reason):
    released, outcome, said = played(asked(reason), 5.0)
    assert not released
    assert outcome == Outcome.ABORTED
    assert "cannot find itself" in said


def test_without_any_word_the_carrier_waits_and_then_gives_up():
    assert played(asked(), NO_CONTACT_S - 1.0)[:2] == (False, Outcome.UNDER_WAY)
    released, outcome, said = played(asked(), NO_CONTACT_S + 5.0)
    assert not released
    assert outcome == Outcome.ABORTED
    assert "not found itself in the map yet" in said


def test_where_poses_are_given_nothing_is_asked():
    assert Localised(required=False).veto(ROBOT, 0.1) is None
    assert played(Localised(required=False), 5.0)[0]


def test_word_of_another_deployment_or_robot_does_not_count():
    assert played(asked(Reason.ACCEPTED, name=7), 5.0)[0] is False
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
    assert not played(asked(Reason.ACCEPTED, Reason.AMBIGUOUS), 5.0)[0]
    assert played(asked(Reason.AMBIGUOUS, Reason.ACCEPTED), 5.0)[0]
    assert not played(asked(250), 5.0)[0]
