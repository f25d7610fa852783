"""Checkpoints that survive a crash at any moment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from onboard.core.errors import InputError


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write `state` beside `path` and put it in place at once."""
    partial = path.with_suffix(".partial")
    torch.save(state, partial)
    partial.replace(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """What `save_checkpoint` wrote. Raises InputError for a missing or foreign file."""
    if not path.is_file():
        raise InputError(f"{path}: no such checkpoint; train first")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever the unpickler throws at a foreign file
        raise InputError(f"{path}: not a checkpoint of this program: {error}") from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: not a checkpoint of this program")
    return state
