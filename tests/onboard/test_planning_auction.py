"""Who looks at what: bundles, winners, leases, and agreement whatever the radio does."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.auction import BUNDLE, LEASE_S, Auction, Bid, Bundle, Wish, cell_of

PLACES = [np.array([8.0 * x, 8.0 * y, 1.0]) for x, y in itertools.product(range(4), range(3))]
START_UP_S = 3.0


def wish(place: int, gain_m3: float = 50.0, time_s: float = 10.0) -> Wish:
    return Wish(PLACES[place], gain_m3, time_s)


def bundle(robot: int, stamp_s: float, *bids: tuple[int, float]) -> Bundle:
    return Bundle(robot, stamp_s, tuple(Bid(PLACES[place], score) for place, score in bids))


def cells(made: Bundle) -> list[tuple[int, int, int]]:
    return [bid.cell for bid in made.bids]


def test_alone_a_robot_takes_the_best_tasks_in_the_order_it_would_visit_them():
    auction = Auction(1, 1.0)
    made = auction.bid(0.0, [wish(0, 10), wish(1, 80, 5.0), wish(2, 80, 20.0), wish(3, 0.0)], START_UP_S)
    assert cells(made)[:2] == [cell_of(PLACES[1]), cell_of(PLACES[2])]
    assert cell_of(PLACES[3]) not in cells(made)
    scores = [bid.score for bid in made.bids]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] == pytest.approx(80 * np.exp(-5 / 120) / 8)
    assert auction.taken(0.0) == []


def test_a_bundle_is_bounded_and_has_one_bid_for_a_task():
    close = [Wish(PLACES[0] + np.array([0.1 * i, 0.0, 0.0]), 50.0, 9.0) for i in range(5)]
    made = Auction(1, 1.0).bid(0.0, close + [wish(i) for i in range(1, 9)], START_UP_S)
    assert len(made.bids) == BUNDLE == len(set(cells(made)))


def test_a_task_that_another_robot_values_more_is_left_to_it():
    auction = Auction(1, 1.0)
    auction.receive(bundle(2, 0.0, (0, 1e3), (1, 1e-3)))
    made = auction.bid(1.0, [wish(0), wish(1)], START_UP_S)
    assert cells(made) == [cell_of(PLACES[1])]
    assert [place.tolist() for place in auction.taken(1.0)] == [PLACES[0].tolist()]


def test_equal_bids_go_to_the_lower_id():
    score = Auction(3, 1.0).bid(0.0, [wish(0)], START_UP_S).bids[0].score
    for rival, wins in ((2, False), (4, True)):
        auction = Auction(3, 1.0)
        auction.receive(bundle(rival, 0.0, (0, score)))
        assert bool(auction.bid(0.0, [wish(0)], START_UP_S).bids) is wins


def test_a_silent_robot_loses_its_tasks_when_the_lease_runs_out():
    auction = Auction(1, 1.0)
    auction.receive(bundle(2, 0.0, (0, 1e3)))
    assert auction.bid(LEASE_S - 0.1, [wish(0)], START_UP_S).bids == ()
    assert len(auction.taken(LEASE_S - 0.1)) == 1
    assert len(auction.bid(LEASE_S, [wish(0)], START_UP_S).bids) == 1
    assert auction.taken(LEASE_S) == []
    assert [known.robot for known in auction.bundles(LEASE_S)] == [1]


def test_what_is_held_is_kept_against_a_nearly_equal_offer():
    auction = Auction(2, 1.0)
    first = auction.bid(0.0, [wish(0)], START_UP_S).bids[0].score
    auction.receive(bundle(1, 1.0, (0, first * 1.05)))
    assert len(auction.bid(2.0, [wish(0)], START_UP_S).bids) == 1
    auction.receive(bundle(1, 3.0, (0, first * 1.2)))
    assert auction.bid(4.0, [wish(0)], START_UP_S).bids == ()


def test_an_older_copy_that_came_the_long_way_changes_nothing():
    auction = Auction(1, 1.0)
    auction.receive(bundle(2, 10.0, (1, 5.0)))
    auction.receive(bundle(2, 7.1, (0, 9.0)))
    auction.receive(bundle(2, 10.2, (0, 9.0)))  # the same bundle, its age rounded twice
    assert [place.tolist() for place in auction.taken(11.0)] == [PLACES[1].tolist()]


def test_nobody_tells_a_robot_what_it_bids_itself():
    auction = Auction(1, 1.0)
    auction.receive(bundle(1, 5.0, (0, 1e6)))
    assert auction.winners(5.0) == {}


offers = st.lists(st.tuples(st.integers(0, 11), st.floats(0.1, 10)), max_size=4)


@given(st.lists(offers, min_size=2, max_size=5), st.randoms(use_true_random=False))
def test_all_who_hold_the_same_bundles_agree_and_each_task_has_one_winner(all_offers, random):
    known = [bundle(robot, 1.0, *bids) for robot, bids in enumerate(all_offers)]
    views = []
    for robot in range(len(known), len(known) + 3):
        arrivals = known * 2
        random.shuffle(arrivals)
        auction = Auction(robot, 1.0)
        for one in arrivals:
            auction.receive(one)
        views.append(auction)
    winners = views[0].winners(2.0)
    assert all(view.winners(2.0) == winners for view in views)
    assert set(winners) == {bid.cell for one in known for bid in one.bids}
    for cell, winner in winners.items():
        best = max(bid.score for one in known for bid in one.bids if bid.cell == cell)
        assert best == max(bid.score for bid in known[winner].bids if bid.cell == cell)


@given(st.integers(2, 5), st.integers(0, 2**31), st.floats(0, 0.5))
def test_rounds_of_bidding_over_a_lossy_radio_end_without_two_robots_at_one_task(robots, seed, loss):
    rng = np.random.default_rng(seed)
    auctions = [Auction(robot, 1.0) for robot in range(robots)]
    wishes = [[wish(p, *rng.uniform((5, 2), (200, 60))) for p in range(len(PLACES))] for _ in auctions]
    for turn in range(30):
        made = [a.bid(3.0 * turn, w, START_UP_S) for a, w in zip(auctions, wishes, strict=True)]
        for one, auction in itertools.product(made, auctions):
            if rng.random() >= loss or turn >= 24:
                auction.receive(one)
    held = [cell for one in made for cell in cells(one)]
    assert len(held) == len(set(held))
    assert all(one.bids for one in made) or len(set(held)) == len(PLACES)
