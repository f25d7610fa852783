"""Why a co-localisation is refused, as a number and in words."""

from __future__ import annotations

from enum import IntEnum


class Reason(IntEnum):
    """What came of a co-localisation; the number is its code on the air."""

    ACCEPTED = 0
    NO_CLOUD = 1
    FEW_POINTS = 2
    NO_FIT = 3
    OUTSIDE = 4
    DEGENERATE = 5
    AMBIGUOUS = 6
    UNCERTAIN = 7
    DISAGREE = 8
    LATE = 9


_WORDS = {
    Reason.ACCEPTED: "both scans agree",
    Reason.NO_CLOUD: "the other robot's cloud has too few points",
    Reason.FEW_POINTS: "the scan has too few points",
    Reason.NO_FIT: "the scan fits the cloud nowhere",
    Reason.OUTSIDE: "the scan fits only where the bracket cannot have been",
    Reason.DEGENERATE: "the surroundings hold the pose in too few directions",
    Reason.AMBIGUOUS: "the scan fits in more than one place",
    Reason.UNCERTAIN: "the pose is not precise enough",
    Reason.DISAGREE: "two scans say different things",
    Reason.LATE: "the second scan came too late",
}


def words_of(code: int) -> str:
    """A reason in words; codes that are not known are named as such."""
    return _WORDS[Reason(code)] if code in _WORDS else f"unknown reason {code}"
