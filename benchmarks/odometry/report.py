"""Results as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.odometry.measure import Result
from benchmarks.tables import markdown, number

_PEERS = (
    "sequence",
    "program",
    "scans (lost)",
    "way m",
    "drift %",
    "worst %",
    "ATE m",
    "RPE 10 m, m",
    "RPE deg",
    "CPU ms p50",
    "p99",
)
_OURS = (
    "sequence",
    "program",
    "degenerate scans",
    "first warning: scan, error m",
    "0.3 m off at scan",
    "drift %",
    "worst %",
    "NEES median",
    "within 95 %",
)


LEGEND = """\
Routes of about 150 m (corridor: 140 m, most of it bare); noise 2 cm, 2 % lost pulses; os0-64 flown, vlp-16
carried by a walking base, both with roll and pitch. Plain names: 10 Hz, points taken while the sensor
moves; 2hz: scans taken at once. `+ base`: increments of a simulated legged base, ways 1.5 % too long and
wandering by 0.4 %, 4 mm and 1 mrad of noise per square root of a second. Drift: last error over the way;
worst: largest error over the way. NEES: squared error in the measure of the covariance since the first scan
(median of an exact one: 5.3); within 95 %: share of scans below the 95 % bound. CPU per scan, one thread,
on a machine busy with other work."""


def peers_table(results: Sequence[Result]) -> str:
    """Errors and times of all programs."""
    return markdown(_PEERS, [_peer_row(result) for result in results])


def honesty_table(results: Sequence[Result]) -> str:
    """What only this project's odometry says of itself: degeneracy and covariances."""
    return markdown(_OURS, [_own_row(result) for result in results if result.nees_median is not None])


def _peer_row(result: Result) -> list[str]:
    errors = result.errors
    return [
        result.sequence,
        result.program,
        f"{result.scans} ({result.lost})",
        number(errors.path_m, 1),
        number(100 * errors.drift, 3),
        number(100 * errors.worst_drift, 3),
        number(errors.ate_m, 3),
        number(errors.rpe_m, 3),
        number(57.29578 * errors.rpe_rad, 3),
        number(result.ms_p50, 1),
        number(result.ms_p99, 1),
    ]


def _own_row(result: Result) -> list[str]:
    warned, far = result.extra["warned_at_scan"], result.extra["error_over_0.3_m_at_scan"]
    return [
        result.sequence,
        result.program,
        str(result.degenerate),
        "-" if warned is None else f"{warned}, {number(result.extra['error_at_warning_m'], 3)}",
        "-" if far is None else str(far),
        number(100 * result.errors.drift, 3),
        number(100 * result.errors.worst_drift, 3),
        number(result.nees_median, 1),
        number(result.nees_within, 3),
    ]


def document(results: Sequence[Result]) -> str:
    """Both tables with what they mean."""
    return "\n\n".join([peers_table(results), honesty_table(results), LEGEND])
