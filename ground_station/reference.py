"""A known trajectory from a TUM file, and how far ours is from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ground_station.trajectory_errors import compare_trajectories
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose

TOLERANCE_S = 0.01
"""Poses whose stamps differ by no more than this belong together, as in evo."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Poses of the sensor by stamp, ascending."""

    stamps_s: FloatArray
    poses: list[Pose]

    def partners(self, stamps_s: FloatArray) -> list[tuple[int, int]]:
        """For every stamp (N,) the nearest of the reference: (place in `stamps_s`, place here).

        Where no stamp meets any and both are equally many, as with files that carry no time, the order
        decides.
        """
        after = np.clip(np.searchsorted(self.stamps_s, stamps_s), 1, max(len(self.stamps_s) - 1, 1))
        nearer = np.abs(self.stamps_s[after - 1] - stamps_s) <= np.abs(self.stamps_s[after] - stamps_s)
        nearest = np.where(nearer, after - 1, after)
        close = np.abs(self.stamps_s[nearest] - stamps_s) <= TOLERANCE_S
        if not close.any() and len(stamps_s) == len(self.stamps_s):
            return [(i, i) for i in range(len(stamps_s))]
        return [(int(i), int(nearest[i])) for i in np.flatnonzero(close)]


def read_tum(path: Path) -> Reference:
    """Read `stamp x y z qx qy qz qw` per line, # for comments. Raises InputError naming the line."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the reference: {error}") from error
    rows = [_row(path, number, line) for number, line in enumerate(lines, start=1) if _says(line)]
    if len(rows) < 2:
        raise InputError(f"{path}: a reference needs two poses at least")
    rows.sort(key=lambda row: float(row[0]))
    return Reference(np.array([row[0] for row in rows]), [Pose(row[1:4], row[4:]) for row in rows])


def _says(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _row(path: Path, number: int, line: str) -> FloatArray:
    """(8,) numbers with a unit quaternion."""
    try:
        row = np.array([float(word) for word in line.replace(",", " ").split()])
    except ValueError:
        row = np.empty(0)
    length = float(np.linalg.norm(row[4:])) if len(row) == 8 else 0.0
    if not np.isfinite(row).all() or not 0.9 < length < 1.1:
        raise InputError(f"{path}:{number}: not a pose in TUM's format: stamp x y z qx qy qz qw")
    row[4:] /= length
    return row


def compared(reference: Reference, stamps_s: FloatArray, poses: list[Pose]) -> dict[str, Any]:
    """ATE and RPE of the poses that have a partner; lengths in metres. InputError for fewer than two."""
    pairs = reference.partners(stamps_s)
    if len(pairs) < 2:
        spans = [f"{s[0]:.3f} to {s[-1]:.3f} s" for s in (stamps_s, reference.stamps_s) if len(s)]
        raise InputError(f"reference: no stamps in common (within {TOLERANCE_S} s): {' and '.join(spans)}")
    found = compare_trajectories([poses[i] for i, _ in pairs], [reference.poses[k] for _, k in pairs])
    return {
        "poses": len(pairs),
        "path_m": found.path_m,
        "ate_m": found.ate_m,
        "rpe_delta_m": found.delta_m,
        "rpe_m": found.rpe_m,
        "rpe_deg": float(np.degrees(found.rpe_rad)),
        "drift_percent": 100.0 * found.drift,
    }
