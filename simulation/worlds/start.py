"""Where a team can start in a mesh that says nothing about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from onboard.core.errors import InputError
from simulation.worlds.solids import up
from simulation.worlds.voxels import Bools, Floats, casting_scene, crossings, roofed, voxelise

HEADROOM_M = 2.0
FREE_RADIUS_M = 1.2
STANDING_RADIUS_M = 0.55
"""Free radius that a start named by the user must have: half the carrier's diagonal."""
INSIDE_SHARE = 0.9
COVERED_SHARE = 0.6
"""Share of rays around that must hit: for a start that we choose, and for one that the user names."""
DROP_M = 3.0
_EYE_M = 1.0
_UNEVEN_M = 0.15
_CELLS = 4e6
_COLUMNS = 12_000
_LEVEL_BAND_M = 0.5


@dataclass(frozen=True, eq=False)
class _Floors:
    """(N, 3) floor points; shares (N,) of the rays around that hit, and that hit front faces; free radii."""

    points: Floats
    covered: Floats
    front: Floats
    radius_m: Floats

    def only(self, keep: Bools) -> _Floors:
        return _Floors(self.points[keep], self.covered[keep], self.front[keep], self.radius_m[keep])


class StartFinder:
    """Casts rays at one mesh to judge places on its floors."""

    def __init__(self, vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
        self._scene = casting_scene(vertices, triangles)
        self._lower = vertices.min(axis=0).astype(np.float64)
        self._upper = vertices.max(axis=0).astype(np.float64)

    def project(self, start: tuple[float, float, float]) -> Floats:
        """The floor point under `start`. Raises InputError if the team cannot stand there."""
        point = np.array(start, dtype=np.float64)
        text = "start ({:g}, {:g}, {:g})".format(*start)
        lift = 0.3
        drop = float(self._cast(point[None] + up(lift), -up(1.0)[None])[0, 0]) - lift
        if not drop <= DROP_M:
            raise InputError(f"{text} has no floor within {DROP_M:g} m below; name a point inside")
        floor = point - up(drop)
        found = self._judge(floor[None])
        headroom = float(self._cast(floor[None] + up(0.05), up(1.0)[None])[0, 0]) + 0.05
        if headroom < HEADROOM_M:
            raise InputError(f"{text} has {headroom:.1f} m of headroom; {HEADROOM_M:g} m are needed")
        if found.covered[0] < COVERED_SHARE:
            raise InputError(f"{text} lies in the open: {found.covered[0]:.0%} of the rays around it hit")
        if found.radius_m[0] < STANDING_RADIUS_M:
            raise InputError(
                f"{text} is {found.radius_m[0]:.1f} m from a wall; {STANDING_RADIUS_M} m are needed"
            )
        return floor

    def find(self) -> Floats:
        """The roomiest point of the lowest floor of the largest interior; InputError if there is none."""
        floors = self._judge(self._even(self._floors()))
        good = floors.only((floors.covered >= INSIDE_SHARE) & (floors.radius_m >= FREE_RADIUS_M))
        if not len(good.points):
            raise InputError("no roomy floor inside it was found; name a start")
        if (good.front > 0.5).any():  # else the whole mesh is turned inside out
            good = good.only(good.front > 0.5)
        good = good.only(self._in_largest(good))
        low = good.only(good.points[:, 2] <= good.points[:, 2].min() + _LEVEL_BAND_M)
        return np.asarray(low.points[np.argmax(low.radius_m)])

    def open_direction(self, floor: Floats) -> float:
        """Yaw in radians that looks farthest from a floor point (3,)."""
        azimuths = np.arange(72) / 72 * 2 * np.pi
        reach = np.minimum(self._cast(floor[None] + up(0.8), _horizontal(azimuths))[0], 20.0)
        wide = sum(np.roll(reach, shift) for shift in range(-3, 4))
        best = float(azimuths[int(np.argmax(wide))])
        return best if best <= np.pi else best - 2 * np.pi

    def _cast(self, origins: Floats, directions: Floats) -> Floats:
        """(N, D) hit distances from (N, 3) origins along (D, 3) directions."""
        rays = np.empty((len(origins), len(directions), 6), dtype=np.float32)
        rays[..., :3] = origins[:, None]
        rays[..., 3:] = directions[None]
        return np.asarray(
            self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy(), dtype=np.float64
        )

    def _look_around(self, eyes: Floats) -> tuple[Floats, Floats]:
        """Shares (N,) of the rays around each eye that hit, and that hit faces whose normals face the eye.

        The latter tells rooms from the inside of thick walls and rock.
        """
        sphere = _sphere(128).astype(np.float32)
        rays = np.empty((len(eyes), len(sphere), 6), dtype=np.float32)
        rays[..., :3], rays[..., 3:] = eyes[:, None], sphere
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        hit = np.isfinite(found["t_hit"].numpy())
        facing = np.einsum("ndk,dk->nd", found["primitive_normals"].numpy(), sphere) < 0
        return np.asarray(hit.mean(axis=1)), np.asarray((hit & facing).mean(axis=1))

    def _floors(self) -> Floats:
        """(N, 3) surface points with headroom, on a regular plan grid."""
        size = self._upper - self._lower
        spacing = max(0.3, float(np.sqrt(size[0] * size[1] / _COLUMNS)))
        x, y = (
            np.arange(lo + spacing / 2.3, hi, spacing)
            for lo, hi in zip(self._lower[:2], self._upper[:2], strict=True)
        )
        columns = np.stack(
            [*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), self._lower[2] - 1)], -1
        )
        columns = columns.reshape(-1, 3)
        lines, z = crossings(self._scene, columns, 2)
        order = np.lexsort((z, lines))
        lines, z = lines[order], z[order]
        above = np.append(np.where(lines[1:] == lines[:-1], z[1:], np.inf), np.inf)
        keep = above - z >= HEADROOM_M
        return np.column_stack([columns[lines[keep], :2], z[keep]])

    def _even(self, floors: Floats) -> Floats:
        """Those around which the floor goes on at about the same height."""
        even = np.ones(len(floors), dtype=bool)
        for radius in (0.6, FREE_RADIUS_M):
            for azimuth in np.arange(8) / 8 * 2 * np.pi:
                offset = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), _EYE_M])
                down = self._cast(floors + offset, -up(1.0)[None])[:, 0]
                even &= np.abs(down - _EYE_M) <= _UNEVEN_M
        return floors[even]

    def _judge(self, floors: Floats) -> _Floors:
        around, front = self._look_around(floors + up(_EYE_M))
        level = _horizontal(np.arange(24) / 24 * 2 * np.pi)
        radius = [self._cast(floors + up(height), level).min(axis=1) for height in (0.4, 0.9)]
        return _Floors(floors, around, front, np.minimum(*radius))

    def _in_largest(self, floors: _Floors) -> Bools:
        """Those in the piece of connected air that has the most roofed volume."""
        size = np.prod(self._upper - self._lower + 1.0)
        voxel = float(np.clip((size / _CELLS) ** (1 / 3), 0.15, 0.7))
        voxels = voxelise(self._scene, self._lower, self._upper, voxel)
        covered = roofed(voxels)
        cells = np.array([voxels.index(point + up(_EYE_M)) for point in floors.points])
        best, most, unseen = np.zeros(len(cells), dtype=bool), -1, np.ones(len(cells), dtype=bool)
        while unseen.any():
            first = cells[np.argmax(unseen)]
            region = voxels.region((int(first[0]), int(first[1]), int(first[2])))
            inside = region[tuple(cells.T)]
            volume = int((region & covered).sum())
            if volume > most:
                best, most = inside, volume
            unseen &= ~inside
        return best


def _horizontal(azimuths: Floats) -> Floats:
    return np.column_stack([np.cos(azimuths), np.sin(azimuths), np.zeros(len(azimuths))])


def _sphere(count: int) -> Floats:
    """(count, 3) evenly spread unit vectors (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    return np.column_stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z])
