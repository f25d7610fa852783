"""Closed loops: which keyframes may see the same place, and how the one lies in the other's surroundings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.localization.consistency import Found
from onboard.localization.pose_graph import Closure, Key, PoseGraph, Spread
from onboard.localization.registration import Reason, Registration, RegistrationSettings, registering
from onboard.localization.submaps import Submap, SubmapSettings

ScanOf = Callable[[Key], Scan | None]
"""Finds the scan of a keyframe; None if it is not kept."""


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """When a loop is looked for."""

    near_m: float = 4.0
    above_m: float = 1.5
    """Keyframes this near, and no more than so much higher or lower, see the same: floors part storeys."""
    way_m: float = 15.0
    """Nearer along the way (over steps and closures) there is nothing to gain."""
    base_m: float = 0.3
    base_rad: float = 0.05
    drift_times: float = 1.5
    """How far around the expected place is searched: the base and so many times what odometry may err."""
    max_reach_m: float = 8.0
    max_turn_rad: float = 0.4
    tries: int = 2
    """Candidates a keyframe ..."""
    tries_apart_m: float = 6.0
    """... whose places are at least so far apart."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Keyframes that may see the same place, if the newer one is within reach of where it seems to be."""

    older: Key
    newer: Key
    reach_m: float
    turn_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """A candidate looked at: what came of it, and the closure if it was accepted."""

    candidate: Candidate
    registration: Registration
    found: Found | None


class Refusals:
    """Loops looked at in vain: their neighbours are passed over, more of them after every further one."""

    def __init__(self, beside: int = 3, least: int = 1, most: int = 6) -> None:
        """Neighbours: `beside` keyframes about the older one, `least` to `most` about the newer one."""
        self._beside, self._least, self._most = beside, least, most
        self._kept: deque[tuple[Candidate, int]] = deque(maxlen=200)

    def note(self, candidate: Candidate) -> None:
        """It was refused."""
        widths = [width for other, width in self._kept if self._near(other, candidate, width + self._least)]
        width = min(2 * max(widths), self._most) if widths else self._least
        self._kept.append((candidate, width))

    def cover(self, candidate: Candidate) -> bool:
        """Whether it is a neighbour of a refused one."""
        return any(self._near(other, candidate, width) for other, width in self._kept)

    def clear(self) -> None:
        """Estimates have changed."""
        self._kept.clear()

    def _near(self, a: Candidate, b: Candidate, width: int) -> bool:
        same = a.older[0] == b.older[0] and a.newer[0] == b.newer[0]
        return same and abs(a.older[1] - b.older[1]) <= self._beside and abs(a.newer[1] - b.newer[1]) <= width


def propose(graph: PoseGraph, key: Key, robot: int, settings: LoopSettings) -> list[Candidate]:
    """Loops of `robot` that keyframe `key` may close, the nearest first.

    A peer's keyframe is the older one of a loop.
    """
    here = graph.poses[key].position
    options = []
    for other, spread in graph.spreads_from(key).items():
        if spread.length_m < settings.way_m or robot not in (key[0], other[0]):
            continue
        reach_m, turn_rad = _reach(spread, settings)
        apart = np.abs(graph.poses[other].position - here)
        beside_m = float(np.hypot(apart[0], apart[1]))
        if beside_m <= settings.near_m + reach_m and apart[2] <= settings.above_m + reach_m:
            distance_m = beside_m + settings.near_m / settings.above_m * float(apart[2])
            ends = (key, other) if key[0] != robot else (other, key)
            options.append((distance_m, Candidate(*ends, reach_m, turn_rad)))
    return _apart(graph, [candidate for _, candidate in sorted(options, key=_order)], settings)


def _order(option: tuple[float, Candidate]) -> tuple[float, Key, Key]:
    return option[0], option[1].older, option[1].newer


def _reach(spread: Spread, settings: LoopSettings) -> tuple[float, float]:
    reach_m = settings.base_m + settings.drift_times * spread.shift_m
    turn_rad = settings.base_rad + settings.drift_times * spread.turn_rad
    return min(reach_m, settings.max_reach_m), min(turn_rad, settings.max_turn_rad)


def _apart(graph: PoseGraph, ranked: list[Candidate], settings: LoopSettings) -> list[Candidate]:
    chosen: list[Candidate] = []
    for candidate in ranked:
        if all(_places_apart(graph, candidate, other) >= settings.tries_apart_m for other in chosen):
            chosen.append(candidate)
        if len(chosen) == settings.tries:
            break
    return chosen


def _places_apart(graph: PoseGraph, a: Candidate, b: Candidate) -> float:
    """Metres between the keyframes that are not shared."""
    return max(graph.apart_m(a.older, b.older), graph.apart_m(a.newer, b.newer))


def submap_of(graph: PoseGraph, key: Key, scan_of: ScanOf, settings: SubmapSettings) -> Submap | None:
    """Scans of the keyframes around `key` along its robot's way, in axes parallel to the map's about it.

    None where its own scan is not kept.
    """
    centre = graph.poses[key].position
    around = [key, *_along(graph, key, 1, settings), *_along(graph, key, -1, settings)]
    scans = [(scan_of(other), graph.poses[other]) for other in around]
    if scans[0][0] is None:
        return None
    placed = [(scan, Pose(p.position - centre, p.quaternion)) for scan, p in scans if scan is not None]
    return Submap(placed, settings)


def _along(graph: PoseGraph, key: Key, direction: int, settings: SubmapSettings) -> list[Key]:
    """Keyframes of the same robot on one side of `key`, up to the half length, spaced."""
    robot, sequence = key
    found: list[Key] = []
    last = key
    walked_m = 0.0
    while (following := (robot, sequence + direction)) in graph.poses:
        walked_m += graph.apart_m((robot, sequence), following)
        if walked_m > settings.half_length_m:
            break
        if graph.apart_m(last, following) >= settings.spacing_m:
            found.append(following)
            last = following
        sequence += direction
    return found


def verifying(
    graph: PoseGraph, candidate: Candidate, older: Submap, newer: Submap, settings: RegistrationSettings
) -> Generator[None, None, Verified]:
    """Register the surroundings of the newer keyframe to those of the older one, a piece at a `next`.

    The submaps are as bent as odometry makes them over their length: so much is added to the covariance.
    """
    at, now = graph.poses[candidate.older], graph.poses[candidate.newer]
    guess = Pose(now.position - at.position, Pose.identity().quaternion)
    result = yield from registering(older, newer, guess, candidate.reach_m, candidate.turn_rad, settings)
    if result.reason is not Reason.ACCEPTED or result.fit is None or result.covariance is None:
        return Verified(candidate, result, None)
    # the submaps' axes are the map's: from there to the keyframes' own
    moved = result.fit.pose.compose(Pose(np.zeros(3), now.quaternion))
    motion = Pose(np.zeros(3), at.quaternion).inverse().compose(moved)
    bend = graph.drift.spread(older.settings.half_length_m)
    bent = np.diag([bend.shift_m**2] * 3 + [bend.turn_rad**2] * 3)
    covariance = _in_axes(result.covariance, now) + bent
    closure = Closure(candidate.older, candidate.newer, motion, covariance)
    return Verified(candidate, result, Found(closure, candidate.reach_m))


def _in_axes(covariance: FloatArray, pose: Pose) -> FloatArray:
    """A covariance (6, 6) given in axes parallel to the map's, in those of a pose."""
    turn = np.kron(np.eye(2), pose.rotation.T)
    return np.asarray(turn @ covariance @ turn.T)
