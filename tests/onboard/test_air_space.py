"""Where a body may fly: edges against brute force, floods, and paths moved off the walls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import FREE, VoxelMap
from onboard.planning.air_space import AirSpace, air_space, least_on_segments
from onboard.planning.local_graph import polyline_length
from onboard.planning.refine import refined
from tests.onboard.air_scenes import hollow

SETTINGS = PlannerSettings(window_m=(10.0, 10.0, 6.0), vertices=300)


def random_segments(rng: np.random.Generator, count: int, low: float, high: float) -> np.ndarray:
    """(2, N, 3): any direction, along the axes, in the planes of the grid, and of no length."""
    ends = rng.uniform(low, high, (2, count, 3))
    kind = rng.integers(0, 6, count)
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        ends[1][np.ix_(kind == axis, others)] = ends[0][np.ix_(kind == axis, others)]
    ends[1][kind == 3] = ends[0][kind == 3]
    ends[:, kind == 4] = np.round(ends[:, kind == 4])
    return ends


def voxels_met(start: np.ndarray, end: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Brute force over all voxels: those crossed over some length or holding an end, and those touched."""
    cells = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    delta = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (cells - start) / delta, (cells + 1 - start) / delta
    still = delta == 0
    within = (cells <= start) & (start <= cells + 1)
    low = np.where(still, np.where(within, -np.inf, np.inf), np.minimum(first, second)).max(axis=1)
    high = np.where(still, np.where(within, np.inf, -np.inf), np.maximum(first, second)).min(axis=1)
    low, high = np.maximum(low, 0), np.minimum(high, 1)
    inner = (np.where(still, (cells < start) & (start < cells + 1), True)).all(axis=1)
    holds = (np.floor(start) == cells).all(axis=1) | (np.floor(end) == cells).all(axis=1)
    return cells[((low < high - 1e-9) & inner) | holds], cells[low <= high + 1e-9]


def test_an_edge_meets_the_same_voxels_as_brute_force_finds():
    rng = np.random.default_rng(4)
    size = 9
    values = rng.integers(1, 500, (size, size, size)).astype(np.int16)
    starts, ends = random_segments(rng, 2000, 0.0, size - 0.6)
    found = least_on_segments(values, starts, ends)
    for n in range(len(starts)):
        crossed, touched = voxels_met(starts[n], ends[n], size)
        assert values[tuple(touched.T)].min() <= found[n] <= values[tuple(crossed.T)].min()


def test_an_edge_that_leaves_the_window_is_not_free():
    values = np.full((4, 4, 4), 9, np.int16)
    starts = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [-0.5, 1.0, 1.0]])
    ends = np.array([[4.0, 1.0, 1.0], [3.99, 1.0, 1.0], [2.0, 1.0, 1.0]])
    assert least_on_segments(values, starts, ends).tolist() == [0, 9, 0]


def random_room(seed: int, blocks: int = 60) -> VoxelMap:
    rng = np.random.default_rng(seed)
    voxel_map = hollow(((0, 0, 0), (8, 8, 4)))
    voxel_map.assume_occupied(rng.uniform(0, 8, (blocks, 3)) * [1, 1, 0.5])
    return voxel_map


@pytest.mark.parametrize("body_m", [(0.38, 0.38, 0.24), (0.9, 0.5, 0.3), (0.2, 0.2, 0.2), (1.3, 1.3, 0.2)])
def test_no_flight_that_is_called_free_touches_anything(body_m):
    """The map's own swept box, which errs on the safe side only, agrees with every free edge."""
    rng = np.random.default_rng(5)
    voxel_map = random_room(1, 25)
    space = air_space(voxel_map, np.array([4.0, 4.0, 2.0]), SETTINGS, body_m)
    allowed = space.places(np.argwhere(space.squared > 0))
    chosen = allowed[rng.integers(0, len(allowed), 4000)] + rng.uniform(-0.1, 0.1, (4000, 3))
    ends = chosen + random_segments(rng, 4000, -1.0, 1.0)[1]
    free = space.segment_clearance(chosen, ends) > 0
    assert 200 < free.sum() < 3800
    half = np.array(body_m) / 2 - 1e-6
    steps = np.linspace(0, 1, 60)[:, None]
    for start, end in zip(chosen[free][:700], ends[free][:700], strict=True):
        assert (voxel_map.box_status(start + steps * (end - start), half) == FREE).all()


def test_the_flood_stays_in_one_room():
    space = air_space(
        hollow(((0, 0, 0), (3, 3, 3)), ((4, 0, 0), (8, 3, 3))),
        np.array([1.5, 1.5, 1.5]),
        SETTINGS,
        (0.38, 0.38, 0.24),
    )
    places = space.places(space.reachable_cells(np.array([1.5, 1.5, 1.5])))
    assert len(places) > 200
    assert places[:, 0].max() < 3.0
    assert len(np.unique(places, axis=0)) == len(places)
    assert len(space.reachable_cells(np.array([3.5, 1.5, 1.5]))) == 0


def random_flight(space: AirSpace, rng: np.random.Generator) -> np.ndarray:
    """A free polyline of a few corners."""
    first = space.places(np.argwhere(space.squared > 0)[:1])[0]
    cells = space.reachable_cells(first)
    path = [space.places(cells[:1])[0]]
    for place in space.places(cells[rng.integers(0, len(cells), 60)]):
        if space.segment_clearance(path[-1][None], place[None])[0] > 0:
            path.append(place)
    return np.array(path[:6])


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_refining_never_comes_closer_to_anything_and_keeps_the_ends(seed):
    rng = np.random.default_rng(seed)
    space = air_space(random_room(seed), np.array([4.0, 4.0, 2.0]), SETTINGS, (0.38, 0.38, 0.24))
    path = random_flight(space, rng)
    if len(path) < 2:
        return
    result = refined(space, path)
    before = space.segment_clearance(path[:-1], path[1:]).min()
    assert space.segment_clearance(result[:-1], result[1:]).min() >= before > 0
    assert np.array_equal(result[[0, -1]], path[[0, -1]])
    assert polyline_length(result) <= 1.15 * polyline_length(path) + 1e-9


def test_refining_pulls_a_flight_off_a_wall():
    space = air_space(hollow(((0, 0, 0), (8, 8, 4))), np.array([4.0, 4.0, 2.0]), SETTINGS, (0.38, 0.38, 0.24))
    path = np.array([[1.1, 1.5, 2.0], [4.0, 0.5, 2.0], [6.9, 1.5, 2.0]])
    result = refined(space, path)
    legs = space.segment_clearance(path[:-1], path[1:])
    assert legs.min() < 0.7
    assert space.segment_clearance(result[:-1], result[1:]).min() > legs.min() + 0.15


def test_what_has_room_is_left_as_it_is():
    space = air_space(hollow(((0, 0, 0), (8, 8, 4))), np.array([4.0, 4.0, 2.0]), SETTINGS, (0.38, 0.38, 0.24))
    path = np.array([[3.0, 3.0, 2.0], [5.0, 3.0, 2.0], [5.0, 5.0, 2.0]])
    assert np.array_equal(refined(space, path), path)
