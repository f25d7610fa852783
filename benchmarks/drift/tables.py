"""The table of drift for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.drift.measure import Outcome
from benchmarks.drift.tracks import Plan

_HEAD = [
    "| mission | runs | way | odometry: end | odometry: worst | closed: end | closed: robot's own "
    "| closed: worst | ATE before / after | loops closed | wrong | CPU a key scan: loops + maps "
    "| longest step |",
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
]


def table(outcomes: Sequence[Outcome], ratios: Mapping[str, float]) -> str:
    """A row for every mission, errors being those of its worst run; metres and milliseconds."""
    plans = dict.fromkeys(outcome.plan for outcome in outcomes)
    rows = [_row(plan, [o for o in outcomes if o.plan == plan], ratios) for plan in plans]
    return "\n".join([*_HEAD, *rows, "", _summary(outcomes)])


def _row(plan: Plan, runs: list[Outcome], ratios: Mapping[str, float]) -> str:
    ratio = f"{100 * ratios[plan.sensor]:g} %"
    cells = [
        f"{plan.world} {plan.robot}, {plan.sensor} ({ratio})",
        str(len(runs)),
        f"{runs[0].length_m:.0f} m",
        f"{max(run.odometry_final_m for run in runs):.2f}",
        f"{max(run.odometry_worst_m for run in runs):.2f}",
        f"**{max(run.final_m for run in runs):.2f}**",
        f"{max(run.used_final_m for run in runs):.2f}",
        f"{max(run.worst_m for run in runs):.2f}",
        f"{max(run.odometry_ate_m for run in runs):.2f} / {max(run.ate_m for run in runs):.2f}",
        f"{min(run.closed for run in runs)}",
        f"{sum(run.wrong_closed for run in runs)}",
        f"{max(run.closing_ms for run in runs):.0f} + {max(run.drawing_ms for run in runs):.0f} ms",
        f"{max(run.step_ms.max() for run in runs):.0f} ms",
    ]
    return f"| {' | '.join(cells)} |"


def _summary(outcomes: Sequence[Outcome]) -> str:
    ends = np.array([outcome.final_m for outcome in outcomes])
    steps = np.concatenate([outcome.step_ms for outcome in outcomes])
    scans = sum(outcome.keyframes for outcome in outcomes)
    stored = sum(outcome.stored_bytes for outcome in outcomes) / scans / 1e3
    graph = sum(outcome.graph_bytes for outcome in outcomes) / scans
    closing = sum(outcome.closing_ms * outcome.keyframes for outcome in outcomes) / scans
    drawing = sum(outcome.drawing_ms * outcome.keyframes for outcome in outcomes) / scans
    return (
        f"{len(outcomes)} missions: error at the end at most {ends.max():.2f} m "
        f"(median {np.median(ends):.2f} m); "
        f"{sum(o.closed for o in outcomes)} loops closed, {sum(o.wrong_closed for o in outcomes)} wrong "
        f"({sum(o.wrong_found for o in outcomes)} wrong ones found and refused). CPU a key scan: "
        f"{closing:.0f} ms for loops, {drawing:.0f} ms for maps; steps: 99.9 % within "
        f"{np.percentile(steps, 99.9):.0f} ms, the longest {steps.max():.0f} ms. "
        f"Memory: {stored:.1f} kB of scan and {graph:.0f} bytes of graph a key scan."
    )
