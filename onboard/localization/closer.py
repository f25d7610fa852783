"""Keyframes in, estimated poses out: looks for loops, closes those that agree, optimises the graph."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.consistency import ConsistencySettings, Found, Tracks, consistent
from onboard.localization.loops import (
    Candidate,
    LoopSettings,
    ScanOf,
    propose,
    submap_of,
    verify,
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


class LoopCloser:
    """One robot's pose graph and its closures. No clock, no I/O."""

    def __init__(self, scan_of: ScanOf, settings: CloserSettings | None = None) -> None:
        """`scan_of` finds the kept scan of a keyframe."""
        self.settings = settings or CloserSettings()
        self.graph = PoseGraph(self.settings.drift)
        self.found: list[Found] = []
        """Verified closures, also those that do not agree with the others or wait for one that does."""
        self.reasons: Counter[str] = Counter()
        """What came of the candidates looked at."""
        self._scan_of = scan_of
        self._tracks = Tracks()
        self._keys: deque[Key] = deque()
        self._candidates: deque[Candidate] = deque()
        self._submaps: dict[Key, Submap | None] = {}
        self._stale = False

    def begin(self, key: Key, pose: Pose, covariance: FloatArray = _SURE) -> None:
        """First keyframe of the own track, at a pose that is known so well."""
        self.graph.anchor(key, Anchor(pose, covariance))
        self._tracks.go_on(None, key, pose)

    def go_on(self, step: Step) -> None:
        """The next own keyframe; loops through it are looked for when there is time."""
        self.graph.add_step(step)
        self._tracks.go_on(step.start, step.end, step.motion)
        self._keys.append(step.end)

    def put(self, key: Key, pose: Pose, covariance: FloatArray, along_m: float) -> None:
        """A peer's keyframe, or where it is anew, so far along that robot's way."""
        self.graph.anchor(key, Anchor(pose, covariance))
        self._tracks.put(key, along_m, pose)
        self._submaps.clear()
        self._stale = bool(self.graph.closures)

    @property
    def busy(self) -> bool:
        """Whether there is something to do."""
        return self._stale or bool(self._candidates) or bool(self._keys)

    def work(self) -> bool:
        """Do one thing: optimise, look at one candidate, or propose. Whether estimates have changed."""
        if self._stale:
            self.graph.optimise()
            self._submaps.clear()
            self._stale = False
            return True
        if self._candidates:
            self._examine(self._candidates.popleft())
        elif self._keys:
            self._candidates.extend(propose(self.graph, self._keys.popleft(), self.settings.loops))
        return False

    def _examine(self, candidate: Candidate) -> None:
        older, newer = self._submap(candidate.older), self._submap(candidate.newer)
        if older is None or newer is None:
            return
        verified = verify(self.graph, candidate, older, newer, self.settings.registration)
        self.reasons[verified.registration.reason.value] += 1
        if verified.found is not None:
            self.found.append(verified.found)
            self._choose()

    def _choose(self) -> None:
        """Close the loops that agree, if those are others than before."""
        drift, settings = self.settings.drift, self.settings.consistency
        places = consistent(self.found, self._tracks, drift, settings)
        chosen = [self.found[place].closure for place in places]
        if [id(closure) for closure in chosen] != [id(closure) for closure in self.graph.closures]:
            self.graph.close(chosen)
            self._candidates.clear()
            self._stale = True

    def _submap(self, key: Key) -> Submap | None:
        """Submaps change with the poses: they are held until the next optimisation."""
        if key not in self._submaps:
            while len(self._submaps) >= self.settings.submaps_held:
                self._submaps.pop(next(iter(self._submaps)))
            self._submaps[key] = submap_of(self.graph, key, self._scan_of, self.settings.submaps)
        return self._submaps[key]
