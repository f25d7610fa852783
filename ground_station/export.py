"""Files that other tools read: point clouds (PLY), metrics (JSON), the log of events (JSON lines)."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError

_PLY_VERTEX = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])
_PLY_HEADER = """ply
format binary_little_endian 1.0
comment metres, east north up
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def write_ply(path: Path, points: ArrayLike, colours: NDArray[np.uint8]) -> None:
    """Write (N, 3) points in metres with (N, 3) byte colours as binary little-endian PLY."""
    vertices = np.empty(len(colours), dtype=_PLY_VERTEX)
    vertices["position"] = points
    vertices["colour"] = colours
    write_bytes(path, _PLY_HEADER.format(count=len(vertices)).encode() + vertices.tobytes())


def read_ply(path: Path) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Points (N, 3) and colours (N, 3) of a file that `write_ply` wrote. Raises InputError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    _, end, body = data.partition(b"end_header\n")
    if not end or len(body) % _PLY_VERTEX.itemsize:
        raise InputError(f"{path}: not a map of this program")
    vertices = np.frombuffer(body, dtype=_PLY_VERTEX)
    return vertices["position"].copy(), vertices["colour"].copy()


def write_json(path: Path, data: Any) -> None:
    """Write JSON whole or not at all; numpy values become plain ones, NaN and infinity null."""
    write_bytes(path, (json.dumps(plain(data), indent=2, ensure_ascii=False) + "\n").encode())


def plain(value: Any) -> Any:
    """The same data with nothing but what JSON knows. Raises TypeError for anything else."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


class EventLog:
    """Append-only log, one JSON object per line; every line is on its way to disk when `write` returns."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file cannot be opened."""
        try:
            _end_torn_line(path)
            self._file = path.open("a", encoding="utf-8")
        except OSError as error:
            raise InputError(f"{path}: cannot write the log of events: {error.strerror}") from error

    def write(self, time_s: float, kind: str, **fields: Any) -> None:
        """Append one event that happened `time_s` into the run."""
        line = json.dumps(plain({"time_s": time_s, "kind": kind, **fields}), ensure_ascii=False)
        self._file.write(line + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_events(path: Path) -> list[dict[str, Any]]:
    """All events of a log; a last line that a kill cut short is left out.

    Raises InputError for a missing file and for a line that is broken elsewhere.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot read the log of events: {error.strerror}") from error
    complete = lines[:-1]  # what follows the last line feed is empty, or was cut short
    return [_parse_event(path, number, line) for number, line in enumerate(complete, start=1)]


def _parse_event(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        event = json.loads(line)
    except ValueError as error:
        raise InputError(f"{path}:{number}: not a JSON event: {error}") from error
    if not isinstance(event, dict) or not {"time_s", "kind"} <= event.keys():
        raise InputError(f"{path}:{number}: an event needs time_s and kind")
    return event


def _end_torn_line(path: Path) -> None:
    """Cut a last line without line feed, so that the next event does not merge with it."""
    if not path.exists():
        return
    data = path.read_bytes()
    if not data.endswith(b"\n"):
        os.truncate(path, data.rfind(b"\n") + 1)


def write_bytes(path: Path, data: bytes) -> None:
    """Write beside the target and rename, so that a reader never sees half a file."""
    scratch = path.with_name(f".{path.name}.tmp")
    try:
        scratch.write_bytes(data)
        scratch.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}") from error
