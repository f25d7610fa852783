"""What the surroundings of a keyframe look like: the scans around it put together in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import small_gicp

from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.mapping.voxel_map import VoxelMap

VOXEL_M = 0.2


@dataclass(frozen=True, slots=True)
class SubmapSettings:
    """How much goes into a submap and how fine it is."""

    half_length_m: float = 5.0
    """Keyframes up to so far along the way before and after take part."""
    spacing_m: float = 1.0
    """... if they are at least so far apart: turning on the spot adds nothing but work."""
    range_m: float = 20.0
    point_m: float = 0.2
    """One point per cube of this size."""
    few_m: float = 0.5
    """One point per cube of this size where a few do."""
    neighbours: int = 14


@dataclass(frozen=True, eq=False)
class Submap:
    """Scans, each with the pose of its sensor in the submap's frame, whose origin is the keyframe."""

    scans: Sequence[tuple[Scan, Pose]]
    settings: SubmapSettings

    @cached_property
    def points(self) -> FloatArray:
        """(N, 3) thinned points in the submap's frame."""
        clouds = [self._near(scan) @ pose.rotation.T + pose.position for scan, pose in self.scans]
        merged = small_gicp.PointCloud(np.concatenate(clouds).astype(np.float64))
        thinned = small_gicp.voxelgrid_sampling(merged, self.settings.point_m)
        return np.asarray(thinned.points()[:, :3], dtype=np.float64)

    @cached_property
    def target(self) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
        """The points with their covariances, and a search tree."""
        return _with_covariances(self.points, self.settings.neighbours)

    @property
    def cloud(self) -> small_gicp.PointCloud:
        """The points with their covariances."""
        return self.target[0]

    @cached_property
    def few(self) -> small_gicp.PointCloud:
        """Fewer points with their covariances."""
        thinned = small_gicp.voxelgrid_sampling(self.cloud, self.settings.few_m)
        points = np.asarray(thinned.points()[:, :3], dtype=np.float64)
        return _with_covariances(points, self.settings.neighbours)[0]

    @cached_property
    def voxels(self) -> VoxelMap:
        """What is known free and occupied around the keyframe."""
        known = VoxelMap(VOXEL_M, self.settings.range_m)
        for scan, pose in self.scans:
            known.integrate(
                scan.rays(1.25 * self.settings.range_m), pose.matrix(), min_range_m=scan.model.min_range_m
            )
        return known

    def _near(self, scan: Scan) -> FloatArray:
        points = scan.points()
        return np.asarray(points[np.einsum("ij,ij->i", points, points) <= self.settings.range_m**2])


def _with_covariances(points: FloatArray, neighbours: int) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
    cloud = small_gicp.PointCloud(points)
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_normals_covariances(cloud, tree, neighbours)
    return cloud, tree
