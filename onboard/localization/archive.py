"""What a robot keeps to build its map anew: packed scans in order of arrival, each tied to a keyframe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.key_scans import KeyScan, keep
from onboard.localization.pose_graph import Key
from onboard.localization.reintegration import Piece
from onboard.mapping.voxel_map import OWN, PEER


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A scan whose sensor is at `offset` in the frame of keyframe `key`; None: it is the keyframe's own."""

    key: Key
    offset: Pose | None
    scan: KeyScan


class Archive:
    """All kept scans of `robot` and of its peers' keyframes."""

    def __init__(self, robot: int) -> None:
        self._robot = robot
        self._kept: list[Kept] = []
        self._keyframes: dict[Key, KeyScan] = {}

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def stored_bytes(self) -> int:
        """Size of the packed scans."""
        return sum(len(kept.scan.data) for kept in self._kept)

    def __iter__(self) -> Iterator[Kept]:
        """In order of arrival."""
        return iter(self._kept)

    def put_back(self, kept: Kept) -> None:
        """A scan that was kept before."""
        if kept.offset is None:
            self._keyframes[kept.key] = kept.scan
        self._kept.append(kept)

    def add_keyframe(self, key: Key, scan: Scan) -> Kept:
        """Keep the scan of a keyframe."""
        kept = Kept(key, None, keep(scan))
        self.put_back(kept)
        return kept

    def add_between(self, key: Key, offset: Pose, scan: Scan) -> Kept:
        """Keep a scan that is none of a keyframe but helps to draw the map."""
        kept = Kept(key, offset, keep(scan))
        self._kept.append(kept)
        return kept

    def scan(self, key: Key) -> Scan | None:
        """The scan of a keyframe, None if there is none."""
        kept = self._keyframes.get(key)
        return None if kept is None else kept.scan()

    def pieces(self, poses: Mapping[Key, Pose]) -> list[Piece]:
        """Everything in order of arrival, placed by the poses of the keyframes."""
        return [self.piece(kept, poses[kept.key]) for kept in self._kept if kept.key in poses]

    def piece(self, kept: Kept, pose: Pose) -> Piece:
        """One kept scan, its keyframe being at `pose`."""
        source = OWN if kept.key[0] == self._robot else PEER
        return Piece(kept.scan, pose if kept.offset is None else pose.compose(kept.offset), source)
