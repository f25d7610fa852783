"""The mesh that sensors and bodies touch."""

import numpy as np
import pytest

from onboard.core.errors import InputError
from simulation.scene import Scene

ROOM = [(0.0, 0.0, 0.0, 4.0, 3.0, 2.0)]


def test_rays_from_the_middle_of_a_box_meet_its_faces(scene_of):
    directions = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    distances = scene_of(ROOM).cast(np.tile([1.0, 1.0, 0.5], (6, 1)), directions)
    assert distances == pytest.approx([3.0, 1.0, 2.0, 1.0, 1.5, 0.5])
    assert distances.dtype == np.float32


def test_distances_are_in_units_of_the_direction(scene_of):
    assert scene_of(ROOM).cast(np.array([[1.0, 1.0, 1.0]]), np.array([[1.5, 0.0, 0.0]])) == pytest.approx(
        [2.0]
    )


def test_a_ray_that_leaves_the_world_has_no_distance(scene_of):
    assert np.isinf(scene_of(ROOM).cast(np.array([[9.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]))[0])


def test_distance_is_unsigned_inside_and_outside(scene_of):
    points = np.array([[2.0, 1.5, 0.25], [5.0, 1.5, 1.0], [5.0, 4.0, 1.0]])
    assert scene_of(ROOM).distance(points) == pytest.approx([0.25, 1.0, np.sqrt(2.0)])


def test_bounds_ignore_unused_vertices(mesh_of):
    vertices, triangles = mesh_of(ROOM)
    scene = Scene(np.vstack([vertices, [[99.0, 99.0, 99.0]]]), triangles)
    assert scene.lower == pytest.approx([0, 0, 0])
    assert scene.upper == pytest.approx([4, 3, 2])


@pytest.mark.parametrize(
    ("vertices", "triangles", "message"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3)), "at least one triangle"),
        (np.zeros((3, 2)), np.zeros((1, 3)), "vertices"),
        (np.zeros((3, 3)), np.array([[0, 1, 3]]), "0..2"),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), "finite"),
    ],
)
def test_a_broken_mesh_is_refused(vertices, triangles, message):
    with pytest.raises(InputError, match=message):
        Scene(vertices.astype(np.float32), triangles.astype(np.int32))
