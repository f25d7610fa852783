"""Where the robots meet again: travel times to keyframes, the choice that costs both least, and its
agreement.

The choice is the paper's `kappa = argmin_q max(T_g,q, T_a,q)` over the ground robot's keyframes. Over a
lossy link no
protocol gives common knowledge, so all doubt is put on the robot that can afford it (planner.md 5.5): the
aerial
robot proposes, the ground robot acknowledges and is in doubt between the old and the new point until it
hears the
commit; the aerial robot switches on the acknowledgement alone and therefore always flies to a point that
the ground
robot will visit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.planning.local_graph import FloatArray


def choose_point(
    ground_s: FloatArray, aerial_s: FloatArray, ground_limit_s: float, aerial_limit_s: float
) -> int | None:
    """Index of the keyframe with the least `max` of both times (N,) that both can afford, if any."""
    worst = np.maximum(ground_s, aerial_s)
    allowed = (ground_s <= ground_limit_s) & (aerial_s <= aerial_limit_s) & np.isfinite(worst)
    if not allowed.any():
        return None
    return int(np.argmin(np.where(allowed, worst, np.inf)))


@dataclass
class Proposer:
    """The aerial robot's side. `point` is where it goes: always one that the ground robot acknowledged."""

    point: FloatArray
    epoch: int = 0
    pending: tuple[int, FloatArray] | None = None

    def propose(self, point: FloatArray) -> tuple[int, FloatArray] | None:
        """Start an agreement on a new point; None while one is under way or when it is the agreed one
        already."""
        if self.pending is not None or float(np.linalg.norm(point - self.point)) < 0.5:
            return None
        self.pending = (self.epoch + 1, np.asarray(point, np.float64))
        return self.pending

    def acknowledged(self, epoch: int) -> bool:
        """An ACK arrived; True if it settled the pending proposal (a COMMIT should go out)."""
        if self.pending is None or epoch != self.pending[0]:
            return False
        self.epoch, self.point = self.pending
        self.pending = None
        return True


@dataclass
class Acceptor:
    """The ground robot's side: points that the aerial robot may head for, the newest last (at most two)."""

    points: list[FloatArray]
    epochs: list[int] = field(default_factory=lambda: [0])

    @property
    def in_doubt(self) -> bool:
        return len(self.points) > 1

    def proposed(self, epoch: int, point: FloatArray, feasible: bool) -> bool:
        """A PROPOSE arrived; True if it is to be acknowledged."""
        newest = max(self.epochs)
        if epoch == newest:
            return True
        if epoch < newest or self.in_doubt or not feasible:
            return False
        self.points.append(np.asarray(point, np.float64))
        self.epochs.append(epoch)
        return True

    def committed(self, epoch: int) -> None:
        """A COMMIT arrived: every older point is void."""
        if epoch in self.epochs:
            kept = [index for index, other in enumerate(self.epochs) if other >= epoch]
            self.points = [self.points[index] for index in kept]
            self.epochs = [self.epochs[index] for index in kept]


def thinned(points: FloatArray, spacing_m: float) -> NDArray[np.int64]:
    """Indices of the newest points that are at least `spacing_m` apart, newest first."""
    chosen: list[int] = []
    for index in range(len(points) - 1, -1, -1):
        if all(np.linalg.norm(points[index] - points[other]) >= spacing_m for other in chosen):
            chosen.append(index)
    return np.array(chosen, np.int64)
