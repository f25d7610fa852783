"""Names and numbers for people: `explored_m3: 1234.56` reads as `Explored`, `1,235 m³`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

UNITS = {
    "m3_s": "m³/s",
    "bytes_s": "B/s",
    "rad_s": "rad/s",
    "m_s2": "m/s²",
    "m_s": "m/s",
    "m3": "m³",
    "m2": "m²",
    "wh": "Wh",
    "hz": "Hz",
    "db": "dB",
    "rad": "rad",
    "deg": "°",
    "ms": "ms",
    "m": "m",
    "s": "s",
    "w": "W",
}
"""Longer suffixes first: a key ends in its unit, or in a percentile after it."""

TEAM = "team"


def name_and_unit(key: str) -> tuple[str, str]:
    """The readable name and the unit of a key; a dotted key has the unit of its last part with one."""
    parts = [_split_unit(part) for part in key.split(".")]
    units = [unit for _, unit in parts if unit]
    name = ": ".join(part.replace("_", " ") for part, _ in parts)
    return name[:1].upper() + name[1:], units[-1] if units else ""


def _split_unit(part: str) -> tuple[str, str]:
    if "bytes" in part.split("_") and not part.endswith("_s"):
        return part, "B"
    stem, _, percentile = part.rpartition("_p")
    if percentile.isdigit():
        name, unit = _split_unit(stem)
        return f"{name} p{percentile}", unit
    for suffix, unit in UNITS.items():
        if part.endswith("_" + suffix):
            name = part.removesuffix("_" + suffix)
            return (name.removesuffix("_t") + "_time" if name.endswith("_t") else name), unit
    return part, ""


def show(value: Any, unit: str = "") -> str:
    """A value as text with its unit: thousands separated, about four significant digits."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "\N{EN DASH}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if unit == "B":
        return show_bytes(float(value))
    if isinstance(value, int | float):
        return f"{_number(value)} {unit}".rstrip()
    if isinstance(value, list | tuple):
        return ", ".join(show(item, unit) for item in value)
    return str(value)


def _number(value: float) -> str:
    if isinstance(value, int) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.1f}" if abs(value) >= 100 else f"{value:.4g}"


def show_bytes(count: float) -> str:
    """A number of bytes in the decimal unit that suits it."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f} B"


def show_time(seconds: float) -> str:
    """Minutes and seconds from a minute on, as in `12:05 min`."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d} min"


def flatten(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one with dotted keys; lists of tables get a number."""
    flat: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, list | tuple) and value and all(isinstance(item, dict) for item in value):
            value = {str(item.get("name", number)): item for number, item in enumerate(value)}  # noqa: PLW2901
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def split_by_robot(
    metrics: dict[str, Any], robots: list[str]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Metrics as ({metric: {robot: value}}, the others flattened).

    Understands both `{"robots": {"ground": {"path_m": 1}}}` and `{"path_m": {"ground": 1}}`; a
    key beside the robots' (such as "union") goes to the column `TEAM`.
    """
    rows: dict[str, dict[str, Any]] = {}
    others: dict[str, Any] = {}
    for key, value in metrics.items():
        if isinstance(value, dict) and key == "robots":
            for robot, table in value.items():
                for name, item in flatten(table).items():
                    rows.setdefault(name, {})[robot] = item
        elif isinstance(value, dict) and _is_per_robot(value, robots):
            row = {(name if name in robots else TEAM): item for name, item in value.items()}
            rows.setdefault(key, {}).update(row)
        else:
            others |= flatten({key: value})
    return rows, others


def _is_per_robot(value: dict[str, Any], robots: list[str]) -> bool:
    plain_values = not any(isinstance(item, dict) for item in value.values())
    others = [name for name in value if name not in robots]
    return plain_values and len(others) < len(value) and len(others) <= 1
