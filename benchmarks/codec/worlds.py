"""The worlds of each split: which ones to test on, to tune on and to learn from, never mixed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.roof import roofed_world
from onboard.core.errors import InputError
from simulation.worlds import World, load_world, make_world

MINE = "pittsburgh_mine_plan"
OTHERS = (
    "aws_warehouse",
    "cerlab_building_4f",
    "cpr_inspection",
    "darpa_cave_02",
    "nibs_duplex",
    "octomap_geb079",
    "parking_garage",
)
_STARTS = {"octomap_geb079": (24.56, 0.56, 1.0)}
"""Meshes too cramped for a start to be found."""
_ROOF_SEED = 1000


@dataclass(frozen=True)
class Source:
    """One world of a split: its label in the tables, how to make it and how many scans it gives."""

    label: str
    make: Callable[[], World]
    scans: int


def sources(split: str, data: Path, scans: int) -> list[Source]:
    """The worlds of a split with about `scans` scans for each kind of world.

    test: buildings and caves of seeds 1000 to 1002 and the mine plan under a rough roof; other: the published
    meshes that nothing is tuned on or learnt from; dev: seeds 2000 to 2004 and one mine scan, for tuning;
    train: seeds from 3000 on and the other mine scan. Raises InputError for an unknown split.
    """
    if split == "test":
        made = _generated(("building", "cave"), range(1000, 1003), scans)
        return [*made, Source(MINE, lambda: _mine(data), scans)]
    if split == "other":
        return [_mesh(data, name, scans) for name in OTHERS]
    if split == "dev":
        return [*_generated(KINDS, range(2000, 2005), scans), _mesh(data, "edgar_stix_09", scans)]
    if split == "train":
        seeds = range(3000, 3000 + max(4, scans // 50))
        return [*_generated(KINDS, seeds, scans), _mesh(data, "edgar_stix_03", scans)]
    raise InputError(f"unknown split '{split}'; known: test, other, dev, train")


KINDS = ("building", "cave", "mine")


def _generated(kinds: tuple[str, ...], seeds: range, scans: int) -> list[Source]:
    """`scans` in all of each kind, shared evenly by its seeds."""
    shares = [len(part) for part in np.array_split(np.arange(scans), len(seeds))]
    return [
        Source(f"{kind}-{seed}", _maker(kind, seed), share)
        for kind in kinds
        for seed, share in zip(seeds, shares, strict=True)
        if share
    ]


def _maker(kind: str, seed: int) -> Callable[[], World]:
    return lambda: make_world(kind, seed)


def _mesh(data: Path, name: str, scans: int) -> Source:
    return Source(name, lambda: load_world(data / name / "world.ply", _STARTS.get(name)), scans)


def _mine(data: Path) -> World:
    """The mine plan as published, without its flat ceiling, under a rough one."""
    return roofed_world(data / MINE / "world_as_published.ply", np.random.default_rng(_ROOF_SEED))
