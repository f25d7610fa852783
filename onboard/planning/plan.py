"""What the planner decides: paths with their terms, and goals that did not work out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.planning.local_graph import FloatArray

GIVE_UP_S = 120.0
GIVE_UP_M = 1.5
ATTEMPTS = 3


@dataclass(frozen=True, eq=False)
class Plan:
    """A path (M, 3) of reference points and why it was chosen; an empty one means nothing left to do."""

    path: FloatArray
    kind: str
    gain_m3: float = 0.0
    score: float = 0.0
    time_s: float = 0.0

    @property
    def goal(self) -> FloatArray:
        return np.asarray(self.path[-1])


NOTHING = Plan(np.zeros((0, 3)), "nothing")


@dataclass
class Refusals:
    """Goals that did not work out, with the time until which they are left alone."""

    entries: list[tuple[FloatArray, float]] = field(default_factory=list)
    attempts: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def add(self, now_s: float, point: FloatArray) -> None:
        self.entries.append((point, now_s + GIVE_UP_S))

    def attempt(self, now_s: float, point: FloatArray) -> None:
        """Count a decision for this goal; give it up when it is chosen again and again."""
        x, y, z = (int(c) for c in np.floor(point / 2.0))
        self.attempts[x, y, z] = self.attempts.get((x, y, z), 0) + 1
        if self.attempts[x, y, z] > ATTEMPTS:
            self.attempts[x, y, z] = 0
            self.add(now_s, point)

    def allowed(self, now_s: float, points: FloatArray) -> NDArray[np.bool_]:
        self.entries = [entry for entry in self.entries if entry[1] > now_s]
        result = np.ones(len(points), np.bool_)
        for point, _ in self.entries:
            result &= np.linalg.norm(points - point, axis=1) > GIVE_UP_M
        return result


def remaining_path(point: FloatArray, path: FloatArray) -> FloatArray:
    """The part of a path (M, 3) that lies ahead of the robot at `point`, starting with `point`."""
    return np.concatenate([point[None], onward(point, path)[min(1, len(path) - 1) :]])


def onward(point: FloatArray, path: FloatArray) -> FloatArray:
    """A path (M, 3) without the legs before the one that is nearest to `point`.

    A robot that keeps this of its path never takes up a leg again that it has left, which it would for ever
    where a path crosses itself.
    """
    if len(path) < 2:
        return path
    starts, legs = path[:-1], np.diff(path, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", legs, legs), 1e-12)
    along = np.clip(np.einsum("ij,ij->i", point - starts, legs) / squared, 0, 1)
    offsets = np.linalg.norm(starts + along[:, None] * legs - point, axis=1)
    return path[len(offsets) - 1 - int(np.argmin(offsets[::-1])) :]


def described(plan: Plan) -> dict[str, object]:
    """A plan as fields of an event."""
    goal = [round(float(value), 2) for value in plan.goal] if len(plan.path) else None
    return {
        "choice": plan.kind,
        "goal": goal,
        "gain_m3": round(plan.gain_m3, 2),
        "travel_s": round(plan.time_s, 1),
        "score": round(plan.score, 3),
    }
