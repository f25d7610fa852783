"""The mission's state machine over every phase and every combination of facts."""

from __future__ import annotations

from dataclasses import fields
from itertools import product

import pytest

from onboard.mission import ABOARD, AT_REGROUP, FLYING, Facts, Phase, next_phase, phase_of

NAMES = [field.name for field in fields(Facts)]
EVERYTHING = [
    Facts(**dict(zip(NAMES, values, strict=True))) for values in product((False, True), repeat=len(NAMES))
]

SUCCESSORS = {
    Phase.CARRIED: {Phase.READY},
    Phase.READY: {Phase.TAKING_OFF, Phase.CARRIED},
    Phase.CARRYING: {Phase.DEPLOYING, Phase.RETURNING},
    Phase.DEPLOYING: {Phase.EXPLORING, Phase.CARRYING},
    Phase.TAKING_OFF: {Phase.EXPLORING},
    Phase.EXPLORING: {Phase.RETURNING},
    Phase.RETURNING: {Phase.WAITING, Phase.EXPLORING, Phase.CARRYING},
    Phase.WAITING: {Phase.RETURNING, Phase.EXPLORING, Phase.CARRYING, Phase.LANDING, Phase.DONE},
    Phase.LANDING: {Phase.DONE},
    Phase.DONE: set(),
}


def can_be(start: Phase, facts: Facts) -> bool:
    """Whether a robot that begins in this phase can have these facts: only a carrier has robots aboard."""
    return start == Phase.CARRYING or not facts.aboard


def followers(phase: Phase, **given: bool) -> set[Phase]:
    """Every phase that can follow under the given facts, whatever the other facts are."""
    matching = [facts for facts in EVERYTHING if all(getattr(facts, k) is v for k, v in given.items())]
    return {next_phase(phase, facts) for facts in matching}


@pytest.mark.parametrize("phase", Phase)
def test_only_the_drawn_transitions_exist_and_all_of_them_do(phase):
    assert followers(phase) - {phase} == SUCCESSORS[phase]


@pytest.mark.parametrize("phase", Phase)
def test_nothing_happens_without_a_reason(phase):
    not_any_more = {
        Phase.WAITING: Phase.RETURNING,  # not at the point: go back to it
        Phase.READY: Phase.CARRIED,  # not wanted, or not armed
        Phase.LANDING: Phase.DONE,  # not in the air
    }
    assert next_phase(phase, Facts()) == not_any_more.get(phase, phase)


def test_a_finished_robot_stays_finished():
    assert followers(Phase.DONE) == {Phase.DONE}


def test_a_carrier_lets_go_only_when_the_trigger_fires_and_then_always():
    assert followers(Phase.CARRYING, fire=True) == {Phase.DEPLOYING}
    assert Phase.DEPLOYING not in followers(Phase.CARRYING, fire=False)
    assert followers(Phase.CARRYING, fire=False, must_return=True) == {Phase.RETURNING}
    assert followers(Phase.CARRYING, fire=False, must_return=False, nothing_left=False) == {Phase.CARRYING}


def test_a_carrier_waits_until_the_released_robot_is_clear():
    assert followers(Phase.DEPLOYING, peer_clear=False, aborted=False) == {Phase.DEPLOYING}
    assert followers(Phase.DEPLOYING, peer_clear=True, aborted=False, aboard=True) == {Phase.CARRYING}
    assert followers(Phase.DEPLOYING, peer_clear=True, aborted=False, aboard=False) == {Phase.EXPLORING}
    assert Phase.DEPLOYING not in followers(Phase.DEPLOYING, peer_clear=True)


def test_a_deployment_that_cannot_go_on_ends_in_carrying():
    assert followers(Phase.DEPLOYING, aborted=True) == {Phase.CARRYING}


def test_a_carried_robot_takes_off_exactly_when_it_is_ready_and_then_released():
    assert followers(Phase.CARRIED, ready=False) == {Phase.CARRIED}
    assert followers(Phase.CARRIED, ready=True) == {Phase.READY}
    assert followers(Phase.READY, released=True) == {Phase.TAKING_OFF}
    assert followers(Phase.READY, released=False, ready=True) == {Phase.READY}
    assert followers(Phase.READY, released=False, ready=False) == {Phase.CARRIED}
    assert followers(Phase.TAKING_OFF, peer_clear=False) == {Phase.TAKING_OFF}
    assert followers(Phase.TAKING_OFF, peer_clear=True) == {Phase.EXPLORING}


def test_exploring_ends_when_time_or_goals_run_out():
    assert followers(Phase.EXPLORING, must_return=True) == {Phase.RETURNING}
    assert followers(Phase.EXPLORING, nothing_left=True) == {Phase.RETURNING}
    assert followers(Phase.EXPLORING, nothing_left=False, must_return=False) == {Phase.EXPLORING}


def test_waiting_needs_an_arrival_and_new_goals_resume_the_exploration():
    assert Phase.WAITING not in followers(Phase.RETURNING, arrived=False)
    assert followers(Phase.RETURNING, arrived=True, more=False) == {Phase.WAITING}
    for phase in (Phase.RETURNING, Phase.WAITING):
        resumed = {"more": True, "complete": False}
        assert followers(phase, aboard=False, **resumed) == {Phase.EXPLORING}
        assert followers(phase, aboard=True, **resumed) == {Phase.CARRYING}


@pytest.mark.parametrize("missing", ["arrived", "peers_arrived", "shared", "complete"])
def test_done_needs_everybody_there_and_everything_exchanged(missing):
    assert Phase.DONE not in followers(Phase.WAITING, **{missing: False})
    agreed = dict.fromkeys(("arrived", "peers_arrived", "shared", "complete"), True)
    assert followers(Phase.WAITING, airborne=False, **agreed) == {Phase.DONE}
    assert followers(Phase.WAITING, airborne=True, **agreed) == {Phase.LANDING}
    assert Phase.LANDING not in followers(Phase.WAITING, **{missing: False})


def test_who_lands_is_done_when_it_stands():
    assert followers(Phase.LANDING, airborne=True) == {Phase.LANDING}
    assert followers(Phase.LANDING, airborne=False) == {Phase.DONE}


def test_who_is_at_the_meeting_point_stays_there_until_everybody_is_and_goes_back_when_it_was_moved():
    assert followers(Phase.WAITING, arrived=True, more=False, shared=False) == {Phase.WAITING}
    assert followers(Phase.WAITING, arrived=False, more=False) == {Phase.RETURNING}


@pytest.mark.parametrize("start", [Phase.CARRIED, Phase.CARRYING, Phase.EXPLORING])
def test_every_role_can_get_done_and_only_by_waiting(start):
    reached, fringe = {start}, {start}
    while fringe:
        possible = [facts for facts in EVERYTHING if can_be(start, facts)]
        fringe = {next_phase(phase, facts) for phase in fringe for facts in possible} - reached
        reached |= fringe
    assert Phase.DONE in reached
    assert [phase for phase in Phase if Phase.DONE in followers(phase) and phase != Phase.DONE] == [
        Phase.WAITING,
        Phase.LANDING,
    ]
    assert [phase for phase in Phase if Phase.LANDING in followers(phase) and phase != Phase.LANDING] == [
        Phase.WAITING
    ]
    assert (Phase.CARRYING in reached) is (start == Phase.CARRYING)
    assert (Phase.CARRIED in reached) is (start == Phase.CARRIED)


def test_codes_on_the_air_fit_and_are_fixed():
    assert [phase.name for phase in Phase] == [
        "CARRIED",
        "CARRYING",
        "DEPLOYING",
        "TAKING_OFF",
        "EXPLORING",
        "RETURNING",
        "WAITING",
        "DONE",
        "READY",
        "LANDING",
    ]
    assert [int(phase) for phase in Phase] == list(range(10))


def test_a_code_that_nobody_knows_is_no_phase():
    assert [phase_of(code) for code in range(10)] == list(Phase)
    assert phase_of(10) is phase_of(255) is phase_of(-1) is None


def test_a_robot_aboard_is_at_the_meeting_point_but_not_flying():
    assert {Phase.CARRIED, Phase.READY} == ABOARD
    assert ABOARD <= AT_REGROUP
    assert not ABOARD & FLYING
    assert {Phase.WAITING, Phase.LANDING, Phase.DONE} <= AT_REGROUP & FLYING
    assert not AT_REGROUP & {Phase.EXPLORING, Phase.RETURNING, Phase.CARRYING, Phase.DEPLOYING}
