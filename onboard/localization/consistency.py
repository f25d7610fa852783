"""Which closures agree with each other: the largest set of pairwise consistent ones.

Pairwise consistency maximisation (Mangelson et al., ICRA 2018). Two closures agree when going round through
both, and along odometry between their ends, comes back to where it began, as nearly as odometry can tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
        self._poses: dict[int, dict[int, Pose]] = {}
        self._along_m: dict[int, dict[int, float]] = {}
        """By robot; missing where it has to be worked out anew."""

    def go_on(self, start: Key | None, end: Key, motion: Pose) -> None:
        """Next keyframe of a track; its first one has no start, and `motion` is its pose."""
        before = Pose.identity() if start is None else self._poses[start[0]][start[1]]
        self.put(end, before.compose(motion))

    def put(self, key: Key, pose: Pose) -> None:
        """A keyframe of a track that is told as poses, in any order."""
        self._poses.setdefault(key[0], {})[key[1]] = pose
        self._along_m.pop(key[0], None)

    def way(self, start: Key, end: Key) -> tuple[Pose, float] | None:
        """Motion and length from one keyframe to another; None between robots."""
        if start[0] != end[0]:
            return None
        poses, along_m = self._poses[start[0]], self._lengths(start[0])
        motion = poses[start[1]].inverse().compose(poses[end[1]])
        return motion, abs(along_m[end[1]] - along_m[start[1]])

    def _lengths(self, robot: int) -> dict[int, float]:
        if robot not in self._along_m:
            numbers = sorted(self._poses[robot])
            positions = np.array([self._poses[robot][number].position for number in numbers])
            steps = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
            self._along_m[robot] = dict(zip(numbers, np.cumsum(steps).tolist(), strict=True))
        return self._along_m[robot]


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
    relations = Relations(drift, settings)
    for entry in found:
        relations.add(entry, tracks)
    return relations.consistent()


class Relations:
    """Found closures, and which of them agree with and confirm each other."""

    def __init__(self, drift: DriftModel, settings: ConsistencySettings) -> None:
        self.found: list[Found] = []
        self._drift, self._settings = drift, settings
        self._friends: list[int] = []
        self._confirmed: list[int] = []
        """For every closure the bits of those that it agrees with, and of those that confirm it."""

    def add(self, entry: Found, tracks: Tracks) -> None:
        """Compare a new closure with all before."""
        place = len(self.found)
        self.found.append(entry)
        self._friends.append(1 << place)
        self._confirmed.append(0)
        for other in range(place):
            self._relate(place, other, tracks)

    def anew(self, tracks: Tracks) -> Iterator[None]:
        """Compare all once more, one at a `next`: tracks have changed."""
        found, self.found, self._friends, self._confirmed = self.found, [], [], []
        for entry in found:
            self.add(entry, tracks)
            yield

    def consistent(self) -> list[int]:
        """Places of the closures to be trusted."""
        everyone = range(len(self.found))
        sure = [entry.reach_m <= self._settings.sure_m for entry in self.found]
        eligible = [place for place in everyone if sure[place] or self._confirmed[place]]
        among = [sum((self._friends[i] >> j & 1) << k for k, j in enumerate(eligible)) for i in eligible]
        chosen = [eligible[place] for place in largest_clique(among)]
        return [i for i in chosen if sure[i] or any(self._confirmed[i] >> other & 1 for other in chosen)]

    def _relate(self, i: int, j: int, tracks: Tracks) -> None:
        judged = agreement(self.found[i].closure, self.found[j].closure, tracks, self._drift, self._settings)
        if judged is None or judged.holds:
            self._friends[i] |= 1 << j
            self._friends[j] |= 1 << i
        if judged is None or not judged.holds or judged.apart_m < self._settings.apart_m:
            return
        for one, other in ((i, j), (j, i)):
            if judged.tolerance_m <= self._settings.certainty * self.found[one].reach_m:
                self._confirmed[one] |= 1 << other


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
    branches: int = 500

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
