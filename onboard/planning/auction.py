"""Who looks at what: every robot bids for places that it could look at, and all agree on one winner each.

A decentralised auction of bundles (after CBBA: Choi, Brunet and How 2009). A task is a cell of space. What is
shared is only each robot's newest bundle of bids; the winner of a task follows from them (highest score, then
lowest id), so that all who hold the same bundles agree, in whatever order and how often these arrived. A
bundle is a lease: a robot that falls silent loses its tasks when it runs out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.planning.local_graph import FloatArray

CELL_M = 6.0
BUNDLE = 4
LEASE_S = 30.0
FADE_S = 120.0
"""Time constant by which a gain is worth less the later it is reached."""
NEWER_S = 0.5
"""Ages cross the air in tenths of a second: closer stamps are the same bundle, come two ways."""
LOYALTY = 1.1
"""What is already won counts that much more: scores that are nearly equal shall not flip at every cycle."""

Cell = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Wish:
    """A place (3,) in metres that a robot could look at, what it would see there in m^3, and when."""

    position: FloatArray
    gain_m3: float
    time_s: float


@dataclass(frozen=True, eq=False)
class Bid:
    """A robot's claim to the task of the cell around `position` (3,), worth `score` (m^3/s)."""

    position: FloatArray
    score: float

    @property
    def cell(self) -> Cell:
        return cell_of(self.position)


@dataclass(frozen=True)
class Bundle:
    """All bids of one robot at one time of the receiver's clock."""

    robot: int
    stamp_s: float
    bids: tuple[Bid, ...]


def cell_of(position: FloatArray) -> Cell:
    """The task that a place (3,) belongs to."""
    x, y, z = (int(c) for c in np.floor(np.asarray(position) / CELL_M))
    return x, y, z


class Auction:
    """One robot's view of the auction."""

    def __init__(self, robot: int, speed_m_s: float) -> None:
        self._robot = robot
        self._speed_m_s = speed_m_s
        self._bundles: dict[int, Bundle] = {}

    def bid(self, now_s: float, wishes: Sequence[Wish], start_up_s: float) -> Bundle:
        """Bid for up to BUNDLE tasks that this robot values more than who holds them; a new bundle.

        Greedy: the next task is the one with the best score behind those already taken, with straight flights
        between them as a lower bound of the time.
        """
        held = {bid.cell for bid in self._live(self._robot, now_s)}
        open_wishes = _best_of_each_cell(wishes)
        bids: list[Bid] = []
        end: Wish | None = None
        while open_wishes and len(bids) < BUNDLE:
            rated = [self._rated(wish, end, start_up_s, held) for wish in open_wishes]
            best = max(range(len(rated)), key=lambda i: rated[i].score)
            wish, offer = open_wishes.pop(best), rated[best]
            if self._wins(offer, now_s):
                time_s = self._time_to(wish, end)
                bids.append(offer)
                end = Wish(wish.position, wish.gain_m3, time_s)
        bundle = Bundle(self._robot, now_s, tuple(bids))
        self._bundles[self._robot] = bundle
        return bundle

    def _time_to(self, wish: Wish, end: Wish | None) -> float:
        if end is None:
            return wish.time_s
        return end.time_s + float(np.linalg.norm(wish.position - end.position)) / self._speed_m_s

    def _rated(self, wish: Wish, end: Wish | None, start_up_s: float, held: set[Cell]) -> Bid:
        time_s = self._time_to(wish, end)
        score = wish.gain_m3 * float(np.exp(-time_s / FADE_S)) / (time_s + start_up_s)
        return Bid(wish.position, score * (LOYALTY if cell_of(wish.position) in held else 1.0))

    def _wins(self, offer: Bid, now_s: float) -> bool:
        rivals = [
            (bid.score, -robot)
            for robot in self._bundles
            if robot != self._robot
            for bid in self._live(robot, now_s)
            if bid.cell == offer.cell
        ]
        return (offer.score, -self._robot) > max(rivals, default=(0.0, -np.inf))

    def receive(self, bundle: Bundle) -> None:
        """Take in a bundle of another robot; an older one than the newest known changes nothing."""
        known = self._bundles.get(bundle.robot)
        if bundle.robot != self._robot and (known is None or bundle.stamp_s > known.stamp_s + NEWER_S):
            self._bundles[bundle.robot] = bundle

    def bundles(self, now_s: float) -> list[Bundle]:
        """All bundles whose lease has not run out, to be passed on."""
        return [bundle for bundle in self._bundles.values() if now_s - bundle.stamp_s < LEASE_S]

    def winners(self, now_s: float) -> dict[Cell, int]:
        """The robot that has won each task."""
        best: dict[Cell, tuple[float, int]] = {}
        for bundle in self.bundles(now_s):
            for bid in bundle.bids:
                offer = bid.score, -bundle.robot
                best[bid.cell] = max(best.get(bid.cell, offer), offer)
        return {cell: -negative for cell, (_, negative) in best.items()}

    def taken(self, now_s: float) -> list[FloatArray]:
        """Places (3,) whose tasks other robots have won."""
        winners = self.winners(now_s)
        return [
            bid.position
            for bundle in self.bundles(now_s)
            if bundle.robot != self._robot
            for bid in bundle.bids
            if winners[bid.cell] == bundle.robot
        ]

    def _live(self, robot: int, now_s: float) -> tuple[Bid, ...]:
        bundle = self._bundles.get(robot)
        return bundle.bids if bundle is not None and now_s - bundle.stamp_s < LEASE_S else ()


def _best_of_each_cell(wishes: Sequence[Wish]) -> list[Wish]:
    """Wishes worth something, one for each task."""
    best: dict[Cell, Wish] = {}
    for wish in wishes:
        cell = cell_of(wish.position)
        if wish.gain_m3 > 0 and (cell not in best or wish.gain_m3 > best[cell].gain_m3):
            best[cell] = wish
    return list(best.values())
