"""In which order to visit what is left: an orienteering problem with a deadline and a place to end at.

Maximises `sum_c V_c exp(-t_c / tau)` over ordered subsets of at most MAX_STOPS stops, t_c the arrival time,
which counts the ways and what was spent looking around at the stops before (orienteering; reviewed by
Gunawan, Lau and Vansteenwegen, 2016). Solved by dynamic programming over subsets, as Held and Karp (1962) did
for the travelling salesman. Value and time conflict, so a state keeps several labels, none worse than another
in both; where there are more than LABELS, the one that adds least value over the next earlier one goes. A
label is not followed where all other stops, each reached from its nearest one at once, could not make it the
best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.planning.local_graph import FloatArray

MAX_STOPS = 12
LABELS = 4
TAU_S = 120.0


@dataclass(frozen=True)
class Tour:
    """Stops in the order of the visit, and the discounted volume in m^3 that they are worth together."""

    order: tuple[int, ...] = ()
    value_m3: float = 0.0


@dataclass(frozen=True, eq=False)
class Stops:
    """What a tour may visit: (n,) volumes in m^3, and in seconds the ways from the robot (n,), between stops
    (n, n) and back to where the tour must end (n,), and the time (n,) to look around at each."""

    volumes_m3: FloatArray
    first_s: FloatArray
    between_s: FloatArray
    back_s: FloatArray
    stay_s: FloatArray

    def only(self, chosen: NDArray[np.int64]) -> Stops:
        """The stops with these numbers (m,)."""
        return Stops(
            self.volumes_m3[chosen],
            self.first_s[chosen],
            self.between_s[np.ix_(chosen, chosen)],
            self.back_s[chosen],
            self.stay_s[chosen],
        )


def best_tour(stops: Stops, latest_s: FloatArray, tau_s: float = TAU_S) -> Tour:
    """The best order of a subset of the stops; stop c must be reached by `latest_s[c]` (n,).

    Only the MAX_STOPS best ones by `V exp(-t / tau) / (t + stay)` are looked at, t the time to get there.
    """
    reachable = np.flatnonzero((stops.first_s <= latest_s) & (stops.volumes_m3 > 0))
    if len(reachable) == 0:
        return Tour()
    alone = stops.volumes_m3 * np.exp(-stops.first_s / tau_s) / (stops.first_s + stops.stay_s + 1.0)
    chosen = np.sort(reachable[np.argsort(-alone[reachable], kind="stable")[:MAX_STOPS]])
    few = stops.only(chosen)
    order, value = _search(
        few.volumes_m3, few.first_s, few.between_s, few.stay_s, latest_s[chosen], float(tau_s)
    )
    return Tour(tuple(int(chosen[i]) for i in order), float(value))


@njit(cache=True, nogil=True, error_model="numpy")
def _search(
    volumes: FloatArray,
    first: FloatArray,
    between: FloatArray,
    stay: FloatArray,
    latest: FloatArray,
    tau: float,
) -> tuple[NDArray[np.int64], float]:
    """Order of the best tour and its value.

    Label arrays are (subset, last stop, label): time when the last stop is left, its value, its discount
    exp(-time / tau), and the label it came from as previous stop * LABELS + label (-1: from the robot).
    """
    n = volumes.size
    subsets = 1 << n
    count = np.zeros((subsets, n), np.int64)
    left_at = np.empty((subsets, n, LABELS))
    value = np.empty((subsets, n, LABELS))
    discount = np.empty((subsets, n, LABELS))
    origin = np.empty((subsets, n, LABELS), np.int64)
    hop = np.exp(-between / tau)
    dwell = np.exp(-stay / tau)
    at_best = np.empty(n)
    for c in range(n):
        nearest = 0.0
        for other in range(n):
            if other != c:
                nearest = max(nearest, hop[other, c])
        at_best[c] = volumes[c] * nearest
    best_value, best_subset, best_last, best_label = 0.0, 0, 0, 0
    for c in range(n):
        if first[c] <= latest[c]:
            weight = np.exp(-first[c] / tau)
            state = 1 << c
            left_at[state, c, 0] = first[c] + stay[c]
            value[state, c, 0] = volumes[c] * weight
            discount[state, c, 0] = weight * dwell[c]
            origin[state, c, 0] = -1
            count[state, c] = 1
    for subset in range(1, subsets):
        open_value = 0.0
        for c in range(n):
            if not subset >> c & 1:
                open_value += at_best[c]
        for last in range(n):
            for label in range(count[subset, last]):
                if value[subset, last, label] > best_value:
                    best_value = value[subset, last, label]
                    best_subset, best_last, best_label = subset, last, label
                if value[subset, last, label] + discount[subset, last, label] * open_value <= best_value:
                    continue
                for following in range(n):
                    if subset >> following & 1:
                        continue
                    arrival = left_at[subset, last, label] + between[last, following]
                    if arrival > latest[following]:
                        continue
                    weight = discount[subset, last, label] * hop[last, following]
                    _insert(
                        count,
                        left_at,
                        value,
                        discount,
                        origin,
                        subset | 1 << following,
                        following,
                        arrival + stay[following],
                        value[subset, last, label] + volumes[following] * weight,
                        weight * dwell[following],
                        last * LABELS + label,
                    )
    return _unrolled(origin, best_subset, best_last, best_label, best_value), best_value


@njit(cache=True, nogil=True, error_model="numpy")
def _insert(
    count: NDArray[np.int64],
    left_at: FloatArray,
    value: FloatArray,
    discount: FloatArray,
    origin: NDArray[np.int64],
    subset: int,
    stop: int,
    new_left_at: float,
    new_value: float,
    new_discount: float,
    new_origin: int,
) -> None:
    """Add a label to a state unless another one is at least as good in both time and value."""
    times, values = left_at[subset, stop], value[subset, stop]
    discounts, origins = discount[subset, stop], origin[subset, stop]
    held = count[subset, stop]
    kept = 0
    for i in range(held):
        if times[i] <= new_left_at and values[i] >= new_value:
            return
    for i in range(held):
        if times[i] < new_left_at or values[i] > new_value:
            times[kept], values[kept] = times[i], values[i]
            discounts[kept], origins[kept] = discounts[i], origins[i]
            kept += 1
    place = kept
    if kept == LABELS:
        # drop what adds least value over the next earlier label; the earliest one stays
        place, least = -1, np.inf
        for i in range(kept):
            below = -np.inf
            for j in range(kept):
                if times[j] < times[i] and values[j] > below:
                    below = values[j]
            if new_left_at < times[i] and new_value > below:
                below = new_value
            if values[i] - below < least:
                place, least = i, values[i] - below
        below = -np.inf
        for j in range(kept):
            if times[j] < new_left_at and values[j] > below:
                below = values[j]
        if new_value - below < least:
            return
        kept -= 1
    times[place], values[place] = new_left_at, new_value
    discounts[place], origins[place] = new_discount, new_origin
    count[subset, stop] = kept + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _unrolled(
    origin: NDArray[np.int64], subset: int, last: int, label: int, best_value: float
) -> NDArray[np.int64]:
    """The stops on the way to a label, first one first."""
    order = np.empty(origin.shape[1], np.int64)
    length = 0
    while best_value > 0.0:
        order[length] = last
        length += 1
        before = origin[subset, last, label]
        if before < 0:
            break
        subset ^= 1 << last
        last, label = before // LABELS, before % LABELS
    return order[:length][::-1].copy()
