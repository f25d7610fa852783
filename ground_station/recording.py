"""A map from a recording of a real LiDAR: the robots' own odometry, map and keyframe codec, offline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.recordings import open_recording
from drivers.types import Recording
from ground_station.export import write_json, write_ply
from ground_station.mesh import surface_mesh, write_mesh
from ground_station.octomap import write_octomap
from ground_station.record import Marker, RunRecord
from ground_station.recording_session import RecordingSession, RecordingSettings
from ground_station.reference import Reference, compared, read_tum
from ground_station.report import write_report
from onboard.core.errors import InputError

Progress = Callable[[int, int | None], None]
"""Called after every scan with the number of scans done and the total, where it is known."""

_RAMP = np.array(
    [[48, 18, 59], [40, 120, 235], [30, 210, 160], [200, 225, 60], [245, 120, 30], [150, 20, 10]]
)
"""Colours from the lowest to the highest voxel."""


def map_recording(
    path: Path,
    sensor: str | None,
    out: Path,
    progress: Progress | None = None,
    settings: RecordingSettings | None = None,
    reference: Path | None = None,
) -> dict[str, Any]:
    """Map the recording at `path` into the folder `out` and return the metrics.

    Writes trajectory.txt (TUM: stamp x y z qx qy qz qw), keyframes.bin, map.ply, map.png, metrics.json and
    report.html, and map.bt and mesh.ply where the settings ask for them. `sensor` names the nominal LiDAR
    where the recording does not tell; `reference` is a TUM file with the known poses of the sensor: how far
    ours are from it comes under "reference". After Ctrl-C, or when the recording breaks in the middle,
    everything is written for the scans before ('complete' is then false).
    Raises InputError for a recording or folder that cannot be used.
    """
    settings = settings or RecordingSettings()
    known = None if reference is None else read_tum(reference)
    recording = open_recording(path, sensor, settings.rate_hz)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with (out / "trajectory.txt").open("w") as track, (out / "keyframes.bin").open("wb") as keyframes:
            session = RecordingSession(recording, settings, track, keyframes)
            broken = _run(session, recording, progress)
    except OSError as error:
        raise InputError(f"{out}: cannot write the results: {error.strerror}") from error
    if not session.rows:
        raise broken or InputError(
            f"{path}: interrupted before the first scan was located, or too few returns in it"
        )
    metrics = session.metrics()
    if known is not None:
        broken = _compare(known, session, metrics) or broken
    _write_results(out, path.name, session, metrics)
    if broken is not None:
        raise broken
    return metrics


def _run(session: RecordingSession, recording: Recording, progress: Progress | None) -> InputError | None:
    """Process all scans; an error of the recording is handed back so that the results get written first."""
    try:
        for count, scan in enumerate(recording.scans, start=1):
            session.add(scan)
            if progress is not None:
                progress(count, recording.total)
    except KeyboardInterrupt:
        return None
    except InputError as error:
        return error
    session.complete = True
    return None


def _compare(known: Reference, session: RecordingSession, metrics: dict[str, Any]) -> InputError | None:
    """Enter the errors; an error is handed back so that the results get written first."""
    stamps_s = session.table()[:, 0]
    try:
        metrics["reference"] = compared(known, stamps_s, session.poses[: len(stamps_s)])
    except InputError as error:
        return error
    return None


def _write_results(out: Path, name: str, session: RecordingSession, metrics: dict[str, Any]) -> None:
    indices = session.map.occupied_indices()
    centres = ((indices + 0.5) * session.settings.voxel_m).astype(np.float32)
    write_json(out / "metrics.json", metrics)
    write_ply(out / "map.ply", centres, height_colours(centres[:, 2]))
    if session.settings.octomap:
        free = session.map.free_indices()
        write_octomap(out / "map.bt", indices, free, session.settings.voxel_m)
    if session.surface is not None:
        write_mesh(out / "mesh.ply", *surface_mesh(session.surface))
    write_report(out, _record(name, session, metrics, centres))


def _record(
    name: str, session: RecordingSession, metrics: dict[str, Any], centres: NDArray[np.float32]
) -> RunRecord:
    table = session.table()
    table[:, 0] -= table[0, 0]
    robot = "lidar"
    return RunRecord(
        title=f"Map of {name}",
        metrics=metrics,
        parameters={**asdict(session.settings), "sensor": session.recording.sensor_name},
        timeline={
            "time_s": table[:, 0].tolist(),
            f"explored_m3/{robot}": table[:, 4].tolist(),
            "bytes/keyframes": table[:, 5].tolist(),
        },
        paths={robot: table[:, :4]},
        occupied=centres,
        seen_by=np.ones(len(centres), dtype=np.uint8),
        robots=[robot],
        markers=[Marker("start", "start", (0.0, 0.0, 0.0), 0.0)],
        complete=session.complete,
    )


def height_colours(heights_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(N, 3) colour of every height, from blue (2nd percentile) to red (98th)."""
    if not len(heights_m):
        return np.zeros((0, 3), dtype=np.uint8)
    low, high = np.percentile(heights_m, [2, 98])
    place = np.clip((heights_m - low) / max(high - low, 1e-6), 0, 1) * (len(_RAMP) - 1)
    steps = np.arange(len(_RAMP))
    return np.stack([np.interp(place, steps, _RAMP[:, i]) for i in range(3)], axis=-1).astype(np.uint8)
