"""Which closures agree with each other: the largest set of pairwise consistent ones.

Pairwise consistency maximisation (Mangelson et al., ICRA 2018). Two closures agree when going round through
both, and along odometry between their ends, comes back to where it began, as nearly as odometry can tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import Pose
from onboard.localization.lie import between
from onboard.localization.pose_graph import Closure, DriftModel, Key

_WHOLE = Pose.identity()


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """What two closures may differ by and still agree."""

    shift_m: float = 0.2
    turn_rad: float = 0.02
    drift_times: float = 2.0
    """... and so many times what odometry may err on the ways between their ends."""
    apart_m: float = 5.0
    """A closure confirms another that was found at least so far away ..."""
    certainty: float = 0.5
    """... if what the two may differ by is less than this share of how far the other was searched."""
    sure_m: float = 1.5
    """Closures found within such a reach of where they were expected need no other to confirm them."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A verified closure and how far around the expected place it was searched."""

    closure: Closure
    reach_m: float


class Tracks:
    """Where every robot's own sensors put its keyframes, closures unheeded: ways and their lengths."""

    def __init__(self) -> None:
        self._at: dict[Key, tuple[float, Pose]] = {}

    def go_on(self, start: Key | None, end: Key, motion: Pose) -> None:
        """Next keyframe of a track; its first one has no start, and `motion` is its pose."""
        along_m, pose = (0.0, Pose.identity()) if start is None else self._at[start]
        step_m = 0.0 if start is None else _length(motion)
        self._at[end] = along_m + step_m, pose.compose(motion)

    def put(self, key: Key, along_m: float, pose: Pose) -> None:
        """A keyframe of a track that is told as poses, so far along it."""
        self._at[key] = along_m, pose

    def way(self, start: Key, end: Key) -> tuple[Pose, float] | None:
        """Motion and length from one keyframe to another; None between robots."""
        if start[0] != end[0]:
            return None
        (start_m, pose), (end_m, other) = self._at[start], self._at[end]
        return pose.inverse().compose(other), abs(end_m - start_m)


@dataclass(frozen=True, slots=True)
class Agreement:
    """What two closures may differ by, whether they differ by less, and how far apart they were found."""

    tolerance_m: float
    holds: bool
    apart_m: float


def agreement(
    a: Closure, b: Closure, tracks: Tracks, drift: DriftModel, settings: ConsistencySettings
) -> Agreement | None:
    """Compare two closures by the loop through both; None where odometry does not join their ends."""
    older, newer = tracks.way(b.older, a.older), tracks.way(a.newer, b.newer)
    if older is None or newer is None:
        return None
    loop = a.motion.compose(newer[0]).compose(b.motion.inverse()).compose(older[0])
    missed = between(_WHOLE, loop)
    spread = drift.spread(older[1] + newer[1])
    turn = settings.turn_rad + settings.drift_times * spread.turn_rad
    arm_m = min(_length(older[0]), _length(newer[0]))
    shift = settings.shift_m + settings.turn_rad * arm_m + settings.drift_times * spread.shift_m
    holds = bool(np.linalg.norm(missed[:3]) <= shift and np.linalg.norm(missed[3:]) <= turn)
    return Agreement(shift, holds, _length(newer[0]))


def consistent(
    found: Sequence[Found], tracks: Tracks, drift: DriftModel, settings: ConsistencySettings
) -> list[int]:
    """Places of the closures to be trusted: the largest set that agrees, each sure or confirmed by another.

    Closures that odometry does not relate agree.
    """
    friends, confirms = _related(found, tracks, drift, settings)
    sure = [entry.reach_m <= settings.sure_m for entry in found]
    eligible = [place for place in range(len(found)) if sure[place] or confirms[place]]
    among = [sum((friends[i] >> j & 1) << k for k, j in enumerate(eligible)) for i in eligible]
    chosen = [eligible[place] for place in largest_clique(among)]
    return [i for i in chosen if sure[i] or any(confirms[i] >> other & 1 for other in chosen)]


def _related(
    found: Sequence[Found], tracks: Tracks, drift: DriftModel, settings: ConsistencySettings
) -> tuple[list[int], list[int]]:
    """For every closure the bits of those that it agrees with, and of those that confirm it."""
    count = len(found)
    friends, confirms = [(1 << count) - 1] * count, [0] * count
    for i in range(count):
        for j in range(i):
            judged = agreement(found[i].closure, found[j].closure, tracks, drift, settings)
            if judged is None:
                continue
            if not judged.holds:
                friends[i] &= ~(1 << j)
                friends[j] &= ~(1 << i)
            elif judged.apart_m >= settings.apart_m:
                for one, other in ((i, j), (j, i)):
                    if judged.tolerance_m <= settings.certainty * found[one].reach_m:
                        confirms[one] |= 1 << other
    return friends, confirms


def largest_clique(friends: Sequence[int]) -> list[int]:
    """Largest set of mutual friends, bit j of friends[i] telling whether i and j agree.

    Branch and bound with greedy colouring (Tomita & Seki, 2003), given up after so many branches that larger
    problems end with the best set found until then.
    """
    masks = [mask & ~(1 << place) for place, mask in enumerate(friends)]
    search = _Clique(masks)
    search.grow(0, 0, (1 << len(masks)) - 1)
    return [place for place in range(len(masks)) if search.best >> place & 1]


@dataclass(slots=True)
class _Clique:
    masks: list[int]
    best: int = 0
    branches: int = 20_000

    def grow(self, chosen: int, size: int, candidates: int) -> None:
        order = self._coloured(candidates)
        for colours, place in reversed(order):
            if size + colours <= self.best.bit_count() or self.branches == 0:
                return
            self.branches -= 1
            larger, left = chosen | 1 << place, candidates & self.masks[place]
            if left:
                self.grow(larger, size + 1, left)
            elif size + 1 > self.best.bit_count():
                self.best = larger
            candidates &= ~(1 << place)

    def _coloured(self, candidates: int) -> list[tuple[int, int]]:
        """(colour, place): no two friends share a colour, so that colours bound the size of a clique."""
        order, colour = [], 0
        while candidates:
            colour += 1
            free = candidates
            while free:
                place = (free & -free).bit_length() - 1
                candidates &= ~(1 << place)
                free &= ~(self.masks[place] | 1 << place)
                order.append((colour, place))
        return order


def _length(motion: Pose) -> float:
    return float(np.linalg.norm(motion.position))
