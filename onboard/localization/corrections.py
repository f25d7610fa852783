"""What became of keyframes' poses after loops were closed, told to peers in a few hundred bytes.

A correction is a field over the sequence numbers of one robot's keyframes, relative to the poses that they
were sent with: knots with a shift and a turn, linear between them, nothing beyond the last. Every revision
says it all anew, so that only the newest counts, in whatever order and however often they come.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from onboard.core.geometry import FloatArray, Pose, quaternion_from_rotation
from onboard.localization.lie import rotation_exp, rotation_log

SHIFT_STEP_M, TURN_STEP_RAD = 0.005, 1e-4
"""What is told is rounded to multiples of these."""


@dataclass(frozen=True, slots=True)
class Knot:
    """Keyframe `sequence` moves by `shift_m` and turns by the rotation vector `turn_rad`, in map axes."""

    sequence: int
    shift_m: tuple[float, float, float]
    turn_rad: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Correction:
    """Correction `revision` of all keyframes of a robot; `knots` ascend."""

    source: int
    revision: int
    knots: tuple[Knot, ...]

    def applied(self, sequence: int, pose: Pose) -> Pose:
        """Where the keyframe that was sent with `pose` is."""
        numbers = [knot.sequence for knot in self.knots]
        after = bisect_right(numbers, sequence)
        if after == 0 or (after == len(numbers) and sequence > numbers[-1]):
            return pose
        moved = _between(self.knots[after - 1], self.knots[min(after, len(numbers) - 1)], sequence)
        turned = rotation_exp(moved[3:]) @ pose.rotation
        return Pose(pose.position + moved[:3], quaternion_from_rotation(turned))


def correction_of(
    source: int,
    revision: int,
    sent: Mapping[int, Pose],
    poses: Mapping[int, Pose],
    limit: int,
    tolerance: tuple[float, float] = (0.02, 0.002),
) -> Correction:
    """The correction that takes `sent` poses by sequence to `poses`, within the tolerance (metres, radians).

    With more than `limit` knots the tolerance is doubled until they are few enough. There is at least one
    keyframe.
    """
    numbers = sorted(sent)
    moves = np.array([_move(sent[number], poses[number]) for number in numbers]).reshape(-1, 6)
    steps = np.repeat([SHIFT_STEP_M, TURN_STEP_RAD], 3)
    rounded = np.round(moves / steps) * steps
    scale = np.repeat(tolerance, 3)
    kept = _thinned(np.array(numbers), moves / scale, rounded / scale)
    if len(kept) > limit:
        return correction_of(source, revision, sent, poses, limit, (2 * tolerance[0], 2 * tolerance[1]))
    return Correction(source, revision, tuple(_knot(numbers[place], rounded[place]) for place in kept))


def moved_far(before: Pose, after: Pose, shift_m: float, turn_rad: float) -> bool:
    """Whether a pose has moved or turned by more than this."""
    move = _move(before, after)
    return bool(np.linalg.norm(move[:3]) > shift_m or np.linalg.norm(move[3:]) > turn_rad)


@dataclass(slots=True)
class CorrectionBook:
    """The newest correction of every robot."""

    corrections: dict[int, Correction] = field(default_factory=dict)

    def take(self, correction: Correction) -> bool:
        """Whether it is news; older revisions and repetitions change nothing."""
        held = self.corrections.get(correction.source)
        if held is not None and held.revision >= correction.revision:
            return False
        self.corrections[correction.source] = correction
        return True

    def revision(self, source: int) -> int:
        """The newest revision held of a robot, 0 before the first."""
        held = self.corrections.get(source)
        return 0 if held is None else held.revision

    def pose(self, source: int, sequence: int, sent: Pose) -> Pose:
        """Where a keyframe is that was sent with this pose."""
        held = self.corrections.get(source)
        return sent if held is None else held.applied(sequence, sent)


def _move(before: Pose, after: Pose) -> FloatArray:
    """(6,) shift and rotation vector in map axes."""
    turn = rotation_log(after.rotation @ before.rotation.T)
    return np.concatenate([after.position - before.position, turn])


def _between(before: Knot, after: Knot, sequence: int) -> FloatArray:
    low = np.array(before.shift_m + before.turn_rad)
    if after.sequence == before.sequence:
        return low
    share = (sequence - before.sequence) / (after.sequence - before.sequence)
    return np.asarray(low + share * (np.array(after.shift_m + after.turn_rad) - low))


def _knot(sequence: int, move: FloatArray) -> Knot:
    x, y, z, a, b, c = (float(value) for value in move)
    return Knot(sequence, (x, y, z), (a, b, c))


def _thinned(numbers: FloatArray, moves: FloatArray, knots: FloatArray) -> list[int]:
    """Places of few knots, taken greedily, between which lines miss no move by more than 1.

    Moves before the first and after the last one that is not nothing need no knots; there is always one.
    """
    told = np.flatnonzero(np.abs(moves).max(axis=1, initial=0.0) > 1.0)
    if not len(told):
        return [0]
    first, end = int(told[0]), int(told[-1])
    kept = [first]
    while kept[-1] < end:
        kept.append(_farthest(numbers, moves, knots, kept[-1], end))
    return kept


def _farthest(numbers: FloatArray, moves: FloatArray, knots: FloatArray, start: int, end: int) -> int:
    """The last place up to which a straight line from `start` on misses nothing."""
    best = start + 1
    for place in range(start + 2, end + 1):
        inner = np.arange(start + 1, place)
        share = (numbers[inner] - numbers[start]) / (numbers[place] - numbers[start])
        line = knots[start] + share[:, None] * (knots[place] - knots[start])
        if np.abs(line - moves[inner]).max() > 1.0:
            break
        best = place
    return best
