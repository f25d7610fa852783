"""The map built anew from kept scans at corrected poses, in the background, used when it is whole."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from onboard.core.geometry import Pose
from onboard.localization.key_scans import KeyScan
from onboard.mapping.voxel_map import OWN, VoxelMap


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A scan and the pose of its sensor in the map frame; `source`: OWN or PEER."""

    scan: KeyScan
    pose: Pose
    source: int = OWN


class Reintegration:
    """Builds a new map piece by piece; nothing is to be planned on it before it is `done`."""

    def __init__(self, like: VoxelMap, pieces: Iterable[Piece], clearing: float = 1.25) -> None:
        """A map of the same voxels and range as `like`.

        Rays without return are drawn `clearing` times the range long.
        """
        self.map = VoxelMap(like.voxel_m, like.max_range_m)
        self._left = deque(pieces)
        self._reach_m = clearing * like.max_range_m

    @property
    def done(self) -> bool:
        return not self._left

    def __len__(self) -> int:
        """Scans that are left."""
        return len(self._left)

    def add(self, piece: Piece) -> None:
        """A scan that came since the beginning."""
        self._left.append(piece)

    def advance(self, scans: int) -> bool:
        """Integrate up to so many scans; whether that was all."""
        for _ in range(min(scans, len(self._left))):
            integrate(self.map, self._left.popleft(), self._reach_m)
        return self.done

    def advance_for(self, budget_s: float, clock: Callable[[], float]) -> bool:
        """Integrate scans until `clock` has advanced by the budget; whether that was all."""
        end_s = clock() + budget_s
        while self._left and clock() < end_s:
            self.advance(1)
        return self.done


def integrate(voxel_map: VoxelMap, piece: Piece, reach_m: float) -> None:
    """Draw one kept scan into a map; rays without return are `reach_m` long."""
    scan = piece.scan.scan()
    voxel_map.integrate(
        scan.rays(reach_m), piece.pose.matrix(), min_range_m=scan.model.min_range_m, source=piece.source
    )
