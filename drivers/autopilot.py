"""A PX4 as the rest of the house sees it: one link over one wire."""

from __future__ import annotations

from drivers.mavlink.commands import Notice
from drivers.mavlink.frames import Pose
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.parameter_check import load_parameters
from drivers.mavlink.ports import Port, open_port
from drivers.mavlink.signing import load_signer
from drivers.mavlink.vehicle_state import VehicleState

__all__ = [
    "LinkSettings",
    "Notice",
    "Port",
    "Pose",
    "VehicleLink",
    "VehicleState",
    "load_parameters",
    "load_signer",
    "open_port",
]
