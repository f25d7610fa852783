"""The recordings table: `marsupial map` over recordings of real LiDARs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import matrix, tables
from benchmarks.matrix import Runner, Settings

VELODYNE = ("mrpt_velodyne/sample_velodyne_vlp16_gps.pcap", "mrpt_velodyne/test_velodyne_VLP16.rawlog")
OUSTER = ("ouster_sdk_tests/**/*.pcap", "ouster_sdk_tests/**/*.osf")
COLUMNS = ("recording", "sensor", "scans (lost)", "path m", "keyframes", "bytes", "B/keyframe", "F1")

console = Console(stderr=True)


def find_recordings(data: Path) -> list[Path]:
    """The recordings below `data` that `marsupial map` is tried on, in a fixed order."""
    velodyne = [data / name for name in VELODYNE if (data / name).is_file()]
    return velodyne + [path for pattern in OUSTER for path in sorted(data.glob(pattern))]


def recordings_table(data: Path, settings: Settings, runner: Runner) -> str:
    """Map each recording and return the table; what cannot be read is listed below it with its message."""
    rows, refused = [], []
    for path in find_recordings(data):
        directory = settings.out / f"recording-{path.stem}-{path.suffix[1:]}"
        arguments = ["map", str(path), "--out", str(directory), "--json", "--force"]
        if code := matrix.run_stamped(arguments, directory, settings, runner):
            message = matrix.last_line(directory / "run.log").replace(str(data), "")
            refused.append(f"- `{path.name}`: exit {code}: {message}")
        else:
            metrics = json.loads((directory / "metrics.json").read_text(encoding="utf-8"))
            rows.append(recording_row(path.name, metrics))
        console.print(refused[-1] if code else " | ".join(rows[-1]), highlight=False, soft_wrap=True)
    text = tables.markdown(COLUMNS, rows)
    return text if not refused else text + "\n\nRefused:\n\n" + "\n".join(refused)


def recording_row(name: str, metrics: dict[str, Any]) -> list[str]:
    """The cells of one recording."""
    keyframes = metrics["keyframes"]
    return [
        name,
        str(metrics["sensor"]),
        f"{metrics['scans']} ({metrics['lost_scans']})",
        tables.number(metrics["path_m"], 2),
        str(keyframes),
        str(metrics["keyframe_bytes"]),
        tables.number(metrics["keyframe_bytes"] / keyframes if keyframes else None),
        tables.number(metrics["keyframe_map"]["occ_f1"], 3),
    ]
