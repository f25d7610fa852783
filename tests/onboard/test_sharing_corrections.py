"""When corrections are told, repeated and acknowledged."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from onboard.localization.corrections import CorrectionBook
from onboard.robot.corrections import from_message
from onboard.sharing.correction_talk import REPEAT_S, CorrectionTalk
from onboard.sharing.frames import pack, unpack
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


@given(st.data())
def test_whatever_is_lost_repeated_or_overtaken_the_newest_correction_arrives(data: st.DataObject) -> None:
    talks, book = {1: CorrectionTalk(1), 2: CorrectionTalk(2)}, CorrectionBook()
    air: list[tuple[int, bytes]] = []
    last = data.draw(st.integers(1, 4))
    for round_number in range(40):
        bad = round_number < 20
        if round_number < last:
            talks[1].tell(revision(round_number + 1))
        due = talks[1].due(REPEAT_S * round_number, 2)
        if due is not None:
            air.append((2, pack(due, 1, 2)))
        for _ in range(data.draw(st.integers(0, 3)) if bad else len(air)):
            if not air:
                break
            place = data.draw(st.integers(0, len(air) - 1)) if bad else 0
            fate = data.draw(st.sampled_from(["lost", "heard", "heard twice"])) if bad else "heard"
            target, frame = air[place]
            if fate != "heard twice":
                air.pop(place)
            if fate != "lost":
                message = unpack(frame).message
                assert isinstance(message, Corrections)
                if message.knots:
                    book.take(from_message(message))
                answer = talks[target].came(3 - target, message)
                if answer is not None:
                    air.append((3 - target, pack(answer, target, 3 - target)))
    assert book.revision(1) == last
    assert talks[1].due(1e6, 2) is None  # and the sender knows
