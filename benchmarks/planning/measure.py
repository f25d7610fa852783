"""Time one planning cycle and its stages; the same situation twice must give the same path."""

from __future__ import annotations

import copy
import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.planning.recording import Situation, path_bytes
from onboard.planning import aerial_graph

Row = dict[str, Any]
STAGES = ("air space", "sampling", "edges", "paths and refinement", "gains", "views", "tour", "global graph")


@contextmanager
def timed_parts(owner_names: list[tuple[Any, str, str]], stages: dict[str, float]) -> Iterator[None]:
    """While inside, the named functions of these owners add their CPU time in ms to their stages.

    What a named function spends in another named one counts there only.
    """
    inside = [0.0]

    def timing(inner: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def outer(*args: Any, **named: Any) -> Any:
            inside.append(0.0)
            before = time.process_time()
            try:
                return inner(*args, **named)
            finally:
                spent_ms = (time.process_time() - before) * 1e3
                stages[stage] = stages.get(stage, 0.0) + spent_ms - inside.pop()
                inside[-1] += spent_ms

        return outer

    kept = [(owner, name, getattr(owner, name)) for owner, name, _ in owner_names]
    for (owner, name, inner), (_, _, stage) in zip(kept, owner_names, strict=True):
        setattr(owner, name, timing(inner, stage))
    try:
        yield
    finally:
        for owner, name, inner in kept:
            setattr(owner, name, inner)


def cycle(situation: Situation) -> tuple[Row, str]:
    """CPU milliseconds of one cycle, whole and by stage, on a copy of the situation; and its path's hash."""
    explorer = copy.deepcopy(situation.explorer)
    stages: dict[str, float] = {}
    parts = [
        (aerial_graph, "air_space", "air space"),
        (aerial_graph, "spread", "sampling"),
        (aerial_graph, "_edges", "edges"),
        (aerial_graph.AerialGraph, "path", "paths and refinement"),
        (explorer.body, "gains", "gains"),
        (explorer, "_views", "views"),
        (explorer.prospects, "tour", "tour"),
        (explorer, "_catch_up", "global graph"),
    ]
    with timed_parts(parts, stages):
        before = time.process_time()
        plan = explorer.explore(situation.now_s, situation.point, situation.current)
        whole_ms = (time.process_time() - before) * 1e3
    explorer.cycle.stages_ms = stages
    vertices = 0 if explorer.local is None else len(explorer.local.points)
    row: Row = {"world": situation.world, "time_s": situation.now_s, "vertices": vertices}
    row |= {"cycle_ms": whole_ms, **{stage: stages.get(stage, 0.0) for stage in STAGES}}
    return row, hashlib.sha256(path_bytes(plan)).hexdigest()


def review_ms(situation: Situation) -> float | None:
    """CPU milliseconds of asking whether to go on with the plan under way; None where there is none."""
    if situation.current is None or situation.explorer.local is None:
        return None
    explorer = copy.deepcopy(situation.explorer)
    before = time.process_time()
    explorer.review(situation.now_s, situation.point, situation.current)
    return (time.process_time() - before) * 1e3


def measure(situations: list[Situation]) -> list[Row]:
    """One row for each situation; the first cycle is run once before, for compilation."""
    rows = []
    for index, situation in enumerate(situations):
        if index == 0:
            cycle(situation)
        row, first = cycle(situation)
        row["same_twice"] = cycle(situation)[1] == first
        row["path_sha256"] = first
        row["review_ms"] = review_ms(situation)
        rows.append(row)
    return rows


def summary(rows: list[Row]) -> Row:
    """Percentiles of cycle and review, the stages' shares, and how many cycles were the same twice."""
    cycles = np.array([row["cycle_ms"] for row in rows])
    reviews = [row["review_ms"] for row in rows if row["review_ms"] is not None]
    shares = {stage: float(sum(row[stage] for row in rows) / cycles.sum()) for stage in STAGES}
    return {
        "cycles": len(rows),
        "vertices_p50": float(np.median([row["vertices"] for row in rows])),
        "cycle_ms": {f"p{p}": round(float(np.percentile(cycles, p)), 1) for p in (50, 90, 99)},
        "review_ms_p50": round(float(np.median(reviews)), 2) if reviews else None,
        "shares": {stage: round(share, 3) for stage, share in shares.items()}
        | {"rest": round(1 - sum(shares.values()), 3)},
        "same_twice": sum(bool(row["same_twice"]) for row in rows),
    }
