"""What one planning cycle considered and why it chose as it did, for logs and `marsupial explain`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from onboard.planning.plan import NOTHING, Plan

CHOSEN = "chosen"
LOWER = "lower score"
TOO_LATE = "no time to be back"
COLLIDES = "collides"


@dataclass
class Candidate:
    """A plan that was considered, with the terms of its score, and CHOSEN or why it was not."""

    plan: Plan
    verdict: str = LOWER
    terms: dict[str, float] = field(default_factory=dict)

    def described(self) -> dict[str, Any]:
        """Plain data: kind, goal (m), gain (m^3), travel time (s), score, further terms, verdict."""
        plan = self.plan
        return {
            "kind": plan.kind,
            "goal": [round(float(value), 2) for value in plan.goal] if len(plan.path) else None,
            "gain_m3": round(plan.gain_m3, 2),
            "travel_s": round(plan.time_s, 1),
            "score": round(plan.score, 3),
            **{name: round(value, 3) for name, value in self.terms.items()},
            "verdict": self.verdict,
        }


@dataclass
class Cycle:
    """One planning cycle: where it started, how much it looked at, what it weighed, what it chose."""

    number: int = 0
    reason: str = ""
    counts: dict[str, int] = field(default_factory=dict)
    stages_ms: dict[str, float] = field(default_factory=dict)
    candidates: list[Candidate] = field(default_factory=list)
    choice: Plan = NOTHING
    blocking: list[list[float]] = field(default_factory=list)
    """Centres in metres of the voxels around a robot that cannot start."""
    left: dict[str, float] = field(default_factory=dict)
    """When nothing was chosen: volume in m^3 that frontiers promise, by why none of them is gone to."""

    def described(self) -> dict[str, Any]:
        """Plain data for the event log."""
        return {
            "cycle": self.number,
            "reason": self.reason,
            "counts": dict(self.counts),
            "stages_ms": {name: round(value, 2) for name, value in self.stages_ms.items()},
            "candidates": [candidate.described() for candidate in self.candidates],
            **({"blocking": self.blocking} if self.blocking else {}),
            **({"left": self.left} if self.left else {}),
        }
