"""Three numbers at a time, without numpy."""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vector, factor: float) -> Vector:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def norm(a: Vector) -> float:
    return math.hypot(*a)


def lerp(a: Vector, b: Vector, share: float) -> Vector:
    """From `a` (share 0) to `b` (share 1)."""
    return (a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share)


def towards(a: Vector, b: Vector, step: float) -> Vector:
    """From `a` straight to `b`, at most `step` far."""
    distance = math.dist(a, b)
    return b if distance <= step else lerp(a, b, step / distance)


def shortened(a: Vector, longest: float) -> Vector:
    """The same direction, at most this long."""
    return towards(ZERO, a, longest)


def unit(a: Vector) -> Vector:
    """The direction; of nothing it is nothing."""
    length = norm(a)
    return scale(a, 1.0 / length) if length > 1e-9 else ZERO


def clamp(value: float, low: float, high: float) -> float:
    return max(low, min(high, value))


def turn_towards(angle: float, goal: float, step: float) -> float:
    """From one heading to another the short way round, at most `step` far; in (-pi, pi]."""
    return math.remainder(angle + clamp(math.remainder(goal - angle, math.tau), -step, step), math.tau)
