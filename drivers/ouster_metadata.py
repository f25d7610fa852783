"""An Ouster's metadata (beam angles, packet layout): from a file, from beside a capture, from the sensor."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from itertools import takewhile
from pathlib import Path
from typing import Any

from onboard.core.errors import InputError

SHORTEST_PREFIX = 4
"""Letters that a metadata file's name must share with the capture's to be taken for its own."""
PATHS = ("api/v1/sensor/metadata", "api/v1/sensor/cmd/get_metadata")
ANSWER_MAX_BYTES = 1_000_000


def parse_metadata(text: str, origin: str) -> Any:
    """The SensorInfo of a metadata JSON. Raises InputError that names `origin`."""
    from ouster.sdk import core  # noqa: PLC0415  # an extra: the station may do without

    core.init_logger("error")
    try:
        return core.SensorInfo(text)
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(f"{origin}: not the metadata of an Ouster sensor ({reason})") from error


def read_metadata(path: Path) -> Any:
    """The SensorInfo in a file. Raises InputError for a missing or wrong one."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable Ouster metadata file ({error})") from error
    return parse_metadata(text, str(path))


def fetch_metadata(host: str, timeout_s: float = 2.0) -> Any:
    """The SensorInfo from a sensor's HTTP API. Raises InputError when it does not answer with one."""
    problem = "no answer"
    for path in PATHS:
        url = f"http://{host}/{path}"
        try:
            with urllib.request.urlopen(url, timeout=timeout_s) as answer:
                text = answer.read(ANSWER_MAX_BYTES).decode("utf-8")
            if isinstance(json.loads(text), dict):
                return parse_metadata(text, url)
            problem = "no JSON object"
        except (OSError, ValueError) as error:
            problem = str(error)
    raise InputError(
        f"{host}: no metadata from the sensor ({problem}); check that it is powered and has this address, or "
        "save its metadata once and set 'metadata' to that file"
    )


def load_metadata(path: Path | None, host: str | None) -> Any:
    """From the file if there is one, else from the sensor. Raises InputError when neither gives it."""
    if path is not None:
        return read_metadata(path)
    if host is not None:
        return fetch_metadata(host)
    raise InputError(
        "an Ouster needs its metadata: set 'metadata' to the sensor's JSON file or 'sensor_host'"
    )


def find_metadata(capture: Path) -> Path:
    """The sensor's metadata beside a capture: same stem, else longest common name, else the only one.

    Raises InputError that says what to put where.
    """
    same_stem = capture.with_suffix(".json")
    if same_stem.is_file():
        return same_stem
    candidates = [file for file in sorted(capture.parent.glob("*.json")) if _is_metadata(file)]
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        raise InputError(
            f"{capture}: the Ouster metadata is missing; put the sensor's JSON beside it as {same_stem.name}"
        )
    best = max(candidates, key=lambda file: (_shared(file, capture), -len(file.name)))
    if _shared(best, capture) < SHORTEST_PREFIX:
        names = ", ".join(file.name for file in candidates)
        raise InputError(f"{capture}: several metadata files ({names}); name the right one {same_stem.name}")
    return best


def _is_metadata(path: Path) -> bool:
    try:
        read_metadata(path)
    except InputError:
        return False
    return True


def _shared(a: Path, b: Path) -> int:
    """Letters that two names have in common from the start."""
    pairs = zip(a.stem, b.stem, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
