"""The phases of a mission as a pure state machine: what each robot is doing, and what makes it do the next
thing.

    ground  CARRYING <-> DEPLOYING -> EXPLORING -> RETURNING -> WAITING -> DONE
            (back to CARRYING while there is a further robot aboard)
    aerial  CARRIED <-> READY -> TAKING_OFF -> EXPLORING -> RETURNING -> WAITING -> LANDING -> DONE

A ground robot without an aerial one begins in EXPLORING and is DONE when it is back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum


class Phase(IntEnum):
    """What a robot is doing; the number is its code on the air."""

    CARRIED = 0
    CARRYING = 1
    DEPLOYING = 2
    TAKING_OFF = 3
    EXPLORING = 4
    RETURNING = 5
    WAITING = 6
    DONE = 7
    READY = 8
    LANDING = 9


def phase_of(code: int) -> Phase | None:
    """The phase with this code on the air; None for one that a newer robot may have."""
    return Phase(code) if code in _CODES else None


_CODES = frozenset(int(phase) for phase in Phase)
ABOARD = frozenset({Phase.CARRIED, Phase.READY})
"""In the carrier's bracket: with its rotors at rest, or armed and waiting for the bracket to open."""
AT_REGROUP = ABOARD | {Phase.WAITING, Phase.LANDING, Phase.DONE}
"""A robot that is still aboard is wherever its carrier is."""
FLYING = frozenset(
    {Phase.TAKING_OFF, Phase.EXPLORING, Phase.RETURNING, Phase.WAITING, Phase.LANDING, Phase.DONE}
)
"""Phases of an aerial robot that has left its carrier; it stands on the ground at the end of the last two."""


@dataclass(frozen=True)
class Facts:
    """What a robot knows at one step; the defaults are those of a robot for which the fact does not arise."""

    fire: bool = False
    """The deployment trigger fired (carrier)."""
    shared: bool = False
    """Everything that must reach the peers has been acknowledged by them."""
    ready: bool = False
    """Armed and self-tested for a carrier that is about to release (aerial)."""
    released: bool = False
    """The carrier released this robot (aerial)."""
    airborne: bool = False
    """The robot is in the air (aerial)."""
    aborted: bool = False
    """The deployment cannot go on (carrier)."""
    peer_clear: bool = False
    """The deployed robot is far enough from its carrier (carrier), or the climb is done (aerial)."""
    nothing_left: bool = False
    """No path is worth its time or fits the budget."""
    more: bool = False
    """There is something to explore again, such as what a peer's keyframes opened up."""
    must_return: bool = False
    """The way back needs all the time that is left."""
    arrived: bool = False
    """The robot is at the regrouping point."""
    peers_arrived: bool = False
    """Every peer says that it is at the regrouping point too, and is in contact."""
    aboard: bool = False
    """There is a further robot to release (carrier)."""
    complete: bool = False
    """Every keyframe of every peer has been received."""


def next_phase(phase: Phase, facts: Facts) -> Phase:
    """The phase that follows, which is `phase` itself while nothing calls for a change."""
    rule = _RULES.get(phase)
    return phase if rule is None else rule(facts)


def _carrying(facts: Facts) -> Phase:
    if facts.fire:
        return Phase.DEPLOYING
    return Phase.RETURNING if facts.nothing_left or facts.must_return else Phase.CARRYING


def _deploying(facts: Facts) -> Phase:
    if facts.aborted:
        return Phase.CARRYING
    if not facts.peer_clear:
        return Phase.DEPLOYING
    return _resumed(facts)


def _exploring(facts: Facts) -> Phase:
    return Phase.RETURNING if facts.nothing_left or facts.must_return else Phase.EXPLORING


def _returning(facts: Facts) -> Phase:
    if facts.more:
        return _resumed(facts)
    return Phase.WAITING if facts.arrived else Phase.RETURNING


def _waiting(facts: Facts) -> Phase:
    if facts.peers_arrived and facts.shared and facts.complete and facts.arrived:
        return Phase.LANDING if facts.airborne else Phase.DONE
    if facts.more:
        return _resumed(facts)
    return Phase.WAITING if facts.arrived else Phase.RETURNING


def _ready(facts: Facts) -> Phase:
    if facts.released:
        return Phase.TAKING_OFF
    return Phase.READY if facts.ready else Phase.CARRIED


def _resumed(facts: Facts) -> Phase:
    return Phase.CARRYING if facts.aboard else Phase.EXPLORING


_RULES: dict[Phase, Callable[[Facts], Phase]] = {
    Phase.CARRIED: lambda facts: Phase.READY if facts.ready else Phase.CARRIED,
    Phase.READY: _ready,
    Phase.CARRYING: _carrying,
    Phase.DEPLOYING: _deploying,
    Phase.TAKING_OFF: lambda facts: Phase.EXPLORING if facts.peer_clear else Phase.TAKING_OFF,
    Phase.EXPLORING: _exploring,
    Phase.RETURNING: _returning,
    Phase.WAITING: _waiting,
    Phase.LANDING: lambda facts: Phase.LANDING if facts.airborne else Phase.DONE,
}
