"""Maps that PyPI does not offer, measured elsewhere on like scans: constants to print beside, not results."""

from __future__ import annotations

from dataclasses import dataclass

MACHINE = "2 vCPU AMD EPYC (Zen 5), Debian 12, g++ 12.2 -O3 -march=native, one thread"
SOURCE = "measured on another machine, mapping figures"


@dataclass(frozen=True)
class Published:
    """CPU milliseconds for an OS0-64 scan on a first visit, of a program and of this map beside it."""

    program: str
    mine_ms: float
    hall_ms: float

    @property
    def mine_ratio(self) -> float:
        """This map's time over the program's."""
        return OURS.mine_ms / self.mine_ms

    @property
    def hall_ratio(self) -> float:
        """This map's time over the program's."""
        return OURS.hall_ms / self.hall_ms


OURS = Published("this map (prototype)", 0.78, 7.8)
PEERS = (
    Published("Bonxai, probabilistic map", 1.87, 25.0),
    Published("voxblox fast, GBPlanner's settings", 9.35, 45.6),
    Published("UFOMap, discrete, early stop", 9.5, 260.0),
    Published("wavemap, hashed chunked wavelets", 17.9, 125.5),
    Published("OctoMap C++, discretised", 24.6, 717.0),
)
