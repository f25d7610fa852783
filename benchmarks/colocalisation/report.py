"""Results of many cases as Markdown tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.tables import markdown

GOOD_M, GOOD_DEG = 0.05, 0.5
WRONG_M, WRONG_DEG = 0.1, 1.0
Result = dict[str, Any]
Error = list[float]


def good(error: Error | None) -> bool:
    """Within 5 cm and half a degree."""
    return error is not None and error[0] <= GOOD_M and error[1] <= GOOD_DEG


def wrong(error: Error | None) -> bool:
    """Farther off than 10 cm or a degree, which is what two scans may differ by."""
    return error is not None and (error[0] > WRONG_M or error[1] > WRONG_DEG)


def section(results: Sequence[Result]) -> str:
    """All tables."""
    ordinary = [result for result in results if not result["self_similar"]]
    similar = [result for result in results if result["self_similar"]]
    parts = [_acceptance("places", ordinary), _acceptance("self-similar", similar)]
    columns = (
        "cases",
        "number",
        "accepted",
        "within 0.05 m, 0.5 deg",
        "wrong",
        "error m median / p95 / max",
        "error deg median / p95 / max",
        "refused",
    )
    tables = [
        markdown(columns, [*parts, *_by_world(ordinary)]),
        _strangers(ordinary),
        _honesty(ordinary),
        _costs(results),
        _others("From the bracket's guess, first scan", ordinary, "peers"),
        _others("The last step alone, from 0.2 m and 3 deg beside the truth", ordinary, "methods"),
    ]
    return "\n\n".join(tables)


def _by_world(results: Sequence[Result]) -> list[list[str]]:
    kinds = dict.fromkeys(result["world"].split("-")[0] for result in results)
    return [
        _acceptance(kind, [result for result in results if result["world"].split("-")[0] == kind])
        for kind in kinds
    ]


def _acceptance(name: str, results: Sequence[Result]) -> list[str]:
    """One row of the first table."""
    accepted = [result["ours"]["error"] for result in results if result["ours"]["error"] is not None]
    refused = Counter(result["ours"]["reason"] for result in results if result["ours"]["error"] is None)
    return [
        name,
        str(len(results)),
        _share(len(accepted), len(results)),
        _share(sum(map(good, accepted)), len(accepted)),
        str(sum(map(wrong, accepted))),
        _spread([error[0] for error in accepted], 4),
        _spread([error[1] for error in accepted], 3),
        ", ".join(f"{reason.lower()} {count}" for reason, count in refused.most_common()) or "-",
    ]


def _strangers(results: Sequence[Result]) -> str:
    """Scans of other places: none of them may be believed to be here."""
    found = [result["stranger"] for result in results if "stranger" in result]
    accepted = [entry["error"] for entry in found if entry["reason"] == "ACCEPTED"]
    refused = Counter(entry["reason"].lower() for entry in found if entry["reason"] != "ACCEPTED")
    reasons = ", ".join(f"{reason} {count}" for reason, count in refused.most_common())
    return (
        f"{len(found)} scans of another place in the same world, one scan each: {len(accepted)} accepted, "
        f"{sum(map(wrong, accepted))} of them wrong; refused: {reasons or '-'}."
    )


def _honesty(results: Sequence[Result]) -> str:
    """Errors in units of the covariance: for six numbers 6 on average if it is exact, less if careful."""
    estimates = [e for result in results for e in result["ours"]["estimates"] if e["reason"] == "ACCEPTED"]
    nees = [estimate["nees"] for estimate in estimates]
    if not nees:
        return "No estimate was accepted."
    return (
        f"Squared error over covariance (6 numbers; exact: mean 6, 95 % below 12.6), {len(nees)} accepted "
        f"scans: mean {np.mean(nees):.1f}, 95 % below {np.percentile(nees, 95):.1f}. Standard deviation in "
        f"the worst direction, median: {1e3 * np.median([e['std_m'] for e in estimates]):.1f} mm, "
        f"{np.degrees(np.median([e['std_rad'] for e in estimates])):.3f} deg."
    )


def _costs(results: Sequence[Result]) -> str:
    def row(name: str, value: Callable[[Result], float], digits: int) -> list[str]:
        return [name, _spread([value(result) for result in results], digits)]

    rows = [
        row("merge and pack the cloud (carrier), ms", lambda r: r["merge_ms"], 0),
        row("prepare the cloud, ms", lambda r: r["ours"]["prepare_ms"], 0),
        row("first scan, ms", lambda r: r["ours"]["scan_ms"][0], 0),
        row("whole try on the aerial robot, ms", _try_ms, 0),
        row("points of the cloud", lambda r: r["points"], 0),
        row("bytes sent", lambda r: r["bytes"], 0),
    ]
    return markdown(("cost (CPU time, one thread)", "median / p95 / max"), rows)


def _try_ms(result: Result) -> float:
    return float(result["ours"]["prepare_ms"] + sum(result["ours"]["scan_ms"]))


def _others(title: str, results: Sequence[Result], key: str) -> str:
    """Other ways on the same cases; they say of themselves only whether they converged."""
    names = dict.fromkeys(name for result in results for name in result.get(key, ()))
    rows = [_other_row(name, [result[key][name] for result in results if key in result]) for name in names]
    columns = (
        title,
        "converged",
        "within 0.05 m, 0.5 deg",
        "converged and wrong",
        "error m median / p95 / max",
        "error deg median / p95 / max",
        "ms median / p95 / max",
    )
    return markdown(columns, rows)


def _other_row(name: str, found: Sequence[Result]) -> list[str]:
    errors = [entry["error"] for entry in found if entry["error"] is not None]
    return [
        name,
        _share(len(errors), len(found)),
        _share(sum(map(good, errors)), len(found)),
        str(sum(map(wrong, errors))),
        _spread([error[0] for error in errors], 4),
        _spread([error[1] for error in errors], 3),
        _spread([entry["ms"] for entry in found], 0),
    ]


def _share(part: int, whole: int) -> str:
    return f"{part} ({100 * part / whole:.1f} %)" if whole else "-"


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return "-"
    low, high, top = np.percentile(values, (50, 95, 100))
    return f"{low:.{digits}f} / {high:.{digits}f} / {top:.{digits}f}"
