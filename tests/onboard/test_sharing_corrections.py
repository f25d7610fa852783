"""When corrections are told, repeated and acknowledged."""

from __future__ import annotations

from onboard.sharing.correction_talk import REPEAT_S, CorrectionTalk
from onboard.sharing.messages import CorrectionKnot, Corrections

KNOT = CorrectionKnot(4, (0.1, 0.0, 0.0), (0.0, 0.0, 0.01))


def revision(number: int) -> Corrections:
    return Corrections(1, number, (KNOT,))


def test_a_correction_is_repeated_until_its_revision_is_acknowledged() -> None:
    talk = CorrectionTalk(1)
    assert talk.due(0.0, 2) is None
    talk.tell(revision(3))
    assert talk.due(0.0, 2) == revision(3)
    assert talk.due(REPEAT_S - 0.1, 2) is None
    assert talk.due(REPEAT_S, 2) == revision(3)
    assert talk.came(2, Corrections(1, 2, ())) is None  # an older one does not count
    assert talk.due(2 * REPEAT_S, 2) == revision(3)
    talk.came(2, Corrections(1, 3, ()))
    talk.came(2, Corrections(1, 2, ()))  # came late
    assert talk.due(3 * REPEAT_S, 2) is None
    assert talk.due(3 * REPEAT_S, 3) == revision(3)


def test_a_newer_correction_is_told_at_once() -> None:
    talk = CorrectionTalk(1)
    talk.tell(revision(1))
    talk.due(0.0, 2)
    talk.came(2, Corrections(1, 1, ()))
    talk.tell(revision(2))
    assert talk.due(0.5, 2) == revision(2)


def test_corrections_of_a_peer_are_answered_and_those_of_others_acknowledge_nothing() -> None:
    talk = CorrectionTalk(1)
    talk.tell(revision(1))
    assert talk.came(2, Corrections(2, 5, (KNOT,))) == Corrections(2, 5, ())
    talk.came(2, Corrections(2, 5, ()))
    assert talk.due(0.0, 2) == revision(1)
