"""Facts under which a release is allowed, and every way to violate one of them."""

from __future__ import annotations

import math
from typing import Any

from onboard.mission import Phase
from onboard.safety_facts import ReleaseFacts, Token

NOW = 0.0
"""So that the ages below are exact."""
NAN, INF = math.nan, math.inf
RAD = math.radians(1.0)
Violation = tuple[str, dict[str, Any]]


def stale(field: str, limit_s: float, reason: str) -> list[Violation]:
    """No stamp, one at and past the limit, from the future, and none that is a number."""
    bad = (None, -limit_s, -limit_s - 0.01, -1e9, 0.001, NAN, INF, -INF)
    return [(reason, {field: value}) for value in bad]


def refused(field: str, values: tuple[Any, ...], reason: str) -> list[Violation]:
    return [(reason, {field: value}) for value in values]


def unlike(phase: Phase) -> tuple[Phase | None, ...]:
    return (None, *(other for other in Phase if other != phase))


RELEASE = ReleaseFacts(
    now_s=NOW,
    robot=2,
    token=Token("trigger", 2, NOW - 1.0),
    phase=Phase.DEPLOYING,
    still_since_s=NOW - 5.0,
    base_stamp_s=NOW - 0.1,
    tilt_rad=2.0 * RAD,
    aerial_ready=True,
    aerial_stamp_s=NOW - 1.0,
    colocalised=True,
    bracket="LOCKED",
    bracket_stamp_s=NOW - 0.1,
)
TOKENS = (
    None,
    Token("trigger", 2, NOW - 2.0),
    Token("trigger", 2, NOW + 0.1),
    Token("operator", 2, NAN),
    Token("trigger", 3, NOW),
    Token("planner", 2, NOW),
    Token("", 2, NOW),
)
RELEASE_VIOLATIONS = [
    *refused("phase", unlike(Phase.DEPLOYING), "phase is not DEPLOYING"),
    *refused("token", TOKENS, "no fresh token for this robot"),
    *refused("robot", (None, 1, 0), "no fresh token for this robot"),
    *stale("base_stamp_s", 0.3, "stale odometry of the base"),
    *refused("still_since_s", (None, -1.999, -0.0, 5.0, NAN, INF, -INF), "base is not still"),
    *refused("tilt_rad", (None, 5 * RAD, -5 * RAD, 6 * RAD, -1.5, NAN, INF, -INF), "base is tilted"),
    *refused("aerial_ready", (None, False, 1, "yes"), "aerial robot is not ready"),
    *stale("aerial_stamp_s", 2.0, "no word of the aerial robot"),
    *refused("colocalised", (None, False, 1), "co-localisation is not accepted"),
    *stale("bracket_stamp_s", 0.5, "bracket is silent"),
    *refused(
        "bracket",
        (None, "RELEASING", "RELEASED", "FAULT", "NONE", "locked", ""),
        "bracket is neither locked nor armed",
    ),
]
