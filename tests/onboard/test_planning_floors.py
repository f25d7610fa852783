"""Heights of floors finer than a voxel, and what a walker makes of ground: a truth table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN
from onboard.planning.floors import LAYERS, NO_LEVEL, Floors, find_floors
from onboard.planning.gait import LEGGED, Slopes, gait_of
from onboard.planning.terrain import walkable
from tests.onboard.floor_scenes import (
    FLOOR_M,
    LOWER,
    SHAPE,
    START,
    VOXEL_M,
    Heights,
    Statuses,
    cell,
    cost_at,
    flat,
    gets_to,
    put,
    ramp,
    stairs,
    walk,
    window_of,
)

BODY_M = (0.93, 0.53, 0.80)


def floors_of(window: Statuses) -> Floors:
    return find_floors(window, LEGGED.clear, int(-LOWER[2]))


def heights_m(floors: Floors) -> np.ndarray:
    """(nx, ny) of the highest floor, metres."""
    return (floors.height[..., 0] + LOWER[2]) * VOXEL_M


def ragged(heights: Heights, seed: int, share: float = 0.1) -> Statuses:
    """Floor voxels moved up or down by one, each with this probability, as decoded keyframes show them."""
    window = window_of(heights)
    rng = np.random.default_rng(seed)
    tops = SHAPE[2] - 1 - np.argmax(window[..., ::-1] == OCCUPIED, axis=2)
    for x, y in np.argwhere(rng.random(SHAPE[:2]) < share):
        top = tops[x, y]
        if rng.random() < 0.5:
            window[x, y, top + 1] = OCCUPIED
        else:
            window[x, y, top - 1 : top + 1] = OCCUPIED, FREE
    return window


def hilly(down: bool = False) -> Heights:
    """A long ramp of 15 degrees."""
    slope = np.tan(np.deg2rad(15.0)) * (-1 if down else 1)
    return lambda x, y: FLOOR_M + slope * np.clip(x - 3.0, 0.0, 3.0)


@dataclass(frozen=True)
class Case:
    """A scene and whether the robot gets to (x, 3, z)."""

    name: str
    window: Statuses
    passes: bool
    x: float = 9.0
    z: float = FLOOR_M


def step_of(height_m: float) -> Heights:
    return lambda x, y: FLOOR_M + height_m * (x > 5.0)


def top_of(slope_deg: float) -> float:
    return FLOOR_M + 3.0 * float(np.tan(np.deg2rad(slope_deg)))


def hole(columns: int, status: int, depth_m: float) -> Statuses:
    """The floor and what is below it is `status` over a few columns across the whole way."""
    return put(window_of(flat), (5.0, 0.0, -depth_m), (5.0 + columns * VOXEL_M, 6.0, 0.2), status)


def beams_only() -> Statuses:
    """Rings of a LiDAR 0.6 m apart on the floor; between them flat beams leave the floor's own voxel free."""
    window = put(window_of(flat), (4.0, 0.0, 0.0), (9.0, 6.0, 0.2), FREE)
    for x in np.arange(4.6, 9.0, 0.8):
        put(window, (float(x), 0.0, 0.0), (float(x) + 0.2, 6.0, 0.2))
    return window


CASES = [
    Case("flat", window_of(flat), True),
    *(Case(f"ramp {deg}", window_of(ramp(deg)), True, z=top_of(deg)) for deg in (10, 20, 30)),
    *(Case(f"ramp {deg}", window_of(ramp(deg)), False, x=8.0, z=top_of(deg)) for deg in (45, 50)),
    Case("kerb", window_of(step_of(0.15)), True, z=FLOOR_M + 0.15),
    Case("kerb downwards", window_of(step_of(-0.15)), True, z=FLOOR_M - 0.15),
    Case("ledge", window_of(step_of(0.4)), False, z=FLOOR_M + 0.4),
    Case("ledge downwards", window_of(step_of(-0.4)), False, z=FLOOR_M - 0.4),
    Case("stairs", window_of(stairs(0.17, 0.29, 8)), True, z=FLOOR_M + 8 * 0.17),
    Case("steep stairs", window_of(stairs(0.25, 0.2, 8)), False, z=FLOOR_M + 2.0),
    Case("drop-off", put(window_of(flat), (6.0, 0.0, -1.0), (12.0, 6.0, 0.2), FREE), False),
    Case("hole in the data", hole(4, UNKNOWN, 1.0), True),
    Case("too wide a hole in the data", hole(5, UNKNOWN, 1.0), False),
    Case("trench", hole(3, FREE, 1.0), False),
    Case("rings of a peer", beams_only(), True),
    Case("low ceiling", put(window_of(flat), (5.0, 0.0, 0.6), (12.0, 6.0, 0.8)), False),
    Case("high ceiling", put(window_of(flat), (5.0, 0.0, 1.0), (12.0, 6.0, 1.2)), True),
    Case("beside a pillar", put(window_of(flat), (6.0, 2.8, 0.0), (6.4, 3.2, 2.0)), True),
    Case("on a pillar's place", put(window_of(flat), (6.0, 2.8, 0.0), (6.4, 3.2, 2.0)), False, x=6.1),
    Case("on a box", put(window_of(flat), (6.0, 2.6, 0.2), (7.0, 3.6, 0.6)), False, x=6.5, z=0.55),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_truth_table_of_ground(case):
    assert gets_to(walk(case.window), case.x, 3.0, case.z) is case.passes


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("heights", [flat, ramp(10), ramp(20), hilly(), hilly(down=True)])
def test_a_ragged_floor_is_walked_like_an_even_one(heights, seed):
    even, torn = walk(window_of(heights)), walk(ragged(heights, seed))
    x, y = np.array([9.0]), np.array([3.0])
    goal = float(heights(x, y)[0])
    assert cost_at(torn, 9.0, 3.0, goal) < 1.35 * cost_at(even, 9.0, 3.0, goal)
    inside = np.s_[12:48, 8:22]
    walked = np.isfinite(torn.lattice.cost[inside]).any(axis=2).mean()
    assert walked > 0.97 * np.isfinite(even.lattice.cost[inside]).any(axis=2).mean()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scene", [step_of(0.6), step_of(-0.6), ramp(50)])
def test_raggedness_opens_no_way(scene, seed):
    goal = float(scene(np.array([9.0]), np.array([3.0]))[0])
    assert not gets_to(walk(ragged(scene, seed)), 9.0, 3.0, goal)


@pytest.mark.parametrize("slope_deg", [5, 10, 20, 30])
def test_heights_on_a_ramp_are_finer_than_voxels(slope_deg):
    surface = ramp(slope_deg)
    floors = floors_of(window_of(surface))
    x = (np.arange(SHAPE[0]) + 0.5) * VOXEL_M
    middle = (x > 4.5) & (x < 6.5)
    truth = surface(x, np.full_like(x, 3.0))[middle]
    raw = (floors.level[:, 15, 0] + LOWER[2] + 0.5)[middle] * VOXEL_M
    fine = heights_m(floors)[middle, 15]
    # a column's floor voxel holds the highest point of the column, the plane passes its middle
    bias = (fine - truth).mean()
    assert abs(bias) < 0.11
    assert (fine - truth).std() < 0.6 * (raw - truth).std() + 0.005
    slopes = floors.slope_x[middle, 15, 0]
    assert slopes == pytest.approx(np.tan(np.deg2rad(slope_deg)), abs=0.25)
    assert slopes.mean() == pytest.approx(np.tan(np.deg2rad(slope_deg)), abs=0.05)
    assert np.abs(floors.slope_y[middle, 15, 0]).max() < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_a_voxel_average_out(seed):
    heights = heights_m(floors_of(ragged(flat, seed)))[2:-2, 2:-2]
    assert np.abs(heights - 0.1).max() < 0.5 * VOXEL_M
    assert (heights - 0.1).std() < 0.1 * VOXEL_M
    spread = floors_of(ragged(flat, seed)).spread[..., 0]
    assert spread.mean() > 5 * floors_of(window_of(flat)).spread[..., 0].mean()


def test_ledges_stay_sharp():
    heights = heights_m(floors_of(window_of(step_of(0.4))))[:, 15]
    assert set(np.round(heights, 3)) == {0.1, 0.5}


def test_a_column_keeps_the_floors_closest_to_the_robot():
    window = np.full((7, 7, 60), FREE, np.uint8)
    window[..., [3, 11, 19, 27, 35, 43, 51]] = OCCUPIED
    levels = find_floors(window, 4, 35).level
    assert (levels == [51, 43, 35, 27]).all()
    assert (find_floors(window, 4, 0).level == [27, 19, 11, 3]).all()
    # too close to the window's top to know whether there is room
    assert (find_floors(window[..., :31], 4, 0).level == [19, 11, 3, NO_LEVEL]).all()


def test_too_few_columns_carry_no_plane():
    window = np.full(SHAPE, UNKNOWN, np.uint8)
    window[20:25, 15, 5] = OCCUPIED  # a row tells nothing about the slope across
    floors = floors_of(window)
    assert (floors.level[..., 0] != NO_LEVEL).sum() == 5
    assert floors.level.shape[2] == LAYERS
    assert not floors.slope_x.any()
    assert not floors.slope_y.any()
    assert (floors.height[20:25, 15, 0] == 5.5).all()


def test_slopes_have_limits_of_their_own_up_down_and_across():
    window = window_of(ramp(25))
    top = np.array([9.0, 3.0, top_of(25)])
    climber = gait_of(BODY_M, 0.25, Slopes(0.6, 0.15, 0.35), VOXEL_M)
    assert gets_to(walk(window, START, climber), *top)
    assert not gets_to(walk(window, top, climber), 2.0)
    assert gets_to(walk(window, top), 2.0)
    weak = gait_of(BODY_M, 0.25, Slopes(0.15, 0.6, 0.35), VOXEL_M)
    assert not gets_to(walk(window, START, weak), *top)
    assert gets_to(walk(window, top, weak), 2.0)


def test_a_hillside_is_not_walked_along_but_straight_up():
    """35 degrees across the way: from the foot of the slope nobody walks along it."""
    window = window_of(lambda x, y: FLOOR_M + np.tan(np.deg2rad(35.0)) * np.clip(y - 2.0, 0.0, 3.0))
    foot = np.array([6.0, 1.0, FLOOR_M])
    terrain = walk(window, foot)
    assert gets_to(terrain, 6.0, 5.5, top_of(35))
    middle, beside = terrain.nodes_at(np.array([[6.1, 3.5, 1.1], [8.1, 3.5, 1.1]]))  # type: ignore[misc]
    assert not np.isfinite(terrain.line_cost(middle, beside))


def test_walking_up_takes_longer_than_walking_level():
    climbing = walk(window_of(ramp(25)))
    length = 4.0 + 3.0 / np.cos(np.deg2rad(25.0))
    assert cost_at(climbing, 9.0, 3.0, top_of(25)) > 1.15 * length
    assert cost_at(walk(window_of(flat)), 9.0) < 1.05 * 7.0


def test_floors_that_only_a_peer_saw_cost_more_and_are_avoided():
    window = window_of(flat)
    floors = floors_of(window)
    peer_only = np.zeros(floors.level.shape, np.uint8)
    peer_only[25:35, 8:] = 1
    root = cell(*START)
    own = walkable(window, floors, LOWER, VOXEL_M, root)
    told = walkable(window, floors, LOWER, VOXEL_M, root, peer_only=peer_only)
    assert cost_at(own, 9.0) < cost_at(told, 9.0) < 1.3 * cost_at(own, 9.0)
    assert cost_at(told, 9.0, 0.9) == pytest.approx(cost_at(own, 9.0, 0.9), rel=0.02)
