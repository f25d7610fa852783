"""Configurations as TOML text: the standard library only reads it."""

from __future__ import annotations

import json
from typing import Any


def to_toml(data: dict[str, Any]) -> str:
    """Tables, arrays of tables, strings, numbers, booleans and flat lists; null keys are left out."""
    return "\n".join(_table(data, "")).strip("\n") + "\n"


def _table(data: dict[str, Any], prefix: str) -> list[str]:
    lines = [
        f"{key} = {_value(value)}"
        for key, value in data.items()
        if not _is_nested(value) and value is not None
    ]
    for key, value in data.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            lines += ["", f"[{name}]", *_table(value, f"{name}.")]
        elif _is_nested(value):
            for item in value:
                lines += ["", f"[[{name}]]", *_table(item, f"{name}.")]
    return lines


def _is_nested(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return bool(value) and all(isinstance(item, dict) for item in value)
    return isinstance(value, dict)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)
