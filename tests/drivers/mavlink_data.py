"""Captures of real vehicles, where the public data is at hand."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("MARSUPIAL_DATA", Path(__file__).parents[3] / "shared/data")) / "mavlink"


def capture(name: str) -> Path:
    """A file of the data; the test skips where it is absent."""
    path = FOLDER / name
    if not path.exists():
        pytest.skip(f"no public captures at {FOLDER}; set MARSUPIAL_DATA")
    return path


def tlog_frames(path: Path) -> Iterator[bytes]:
    """The frames of a log of MAVLink 2 frames with 8 bytes of time before each."""
    data, place = path.read_bytes(), 0
    while place < len(data):
        size = 10 + data[place + 9] + 2 + (13 if data[place + 10] & 1 else 0)
        yield data[place + 8 : place + 8 + size]
        place += 8 + size
