"""Pose graph of keyframes: odometry from one to the next, closed loops, and what is known from outside.

Batch optimisation with gtsam; graduated non-convexity (Yang et al., RA-L 2020) finds out which closures bend
the graph beyond what odometry allows, and leaves those out.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.non_convexity import Rounds, chi_square_limit

Key = tuple[int, int]
"""(robot, sequence) of a keyframe."""

_SWAP = np.array([3, 4, 5, 0, 1, 2])
"""Between (shift, rotation vector) here and (rotation vector, shift) in gtsam; its own inverse."""


@dataclass(frozen=True, slots=True, order=True)
class Spread:
    """How uncertain one keyframe is seen from another: at most so far and so turned, over so long a way."""

    length_m: float
    shift_m: float
    turn_rad: float

    def further(self, other: Spread) -> Spread:
        return Spread(
            self.length_m + other.length_m, self.shift_m + other.shift_m, self.turn_rad + other.turn_rad
        )


@dataclass(frozen=True, slots=True)
class DriftModel:
    """How odometry goes astray beyond the noise of its steps: slowly varying errors of scale and heading."""

    shift_per_m: float = 0.01
    turn_rad_per_m: float = 2e-4
    correlation_m: float = 20.0
    """Over so many metres of the way the errors are alike."""

    def covariance(self, length_m: float) -> FloatArray:
        """(6, 6) to be added to that of a step, so that many steps together err as they really do."""
        shift, turn = self.shift_per_m**2, self.turn_rad_per_m**2
        return np.asarray(np.diag([shift] * 3 + [turn] * 3) * self.correlation_m * length_m)

    def spread(self, length_m: float) -> Spread:
        """How far a way of this length may lead astray."""
        return Spread(length_m, self.shift_per_m * length_m, self.turn_rad_per_m * length_m)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Odometry from keyframe `start` to `end`: motion of the sensor and covariance (6, 6) of it."""

    start: Key
    end: Key
    motion: Pose
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """Keyframe `newer` seen from keyframe `older`: `motion` is its pose there, with covariance (6, 6)."""

    older: Key
    newer: Key
    motion: Pose
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A pose known from outside: of the first keyframe, or what a peer says of its own; covariance (6, 6)."""

    pose: Pose
    covariance: FloatArray


NO_SPREAD = Spread(0.0, 0.0, 0.0)
_MAP: Key = (-1, 0)
"""Stands for the map frame, which all anchors are tied to."""


@dataclass(slots=True)
class PoseGraph:
    """Keyframes and what ties them together; `poses` are the estimates in the map frame.

    Everything is kept in order of arrival, so that the same calls give the same poses, bit for bit.
    """

    drift: DriftModel = field(default_factory=DriftModel)
    inlier_probability: float = 0.999
    """A closure is an outlier when it misses by more than this share of good ones would."""
    poses: dict[Key, Pose] = field(default_factory=dict)
    anchors: dict[Key, Anchor] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    refused: set[int] = field(default_factory=set)
    """Places in `closures` of those that the last optimisation left out."""
    _edges: dict[Key, list[tuple[Key, Spread]]] | None = None
    """None where they have to be collected anew."""

    def anchor(self, key: Key, anchor: Anchor) -> None:
        """Add a keyframe whose pose is known from outside, or say anew where it is."""
        self.poses[key] = anchor.pose
        self.anchors[key] = anchor
        self._edges = None

    def add_step(self, step: Step) -> Pose:
        """Add keyframe `step.end`; its pose as far as odometry tells. Raises InputError out of order."""
        if step.start not in self.poses or step.end in self.poses:
            raise InputError(f"odometry from keyframe {step.start} to {step.end}: not the next one")
        self.poses[step.end] = self.poses[step.start].compose(step.motion)
        self.steps.append(step)
        if self._edges is not None:
            _tie(self._edges, step.start, step.end, self._spread(step))
        return self.poses[step.end]

    def close(self, closures: Sequence[Closure]) -> None:
        """These loops are closed now, and no others. Raises InputError for unknown keyframes."""
        for closure in closures:
            if closure.older not in self.poses or closure.newer not in self.poses:
                raise InputError(f"closure between unknown keyframes {closure.older} and {closure.newer}")
        self.closures = list(closures)
        self.leave_out(set())

    def optimise(self) -> None:
        """Move all poses to where steps, closures and anchors agree best, outlying closures left out."""
        for _ in self.optimising():
            pass

    def optimising(self) -> Iterator[None]:
        """The same in pieces, one at a `next`; poses move in the last piece, keyframes added since along.

        Closures must stay as they are meanwhile.
        """
        if not self.closures:
            return
        numbers = {key: number for number, key in enumerate(self.poses)}
        firm, values = self._firm(numbers)
        yield
        rounds = Rounds(chi_square_limit(self.inlier_probability), len(self.closures))
        while not rounds.done:
            values = _solved(firm, self._tied(numbers, rounds.weights), values)
            rounds.judge(self._misses(numbers, values))
            yield
        later = self._carried({key: _from_gtsam(values.atPose3(number)) for key, number in numbers.items()})
        self.poses = later
        self.leave_out({place for place, weight in enumerate(rounds.weights) if weight < 0.5})

    def _carried(self, moved: dict[Key, Pose]) -> dict[Key, Pose]:
        """Moved poses, and those of keyframes that came meanwhile."""
        for key in self.poses:
            if key in self.anchors:
                moved.setdefault(key, self.poses[key])
        for step in self.steps:
            if step.end not in moved:
                moved[step.end] = moved[step.start].compose(step.motion)
        return {key: moved[key] for key in self.poses}

    def trusted(self) -> list[Closure]:
        """The closures that hold."""
        return [closure for place, closure in enumerate(self.closures) if place not in self.refused]

    def spreads_from(self, key: Key) -> dict[Key, Spread]:
        """How uncertain every keyframe is seen from `key`, along the surest way over steps and closures.

        Errors of the steps are added as if all of them pointed the same way; keyframes without such a way are
        left out.
        """
        edges = self._edges = self._edges or self._collected()
        settled: dict[Key, Spread] = {}
        queue: list[tuple[float, Key, Spread]] = [(0.0, key, NO_SPREAD)]
        while queue:
            _, here, spread = heapq.heappop(queue)
            if here in settled:
                continue
            settled[here] = spread
            for other, step in edges.get(here, ()):
                if other not in settled:
                    further = spread.further(step)
                    heapq.heappush(queue, (further.shift_m, other, further))
        settled.pop(_MAP, None)
        return settled

    def motion(self, start: Key, end: Key) -> Pose:
        """Pose of keyframe `end` seen from `start`, as estimated."""
        return self.poses[start].inverse().compose(self.poses[end])

    def apart_m(self, a: Key, b: Key) -> float:
        """Distance between two keyframes, as estimated."""
        return float(np.linalg.norm(self.poses[a].position - self.poses[b].position))

    def _firm(self, numbers: Mapping[Key, int]) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Anchors and steps, and where to begin."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for key, number in numbers.items():
            values.insert(number, _to_gtsam(self.poses[key]))
        for key, anchor in self.anchors.items():
            noise = _noise(anchor.covariance)
            graph.add(gtsam.PriorFactorPose3(numbers[key], _to_gtsam(anchor.pose), noise))
        for step in self.steps:
            covariance = step.covariance + self.drift.covariance(_length(step.motion))
            graph.add(_tie_of(numbers[step.start], numbers[step.end], step.motion, covariance))
        return graph, values

    def _tied(self, numbers: Mapping[Key, int], weights: FloatArray) -> gtsam.NonlinearFactorGraph:
        """The closures, each as sure as its weight allows."""
        graph = gtsam.NonlinearFactorGraph()
        for closure, weight in zip(self.closures, weights, strict=True):
            if weight > 0.0:
                ends = numbers[closure.older], numbers[closure.newer]
                graph.add(_tie_of(*ends, closure.motion, closure.covariance / weight))
        return graph

    def _misses(self, numbers: Mapping[Key, int], values: gtsam.Values) -> FloatArray:
        """(C,) by how many standard deviations every closure misses, squared."""
        full = self._tied(numbers, np.ones(len(self.closures)))
        return np.array([2.0 * full.at(place).error(values) for place in range(full.size())])

    def _spread(self, step: Step) -> Spread:
        return _spread_of(step.covariance).further(self.drift.spread(_length(step.motion)))

    def leave_out(self, places: set[int]) -> None:
        """Do not trust the closures at these places: ways through them do not count."""
        self.refused = places
        self._edges = None

    def _collected(self) -> dict[Key, list[tuple[Key, Spread]]]:
        """What ties every keyframe to others."""
        edges: dict[Key, list[tuple[Key, Spread]]] = {}
        for key, anchor in self.anchors.items():
            _tie(edges, _MAP, key, _spread_of(anchor.covariance))
        for step in self.steps:
            _tie(edges, step.start, step.end, self._spread(step))
        for closure in self.trusted():
            _tie(edges, closure.older, closure.newer, NO_SPREAD)
        return edges


def _tie(edges: dict[Key, list[tuple[Key, Spread]]], a: Key, b: Key, spread: Spread) -> None:
    edges.setdefault(a, []).append((b, spread))
    edges.setdefault(b, []).append((a, spread))


def _solved(
    firm: gtsam.NonlinearFactorGraph, tied: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> gtsam.Values:
    tied.push_back(firm)
    return gtsam.LevenbergMarquardtOptimizer(tied, values).optimize()


def _length(motion: Pose) -> float:
    return float(np.linalg.norm(motion.position))


def _spread_of(covariance: FloatArray) -> Spread:
    shift, turn = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
    return Spread(0.0, float(np.sqrt(shift)), float(np.sqrt(turn)))


def _tie_of(start: int, end: int, motion: Pose, covariance: FloatArray) -> gtsam.BetweenFactorPose3:
    return gtsam.BetweenFactorPose3(start, end, _to_gtsam(motion), _noise(covariance))


def _noise(covariance: FloatArray) -> gtsam.noiseModel.Gaussian:
    return gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(_SWAP, _SWAP)])


def _to_gtsam(pose: Pose) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.rotation), pose.position)


def _from_gtsam(pose: gtsam.Pose3) -> Pose:
    return Pose.from_matrix(pose.matrix())
