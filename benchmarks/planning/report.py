"""The planning benchmark's summary as a Markdown table."""

from __future__ import annotations

from typing import Any

from benchmarks import tables

COLUMNS = ("world", "cycles", "vertices p50", "p50 ms", "p90 ms", "p99 ms", "review p50 ms")


def document(summary: dict[str, Any]) -> str:
    """Table of all worlds with the share of each stage, and what the brute-force comparison found."""
    stages = list(summary["all"]["shares"])
    rows = [_row(name, found, stages) for name, found in summary.items() if name != "all"]
    rows.append(_row("all", summary["all"], stages))
    edges = [found["edges"] for found in summary.values() if "edges" in found]
    compared, wrong = (sum(found[key] for found in edges) for key in ("edges", "false_free"))
    same = f"{summary['all']['same_twice']} of {summary['all']['cycles']}"
    text = (
        "CPU time of one thread for a whole cycle of the aerial robot (graph, gains, refinement, tour); "
        f"review: to ask whether to go on. Planned twice from the same situation, {same} cycles gave the "
        f"same path, bit for bit. Of {compared} edges compared with a brute-force count of the voxels that "
        f"the body touches, {wrong} were taken as free and are not."
    )
    return tables.markdown((*COLUMNS, *stages), rows) + "\n\n" + text


def _row(name: str, found: dict[str, Any], stages: list[str]) -> list[str]:
    cycle = found["cycle_ms"]
    return [
        name,
        str(found["cycles"]),
        tables.number(found["vertices_p50"]),
        *(tables.number(cycle[p]) for p in ("p50", "p90", "p99")),
        tables.number(found["review_ms_p50"], 1),
        *(f"{100 * found['shares'][stage]:.0f} %" for stage in stages),
    ]
