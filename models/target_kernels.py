"""Warp kernels of the voxel-aware target; compiled for the CPU or for CUDA on first use."""

# ruff: noqa: UP018, RUF046  (in a kernel, int(0) declares a variable and 0 a constant)

from __future__ import annotations

import warp as wp


@wp.func
def cell_of(point: wp.vec3, voxel: float) -> wp.vec3i:
    """Cell of a point; the sensor sits in the centre of cell 0."""
    scaled = point / voxel
    return wp.vec3i(
        int(wp.floor(scaled[0] + 0.5)), int(wp.floor(scaled[1] + 0.5)), int(wp.floor(scaled[2] + 0.5))
    )


@wp.func
def centre_distance(cell: wp.vec3i, voxel: float) -> float:
    return wp.length(wp.vec3(float(cell[0]), float(cell[1]), float(cell[2]))) * voxel


@wp.kernel
def end_cell_kernel(
    ranges: wp.array(dtype=float),
    directions: wp.array(dtype=wp.vec3),
    voxel: float,
    far: float,
    target: wp.array(dtype=float),
) -> None:
    """Distance to the centre of the voxel in which the ray of a pixel ends."""
    pixel = wp.tid()
    measured = ranges[pixel]
    if measured >= far:
        target[pixel] = far
    elif measured > 0.0:
        cell = cell_of(directions[pixel % directions.shape[0]] * measured, voxel)
        target[pixel] = wp.clamp(centre_distance(cell, voxel), 0.5 * voxel, far)
    else:
        target[pixel] = 0.0


@wp.kernel
def occupy_kernel(
    ranges: wp.array(dtype=float),
    directions: wp.array(dtype=wp.vec3),
    voxel: float,
    far: float,
    half: int,
    grid: wp.array3d(dtype=wp.uint8),
) -> None:
    """Mark the voxels in which rays end."""
    pixel = wp.tid()
    measured = ranges[pixel]
    if measured > 0.0 and measured < far:
        cell = cell_of(directions[pixel] * measured, voxel)
        grid[cell[0] + half, cell[1] + half, cell[2] + half] = wp.uint8(1)


@wp.func
def to_boundary(direction: float, voxel: float) -> float:
    """Ray length from the centre of a voxel to its side; huge for a ray along the side."""
    if wp.abs(direction) < 1.0e-9:
        return 1.0e30
    return 0.5 * voxel / wp.abs(direction)


@wp.kernel
def retrace_kernel(
    ranges: wp.array(dtype=float),
    directions: wp.array(dtype=wp.vec3),
    voxel: float,
    far: float,
    half: int,
    grid: wp.array3d(dtype=wp.uint8),
    target: wp.array(dtype=float),
) -> None:
    """Distance to the centre of the first occupied voxel on every known ray (exact traversal), else `far`."""
    pixel = wp.tid()
    if ranges[pixel] <= 0.0:
        target[pixel] = 0.0
        return
    ray = directions[pixel]
    next_x = to_boundary(ray[0], voxel)
    next_y = to_boundary(ray[1], voxel)
    next_z = to_boundary(ray[2], voxel)
    step_x = 2.0 * next_x
    step_y = 2.0 * next_y
    step_z = 2.0 * next_z
    x = int(0)
    y = int(0)
    z = int(0)
    found = float(far)
    travelled = float(0.0)
    while travelled < far:
        if grid[x + half, y + half, z + half] == wp.uint8(1):
            found = wp.clamp(centre_distance(wp.vec3i(x, y, z), voxel), 0.5 * voxel, far)
            break
        if next_x <= next_y and next_x <= next_z:
            travelled = next_x
            x += int(wp.sign(ray[0]))
            next_x += step_x
        elif next_y <= next_z:
            travelled = next_y
            y += int(wp.sign(ray[1]))
            next_y += step_y
        else:
            travelled = next_z
            z += int(wp.sign(ray[2]))
            next_z += step_z
    target[pixel] = found
