"""The regrouping point: its choice, and a model check of its agreement over a bad link."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.regroup import Acceptor, Proposer, choose_point, thinned

times = st.lists(st.one_of(st.floats(0, 500), st.just(np.inf)), min_size=1, max_size=12)


@given(times, st.integers(0, 2**31), st.floats(0, 600), st.floats(0, 600))
def test_the_point_is_affordable_for_both_and_no_other_is_sooner(ground, seed, ground_limit, aerial_limit):
    ground_s = np.array(ground)
    aerial_s = np.random.default_rng(seed).uniform(0, 500, len(ground))
    fits = [
        max(g, a) for g, a in zip(ground_s, aerial_s, strict=True) if g <= ground_limit and a <= aerial_limit
    ]
    best = choose_point(ground_s, aerial_s, ground_limit, aerial_limit)
    if best is None:
        assert fits == []
        return
    assert ground_s[best] <= ground_limit
    assert aerial_s[best] <= aerial_limit
    assert max(ground_s[best], aerial_s[best]) == min(fits)


def test_places_that_one_robot_cannot_reach_are_never_chosen():
    far = np.array([np.inf, 90.0])
    assert choose_point(far, np.array([1.0, 80.0]), np.inf, np.inf) == 1
    assert choose_point(far, np.array([1.0, np.inf]), np.inf, np.inf) is None


@given(st.lists(st.tuples(*[st.floats(-30, 30)] * 3), min_size=1, max_size=40), st.floats(0.1, 10))
def test_thinned_points_are_apart_cover_the_rest_and_start_with_the_newest(points, spacing):
    places = np.array(points)
    chosen = thinned(places, spacing)
    assert chosen[0] == len(points) - 1
    assert (np.diff(chosen) < 0).all()
    kept = places[chosen]
    gaps = np.linalg.norm(kept[:, None] - kept[None], axis=2)
    assert gaps[~np.eye(len(kept), dtype=bool)].min(initial=np.inf) >= spacing
    offsets = np.linalg.norm(places[:, None] - kept[None], axis=2).min(axis=1)
    assert (offsets < spacing).all()


def point(epoch: int) -> np.ndarray:
    return np.array([10.0 * epoch, 0.0, 0.0])


@dataclass
class World:
    """Both sides and every message ever sent: each may arrive at any time, any number of times, or never."""

    proposer: Proposer = field(default_factory=lambda: Proposer(point(0)))
    acceptor: Acceptor = field(default_factory=lambda: Acceptor([point(0)]))
    sent: frozenset[tuple[str, int]] = frozenset()
    feasible: bool = True

    def moves(self) -> list[tuple[str, int]]:
        return [("start", 0), ("reverse", 0), *sorted(self.sent)]

    def after(self, move: tuple[str, int]) -> World:
        """After the proposer's new idea, the acceptor's turn to its other point, or a message."""
        world = copy.deepcopy(self)
        kind, epoch = move
        match kind:
            case "start":
                started = world.proposer.propose(point(world.proposer.epoch + 1))
                world._send([("propose", started[0])] if started else [])
            case "reverse":
                world.acceptor.points.reverse()
                world.acceptor.epochs.reverse()
            case "propose":
                agreed = world.acceptor.proposed(epoch, point(epoch), self.feasible)
                world._send([("ack", epoch)] if agreed else [])
            case "ack":
                world._send([("commit", epoch)] if world.proposer.acknowledged(epoch) else [])
            case "commit":
                world.acceptor.committed(epoch)
        return world

    def _send(self, messages: list[tuple[str, int]]) -> None:
        self.sent |= frozenset(messages)

    def state(self) -> tuple:
        pending = None if self.proposer.pending is None else self.proposer.pending[0]
        return (self.proposer.epoch, pending, tuple(self.acceptor.epochs), self.sent)

    def check(self) -> None:
        assert len(self.acceptor.points) == len(self.acceptor.epochs) <= 2
        assert any(np.array_equal(self.proposer.point, held) for held in self.acceptor.points)
        for epoch, held in zip(self.acceptor.epochs, self.acceptor.points, strict=True):
            assert np.array_equal(held, point(epoch))
        assert self.acceptor.in_doubt == (len(self.acceptor.points) == 2)


def reachable_worlds(deliveries: int) -> dict[tuple, World]:
    """All states within that many steps: deliveries of new, old or repeated messages, ideas, turns."""
    known = {World().state(): World()}
    fringe = list(known.values())
    for _ in range(deliveries):
        following = [world.after(move) for world in fringe for move in world.moves()]
        fringe = []
        for world in following:
            world.check()
            if world.state() not in known:
                known[world.state()] = world
                fringe.append(world)
    return known


def test_the_proposer_always_flies_to_a_point_that_the_acceptor_will_visit():
    worlds = reachable_worlds(12)
    assert len(worlds) > 15
    assert max(world.proposer.epoch for world in worlds.values()) == 3
    assert any(world.acceptor.in_doubt for world in worlds.values())


def test_doubt_can_always_be_ended_by_delivering_what_was_sent():
    for start in reachable_worlds(10).values():
        world = start
        for _ in range(5):
            for move in sorted(world.sent, key=lambda m: ("propose", "ack", "commit").index(m[0])):
                world = world.after(move)
        assert not world.acceptor.in_doubt
        assert np.array_equal(world.proposer.point, world.acceptor.points[0])


def test_an_infeasible_point_is_never_acknowledged():
    world = World(feasible=False).after(("start", 0))
    assert world.after(("propose", 1)).sent == {("propose", 1)}
    assert len(world.after(("propose", 1)).acceptor.points) == 1


def test_no_new_proposal_is_answered_while_in_doubt_except_a_repeat():
    acceptor = Acceptor([point(0)])
    assert acceptor.proposed(1, point(1), True)
    assert acceptor.proposed(1, point(1), True)
    assert not acceptor.proposed(2, point(2), True)
    acceptor.committed(1)
    assert [held.tolist() for held in acceptor.points] == [point(1).tolist()]
    assert not acceptor.proposed(0, point(0), True)


def test_a_proposer_has_one_proposal_at_a_time_and_none_for_where_it_goes_anyway():
    proposer = Proposer(point(0))
    assert proposer.propose(point(0) + 0.1) is None
    started = proposer.propose(point(1))
    assert started is not None
    assert proposer.propose(point(2)) is None
    assert not proposer.acknowledged(started[0] + 1)
    assert np.array_equal(proposer.point, point(0))
    assert proposer.acknowledged(started[0])
    assert not proposer.acknowledged(started[0])
    assert np.array_equal(proposer.point, point(1))


def test_a_commit_for_an_unknown_epoch_changes_nothing():
    acceptor = Acceptor([point(0)])
    acceptor.proposed(1, point(1), True)
    acceptor.committed(7)
    assert acceptor.in_doubt


@pytest.mark.parametrize("order", [[1, 0], [0, 1]])
def test_late_and_early_commits_leave_the_newest_point(order):
    acceptor = Acceptor([point(0)])
    acceptor.proposed(1, point(1), True)
    for epoch in order:
        acceptor.committed(epoch)
    assert acceptor.epochs == [1]
