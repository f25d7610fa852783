"""One suite, two vehicles: the built-in one always, a real PX4 when MARSUPIAL_PX4 names its build folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rig import PARAMETERS, Rig
from vehicles import BuiltIn, RealPx4


@pytest.fixture(params=["built-in", "px4"])
def build_rig(request: pytest.FixtureRequest) -> Iterator[Callable[..., Rig]]:
    """Makes rigs: keyword arguments are parameters of the vehicle that differ from the checked ones."""
    build = os.environ.get("MARSUPIAL_PX4")
    if request.param == "px4" and not build:
        pytest.skip("MARSUPIAL_PX4 does not name a PX4 build folder")
    made: list[Rig] = []

    def make(seed: int = 1, **parameters: float) -> Rig:
        wanted = {entry.name: entry.value for entry in PARAMETERS} | parameters
        expected = tuple(entry for entry in PARAMETERS if entry.name not in parameters)
        vehicle: Any
        if request.param == "px4":
            vehicle = RealPx4(Path(str(build)), {**wanted, "SENS_EN_GPSSIM": 0}, 0)
        else:
            vehicle = BuiltIn({"SIM_BAT_DRAIN": 1800.0, **wanted}, seed)
        made.append(Rig(vehicle, expected=expected, seed=seed))
        return made[-1]

    yield make
    for rig in made:
        rig.vehicle.close()
