"""Planners that are compared: they fly the same robot on the same map with the same collision checks."""

from __future__ import annotations

from benchmarks.exploration.planners.nearest import NearestFrontier
from benchmarks.exploration.planners.parity import Parity, ParityHome, SparseParity
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory

PLANNERS: dict[str, PlannerFactory] = {
    "ours": Explorer,
    "parity": Parity,
    "parity-home": ParityHome,
    "parity-fast0": SparseParity,
    "nearest": NearestFrontier,
}
