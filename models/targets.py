"""Voxel-aware target images, computed by NVIDIA Warp: one kernel source for CPU and CUDA.

The paper's text fills a robot-centred grid and traces every ray to the first occupied voxel; its published
code takes the centre of the voxel in which the ray ends. Re-tracing hides grazing surface (best F1 .982
aerial, .962 ground, against 1.000), so that the end voxel is the default and the text's rule is
`retrace=True`. Free voxels need no marks: whatever is not occupied lets a ray pass.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp
from numpy.typing import NDArray

from models.target_kernels import end_cell_kernel, occupy_kernel, retrace_kernel
from onboard.core.lidar import LidarModel

Floats = NDArray[np.float32]


def voxel_targets(
    ranges: Floats, model: LidarModel, voxel_m: float = 0.2, *, retrace: bool = False, device: str = "cpu"
) -> Floats:
    """(B, H, W) target ranges in metres of `ranges` (B, H, W); 0 = unknown, the image's maximum = free ray.

    The grid is the sensor's, as in the paper. `device` is a Warp device: "cpu", "cuda" or "cuda:0".
    """
    far = model.image_max_range_m
    directions = _directions(model, device)
    if not retrace:
        return _end_cells(ranges, directions, voxel_m, far, device)
    half = int(np.ceil(far / voxel_m)) + 1
    grid = wp.zeros((2 * half + 1,) * 3, dtype=wp.uint8, device=device)
    images = [_retraced(image, directions, voxel_m, far, half, grid, device) for image in ranges]
    return np.stack(images)


@cache
def _directions(model: LidarModel, device: str) -> wp.array:
    return wp.array(model.directions.reshape(-1, 3), dtype=wp.vec3, device=device)


def _end_cells(ranges: Floats, directions: wp.array, voxel_m: float, far: float, device: str) -> Floats:
    measured = _on_device(ranges, device)
    target = wp.empty_like(measured)
    inputs = [measured, directions, voxel_m, far, target]
    wp.launch(end_cell_kernel, dim=measured.size, inputs=inputs, device=device)
    return np.asarray(target.numpy(), dtype=np.float32).reshape(ranges.shape)


def _retraced(
    image: Floats, directions: wp.array, voxel_m: float, far: float, half: int, grid: wp.array, device: str
) -> Floats:
    grid.zero_()
    measured = _on_device(image, device)
    target = wp.empty_like(measured)
    inputs = [measured, directions, voxel_m, far, half, grid]
    wp.launch(occupy_kernel, dim=measured.size, inputs=inputs, device=device)
    wp.launch(retrace_kernel, dim=measured.size, inputs=[*inputs, target], device=device)
    return np.asarray(target.numpy(), dtype=np.float32).reshape(image.shape)


def _on_device(ranges: Floats, device: str) -> wp.array:
    return wp.array(np.ascontiguousarray(ranges, dtype=np.float32).ravel(), dtype=float, device=device)
