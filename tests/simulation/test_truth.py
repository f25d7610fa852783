"""The reachable free volume against worlds whose volume is known."""

import numpy as np
import pytest

from onboard.core.errors import InputError
from simulation.truth import Truth

HALF = (0.19, 0.19, 0.12)
START = np.array([1.0, 2.0, 1.0])
# Surfaces in the middle of voxels of 0.2 m: rooms end at odd multiples of 0.1 m.
ROOM = (-0.1, -0.1, -0.1, 8.1, 4.1, 2.5)
ROOM_M3 = 8.0 * 4.0 * 2.4


def truth(mesh, start=START, voxel_m=0.2):
    return Truth(*mesh, voxel_m, start, HALF)


def voxels(points, voxel_m=0.2):
    return np.floor(np.array(points) / voxel_m).astype(np.int32)


def wall_with_hole(y0, y1, z0, z1):
    """A wall at x = 4 with one hole, as boxes around it."""
    x0, x1, bottom, top, left, right = 3.9, 4.1, -0.1, 2.5, -0.1, 4.1
    return [
        (x0, left, bottom, x1, y0, top),
        (x0, y1, bottom, x1, right, top),
        (x0, y0, bottom, x1, y1, z0),
        (x0, y0, z1, x1, y1, top),
    ]


def test_an_empty_room_is_reachable_up_to_its_walls(mesh_of):
    room = truth(mesh_of([ROOM]))
    # The voxels of the walls themselves do not count: 0.1 m on every side.
    assert room.reachable_m3 == pytest.approx(ROOM_M3, rel=0.01)
    inside = voxels([[0.1, 0.1, 0.1], [7.9, 3.9, 2.3], [4.0, 2.0, 1.0]])
    outside = voxels([[-0.1, 2.0, 1.0], [9.0, 2.0, 1.0], [4.0, 2.0, 2.7], [400.0, 0.0, 0.0]])
    assert room.contains(inside).all()
    assert not room.contains(outside).any()


@pytest.mark.parametrize("voxel_m", [0.05, 0.1, 0.2])
def test_the_volume_approaches_that_of_the_room_as_the_voxels_shrink(mesh_of, voxel_m):
    volume = truth(mesh_of([ROOM]), voxel_m=voxel_m).reachable_m3
    exact = 8.2 * 4.2 * 2.6
    lost = 2 * (8.2 * 4.2 + 8.2 * 2.6 + 4.2 * 2.6) * voxel_m / 2
    assert volume == pytest.approx(exact - lost, rel=0.08)


@pytest.mark.parametrize(("size_m", "passes"), [(0.4, False), (1.2, True)])
def test_a_hole_lets_the_body_through_when_it_is_large_enough(mesh_of, size_m, passes):
    hole = wall_with_hole(2.0 - size_m / 2, 2.0 + size_m / 2, 1.2 - size_m / 2, 1.2 + size_m / 2)
    divided = truth(mesh_of([ROOM, *hole]))
    behind = voxels([[6.0, 2.0, 1.0]])
    assert divided.contains(behind)[0] == passes
    rooms = ROOM_M3 - 0.4 * 4.0 * 2.4  # the wall covers two layers of voxels
    expected = rooms if passes else rooms / 2
    assert divided.reachable_m3 == pytest.approx(expected, rel=0.03)


def test_slanted_walls_are_tight(mesh_of):
    vertices, triangles = mesh_of([ROOM])
    angle = 0.6
    cos, sin = np.cos(angle), np.sin(angle)
    turned = vertices @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    tilted = turned @ np.array(
        [[1.0, 0.0, 0.0], [0.0, np.cos(0.3), np.sin(0.3)], [0.0, -np.sin(0.3), np.cos(0.3)]]
    )
    centre = tilted.mean(axis=0)
    room = truth((tilted.astype(np.float32), triangles), centre)
    assert 0.75 * ROOM_M3 < room.reachable_m3 < ROOM_M3
    far = voxels([centre + np.array([9.0, 0.0, 0.0]), centre + np.array([0.0, 0.0, 5.0])])
    assert not room.contains(far).any()


def test_a_wall_of_one_sheet_divides(mesh_of):
    vertices, triangles = mesh_of([ROOM])
    sheet = np.array([[3.0, -1.0, -1.0], [5.0, 5.0, -1.0], [5.0, 5.0, 3.0], [3.0, -1.0, 3.0]])
    mesh = (
        np.vstack([vertices, sheet]).astype(np.float32),
        np.vstack([triangles, [[8, 9, 10], [8, 10, 11]]]).astype(np.int32),
    )
    divided = truth(mesh)
    assert divided.contains(voxels([[1.0, 2.0, 1.0]]))[0]
    assert not divided.contains(voxels([[7.0, 2.0, 1.0]]))[0]
    assert divided.reachable_m3 == pytest.approx(ROOM_M3 / 2, rel=0.12)


def test_outside_a_room_without_walls_the_world_ends_at_its_bounds(mesh_of):
    floor = mesh_of([(0.0, 0.0, 0.0, 10.0, 8.0, 0.1), (0.0, 0.0, 3.9, 1.0, 1.0, 4.0)])
    yard = truth(floor, np.array([5.0, 4.0, 1.0]))
    assert yard.reachable_m3 < 10.0 * 8.0 * 4.0
    assert yard.reachable_m3 > 0.9 * 10.0 * 8.0 * 3.8
    everywhere = np.stack(np.meshgrid(*[np.arange(-5, 60)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    reached = yard.contains(everywhere.astype(np.int32))
    assert reached.sum() * 0.2**3 == pytest.approx(yard.reachable_m3)
    assert yard.in_bounds(everywhere)[reached].all()


def test_surface_voxels_are_never_free(mesh_of):
    room = truth(mesh_of([ROOM]))
    everywhere = np.stack(np.meshgrid(*[np.arange(-3, 45)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    assert not (room.contains(everywhere) & room.surface(everywhere)).any()
    assert room.surface(voxels([[-0.1, 2.0, 1.0], [4.0, 2.0, 2.5], [8.1, 4.1, 2.5]])).all()
    assert not room.surface(voxels([[4.0, 2.0, 1.0]])).any()


def test_in_bounds_is_the_box_of_the_world(mesh_of):
    room = truth(mesh_of([ROOM]))
    assert room.in_bounds(voxels([[0.0, 0.0, 0.0], [-0.1, -0.1, -0.1], [8.1, 4.1, 2.5]])).all()
    assert not room.in_bounds(voxels([[-0.3, 0.0, 0.0], [8.3, 0.0, 0.0], [0.0, 0.0, 2.7]])).any()


def test_a_start_near_a_wall_moves_to_the_nearest_place_that_fits(mesh_of):
    assert truth(mesh_of([ROOM]), np.array([0.0, 2.0, 1.0])).reachable_m3 == pytest.approx(ROOM_M3, rel=0.01)


@pytest.mark.parametrize("start", [(-3.0, 2.0, 1.0), (50.0, 2.0, 1.0)])
def test_a_start_outside_is_refused(mesh_of, start):
    with pytest.raises(InputError, match="no inside at the start pose"):
        truth(mesh_of([ROOM]), np.array(start))


def test_a_start_in_solid_clutter_is_refused(mesh_of):
    plates = [(-1.0, -1.0, z, 5.0, 5.0, z + 0.1) for z in np.arange(0.0, 2.4, 0.4)]
    with pytest.raises(InputError, match="no inside at the start pose"):
        truth(mesh_of([ROOM, *plates]), np.array([2.0, 2.0, 1.0]))
