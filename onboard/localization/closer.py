"""Keyframes in, estimated poses out: looks for loops, closes those that agree, optimises the graph."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.consistency import ConsistencySettings, Found, Relations, Tracks
from onboard.localization.loops import (
    Candidate,
    LoopSettings,
    Refusals,
    ScanOf,
    propose,
    submap_of,
    verifying,
)
from onboard.localization.pose_graph import Anchor, DriftModel, Key, PoseGraph, Step
from onboard.localization.registration import RegistrationSettings
from onboard.localization.submaps import Submap, SubmapSettings

_SURE = np.diag([1e-3**2] * 3 + [1e-4**2] * 3)


@dataclass(frozen=True, slots=True)
class CloserSettings:
    """Tuning; the drift model belongs to the sensor."""

    drift: DriftModel = field(default_factory=DriftModel)
    loops: LoopSettings = field(default_factory=LoopSettings)
    submaps: SubmapSettings = field(default_factory=SubmapSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    consistency: ConsistencySettings = field(default_factory=ConsistencySettings)
    submaps_held: int = 6
    waiting: int = 30
    """Keyframes that wait to be looked at; the oldest are given up."""


class LoopCloser:
    """One robot's pose graph and its closures. No clock, no I/O."""

    def __init__(self, robot: int, scan_of: ScanOf, settings: CloserSettings | None = None) -> None:
        """`scan_of` finds the kept scan of a keyframe."""
        self.settings = settings or CloserSettings()
        self.graph = PoseGraph(self.settings.drift)
        self.relations = Relations(self.settings.drift, self.settings.consistency)
        self.tracks = Tracks()
        self.reasons: Counter[str] = Counter()
        """What came of the candidates looked at."""
        self._robot = robot
        self._scan_of = scan_of
        self._keys: deque[Key] = deque(maxlen=self.settings.waiting)
        self._candidates: deque[Candidate] = deque()
        self._refusals = Refusals()
        self._submaps: dict[Key, Submap | None] = {}
        self._stale = False
        self._moved = False
        """A peer has said its poses anew."""
        self.changes = 0
        """How often the estimates have changed."""
        self._pieces = self._work()

    @property
    def found(self) -> list[Found]:
        """Verified closures, also those that do not agree with the others or wait for one that does."""
        return self.relations.found

    def begin(self, key: Key, pose: Pose, covariance: FloatArray = _SURE) -> None:
        """First keyframe of the own track, at a pose that is known so well."""
        self.graph.anchor(key, Anchor(pose, covariance))
        self.tracks.go_on(None, key, pose)

    def go_on(self, step: Step) -> None:
        """The next own keyframe; loops through it are looked for when there is time."""
        self.graph.add_step(step)
        self.tracks.go_on(step.start, step.end, step.motion)
        self._keys.append(step.end)

    def put(self, key: Key, pose: Pose, covariance: FloatArray) -> None:
        """A peer's keyframe, or where it is anew."""
        known = key in self.graph.poses
        self.graph.anchor(key, Anchor(pose, covariance))
        self.tracks.put(key, pose)
        if known:
            self._moved = True
        else:
            self._keys.append(key)

    def restore(self, graph: PoseGraph, found: Sequence[Found]) -> None:
        """Go on, right after the beginning, with a graph and what had been found in it."""
        self.graph = graph
        for key, anchor in graph.anchors.items():
            self.tracks.put(key, anchor.pose)
        for step in graph.steps:
            self.tracks.go_on(step.start, step.end, step.motion)
        for entry in found:
            self.relations.add(entry, self.tracks)
        refused = graph.refused
        chosen = [entry.closure for entry in self._agreeing()]
        self._stale = len(chosen) != len(graph.closures)
        graph.close(chosen)
        graph.leave_out(set() if self._stale else refused)

    @property
    def busy(self) -> bool:
        """Whether something waits to be begun."""
        return self._stale or self._moved or bool(self._candidates) or bool(self._keys)

    def work(self) -> bool:
        """Do one piece: some tens of milliseconds of optimising, of looking at a candidate, or of proposing.

        Whether there was anything to do.
        """
        return next(self._pieces)

    def _work(self) -> Iterator[bool]:
        """All there ever is to do, in pieces; False when there is nothing."""
        while True:
            if not self.busy:
                yield False
                continue
            for _ in self._next():
                yield True
            yield True

    def _next(self) -> Iterator[None]:
        if self._moved:
            self._moved = False
            yield from self.relations.anew(self.tracks)
            self._choose()
            self._stale = bool(self.graph.closures)
        elif self._stale:
            self._stale = False
            yield from self.graph.optimising()
            self._submaps.clear()
            self._refusals.clear()
            self.changes += 1
        elif self._candidates:
            yield from self._examined(self._candidates.popleft())
        else:
            options = propose(self.graph, self._keys.popleft(), self._robot, self.settings.loops)
            self._candidates.extend(c for c in options if not self._refusals.cover(c))

    def _examined(self, candidate: Candidate) -> Iterator[None]:
        older, newer = self._submap(candidate.older), self._submap(candidate.newer)
        if older is None or newer is None:
            return
        yield
        verified = yield from verifying(self.graph, candidate, older, newer, self.settings.registration)
        self.reasons[verified.registration.reason.value] += 1
        if verified.found is None:
            self._refusals.note(candidate)
            return
        yield
        self.relations.add(verified.found, self.tracks)
        yield
        self._choose()

    def _choose(self) -> None:
        """Close the loops that agree, if those are others than before."""
        chosen = [entry.closure for entry in self._agreeing()]
        if [id(closure) for closure in chosen] != [id(closure) for closure in self.graph.closures]:
            self.graph.close(chosen)
            self._candidates.clear()
            self._stale = True

    def _agreeing(self) -> list[Found]:
        return [self.found[place] for place in self.relations.consistent()]

    def _submap(self, key: Key) -> Submap | None:
        """Submaps change with the poses: they are held until the next optimisation."""
        if key not in self._submaps:
            while len(self._submaps) >= self.settings.submaps_held:
                self._submaps.pop(next(iter(self._submaps)))
            self._submaps[key] = submap_of(self.graph, key, self._scan_of, self.settings.submaps)
        return self._submaps[key]
