"""The time budget, travel times with turns, and getting home when the way is blocked."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.config import MapSettings
from onboard.planning.budget import DOCKING_S, SLOWEST, Budget, Pace
from onboard.planning.edges import SLOW, UNTRIED
from onboard.planning.explorer import Explorer
from onboard.planning.global_graph import GlobalGraph
from onboard.planning.homing import DOUBTFUL, FREE_TURN_RAD, stop_short, times_over_graph
from onboard.planning.plan import Plan
from tests.onboard.air_scenes import Corner, hollow, unsurfaced, wall
from tests.onboard.test_planning_deployment import FLYER
from tests.robots import WALKER

seconds = st.floats(0, 1e4)
HOME = np.array([1.0, 1.0, 1.5])
FAR = np.array([19.0, 9.0, 1.5])
RING = (
    ((0.0, 0.0, 0.0), (20.0, 2.0, 3.0)),
    ((18.0, 0.0, 0.0), (20.0, 10.0, 3.0)),
    ((0.0, 8.0, 0.0), (20.0, 10.0, 3.0)),
    ((0.0, 0.0, 0.0), (2.0, 10.0, 3.0)),
)
"""Corridors of 2 m around a block of rock."""


@given(seconds, seconds, seconds)
def test_what_is_affordable_leaves_the_margins_and_the_docking(path_s, back_s, remaining_s):
    budget = Budget.of(FLYER, remaining_s)
    left = remaining_s - path_s - back_s * (1 + FLYER.planner.home_margin_ratio)
    assert budget.affords(path_s, back_s) == (left >= FLYER.planner.home_margin_s + DOCKING_S["aerial"])


@given(seconds)
def test_the_longest_way_is_just_affordable(remaining_s):
    budget = Budget.of(FLYER, remaining_s)
    longest = budget.longest_way_s
    assert longest >= 0
    if longest > 0:
        assert budget.needed(0.0, longest) == pytest.approx(remaining_s)
        assert not budget.affords(0.0, longest + 0.1)


def test_without_an_end_everything_is_affordable_but_nothing_leads_nowhere_in_time():
    assert Budget().affords(1e9, 1e9)
    assert not Budget.of(FLYER, 1e6).affords(0.0, np.inf)


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=3, max_size=8, unique=True))
def test_times_are_those_of_the_ways_and_of_what_their_turns_exceed(corners):
    points = np.column_stack([np.array(corners), np.zeros(len(corners))])
    graph = GlobalGraph(points[0])
    chain = [0]
    for point in points[1:]:
        chain.append(graph._add(point))
        graph.connect(chain[-2], chain[-1])
    times = times_over_graph(graph, (0,), FLYER)
    legs = np.diff(points, axis=0)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    for node in range(len(points)):
        turns = np.abs((np.diff(headings[:node]) + np.pi) % (2 * np.pi) - np.pi)
        lengths = np.linalg.norm(legs[:node], axis=1)
        clear = np.minimum(lengths[1:], lengths[:-1]) >= 0.1
        extra = (np.maximum(turns - FREE_TURN_RAD, 0) * clear).sum()
        assert times[node] == pytest.approx(lengths.sum() / 1.0 + extra / FLYER.yaw_rate_rad_s, abs=1e-6)


@pytest.mark.parametrize(("rise_m", "pace_m_s"), [(0.0, 0.7), (0.4, 0.7), (1.2, 0.35), (-1.2, 0.35)])
def test_a_walking_robot_is_slow_on_slopes_and_a_flying_one_is_not(rise_m, pace_m_s):
    walker = WALKER.model_copy(update={"speed_m_s": 0.7})
    graph = GlobalGraph(np.zeros(3))
    graph.connect(0, graph._add(np.array([3.0, 0.0, rise_m])))
    graph.connect(1, graph._add(np.array([6.0, 0.0, rise_m])))
    ramp_m = float(np.hypot(3.0, rise_m))
    steep = np.interp(np.arctan(abs(rise_m) / 3.0), [0.14, 0.40], [0.7, walker.stairs_speed_m_s])
    assert steep == pytest.approx(pace_m_s, abs=0.03)
    assert times_over_graph(graph, (0,), walker)[1:] == pytest.approx(
        [ramp_m / steep, ramp_m / steep + 3.0 / 0.7]
    )
    assert times_over_graph(graph, (0,), FLYER)[1] == pytest.approx(ramp_m / FLYER.speed_m_s)


def test_a_way_back_that_was_never_gone_counts_as_longer_and_a_gap_not_at_all():
    points = np.array([(0.0, 0.0, 1.0), (3.0, 0.0, 1.0), (6.0, 0.0, 1.0), (9.0, 0.0, 1.0)])
    graph = GlobalGraph(points[0])
    graph.visit(points[1], lambda start, end: True)
    for before, point in enumerate(points[2:], start=1):
        graph.connect(before, graph._add(point))
    graph.verify([], lambda a, b: np.zeros(len(a), bool), lambda a, b: b[:, 0] > 8)
    expected = [0, 3, 3 + 3 * UNTRIED, np.inf]
    assert times_over_graph(graph, (0,), FLYER, cautious=True) == pytest.approx(expected)
    assert times_over_graph(graph, (0,), FLYER) == pytest.approx([0, 3, 6, 9])


def test_the_way_home_is_counted_by_the_trail_where_only_a_gap_is_shorter():
    slit = ((10.8, 1.8, 1.2), (11.6, 8.2, 1.8))  # which just lets the body through
    robot = flown((19.0, 1.0), (19.0, 9.0), (11.2, 9.0), rooms=(*RING, slit))
    here = robot.graph.points[robot.graph.here].copy()
    around_s = robot.return_time(here)
    shaft = np.array([here, (here[0], 1.4, 1.5)])
    robot.graph.join(shaft, robot.graph.nearest(np.array([here[0], 1.0, 1.5]))[0], lambda a, b: True)
    robot.verify_ways()
    assert robot.return_time(here) == pytest.approx(around_s, abs=0.5)
    assert robot._over_graph(here, HOME, 2.0)[:, 0].max() > 17.0
    robot.budget.remaining_s = around_s - 5.0  # too late for the way around: what is left is the slit
    assert robot._over_graph(here, HOME, 2.0)[:, 0].max() < 12.0
    robot.budget.remaining_s = 5.0  # too late for everything: no going to and fro between the two
    assert robot._over_graph(here, HOME, 2.0)[:, 0].max() > 17.0
    wall(robot.map, (10.8, 4.0, 1.2), (11.6, 4.4, 1.8))
    robot.budget.remaining_s = around_s - 5.0  # the slit is closed: late is better than never
    assert robot._over_graph(here, HOME, 2.0)[:, 0].max() > 17.0
    assert not robot.way_blocked


@given(st.lists(st.tuples(st.floats(0.05, 2.0), st.floats(-1.0, 3.0)), max_size=300))
def test_the_pace_is_a_factor_between_one_and_its_limit(steps):
    pace = Pace()
    for actual_s, nominal_s in steps:
        pace.observe(actual_s, nominal_s)
        assert 1.0 <= pace.ratio <= SLOWEST


def test_the_pace_follows_what_the_robot_does_and_the_budget_follows_the_pace():
    budget = Budget.of(FLYER, 1000.0)
    before, longest = budget.needed(20.0, 50.0), budget.longest_way_s
    for _ in range(3000):
        budget.pace.observe(0.1, 0.08)
    assert budget.pace.ratio == pytest.approx(1.25, abs=0.07)
    margins = FLYER.planner.home_margin_s + DOCKING_S["aerial"]
    assert budget.needed(20.0, 50.0) - margins == pytest.approx((before - margins) * budget.pace.ratio)
    assert budget.longest_way_s == pytest.approx(longest / budget.pace.ratio)
    for _ in range(3000):
        budget.pace.observe(0.1, 0.1)
    assert budget.pace.ratio == pytest.approx(1.0, abs=0.01)


def flown(
    *corners: tuple[float, float],
    remaining_s: float = np.inf,
    rooms: tuple[tuple[Corner, Corner], ...] = RING,
) -> Explorer:
    """A flying robot that went along these corners from HOME, and has to be back there."""
    robot = Explorer(FLYER, MapSettings(), seed=1)
    robot.map = hollow(*rooms)
    robot.begin(HOME, 0.0)
    robot.budget.back_to, robot.budget.remaining_s = HOME, remaining_s
    at = HOME
    for x, y in corners:
        end = np.array([x, y, 1.5])
        for share in np.arange(0.0, 1.0, 0.3 / np.linalg.norm(end - at)):
            robot.observe(at + share * (end - at))
        at = end
    robot.observe(at)
    robot.verify_ways()
    return robot


def test_a_blocked_way_home_is_flown_around_and_its_length_counts_at_once():
    robot = flown((19.0, 1.0), (19.0, 9.0), (1.0, 9.0), (1.0, 1.4), (1.0, 9.0), (19.0, 9.0), (19.0, 5.0))
    here = np.array([19.0, 5.0, 1.5])
    direct_s = robot.return_time(here)
    assert direct_s == pytest.approx(22.0, abs=4.0)
    wall(robot.map, (8.0, 0.0, 0.0), (8.4, 2.0, 3.0))
    robot.verify_ways()
    around_s = robot.return_time(here)
    assert around_s == pytest.approx(30.0, abs=6.0)
    assert around_s > direct_s + 4
    path = robot.go_to(here, HOME).path
    assert len(path) > 2
    assert path[:, 1].max() > 8.0
    assert not robot.way_blocked
    assert not robot.path_blocked(path, np.inf)


def test_what_stands_in_the_way_but_leaves_room_is_passed_locally():
    robot = flown((16.0, 1.0), rooms=(((0.0, -2.0, 0.0), (20.0, 4.0, 3.0)),))
    wall(robot.map, (7.0, 0.6, 0.0), (7.4, 1.4, 3.0))
    plan = robot.go_to(np.array([16.0, 1.0, 1.5]), HOME)
    assert plan.kind == "route"
    assert not robot.way_blocked
    assert not robot.path_blocked(plan.path, np.inf)


def test_where_nothing_leads_around_the_robot_says_so_and_has_turned_back_in_time():
    robot = flown((19.0, 1.0), (19.0, 9.0), remaining_s=200.0)
    here = Plan(FAR[None], "here")
    assert robot.affordable(here)
    wall(robot.map, (8.0, 0.0, 0.0), (8.4, 2.0, 3.0))
    robot.verify_ways()
    blocked_s = robot.return_time(FAR)
    assert blocked_s > 26.0 + (SLOW - 1) * 0.9  # what looks blocked is not counted as free
    plan = robot.go_to(FAR, HOME)
    assert robot.way_blocked
    assert len(plan.path) > 0  # as near as it gets; the monitor stops it in front of the wall
    assert robot.path_blocked(plan.path, np.inf)
    robot.budget.remaining_s = robot.budget.needed(0.0, blocked_s) - 0.1
    assert not robot.affordable(here)


def test_a_way_that_only_the_map_knew_is_no_way_when_it_is_blocked():
    robot = flown((5.0, 1.0))
    robot.graph.add_path(np.array([(5.0, 1.0, 1.5), (14.0, 1.0, 1.5)]), robot.visible)
    target = np.array([14.0, 1.0, 1.5])
    assert np.isfinite(robot.times_to(np.array([5.0, 1.0, 1.5]), target[None])[0])
    wall(robot.map, (8.0, 0.0, 0.0), (8.4, 2.0, 3.0))
    robot.verify_ways()
    assert np.isinf(robot.times_to(np.array([5.0, 1.0, 1.5]), target[None])[0])
    assert np.isinf(robot.time_through(np.array([5.0, 1.0, 1.5]), np.stack([target, HOME])))


def test_a_meeting_point_behind_a_gap_is_not_chosen_but_when_it_is_one_the_robot_has_not_come_too_late():
    slit = ((10.8, 1.8, 1.2), (11.6, 8.2, 1.8))  # which just lets the body through
    north = ((0.0, 8.0, 0.0), (20.0, 10.0, 3.0))
    robot = flown((11.2, 1.0), rooms=(RING[0], slit, north), remaining_s=800.0)
    here, behind = robot.graph.points[robot.graph.here].copy(), np.array([11.2, 9.0, 1.5])
    robot.graph.add_path(np.array([here, (11.2, 1.8, 1.5), (11.2, 8.2, 1.5), behind]), lambda a, b: True)
    robot.verify_ways()
    assert np.isinf(robot.times_to(here, behind[None])[0])
    robot.budget.back_to = behind
    assert robot.return_time(here) == pytest.approx(DOUBTFUL * 8.0, abs=2.5)
    assert robot.affordable(Plan(here[None], "here"))


HAIRPIN = (
    ((0.0, 0.0, 0.0), (20.0, 2.0, 3.0)),
    ((18.0, 0.0, 0.0), (20.0, 4.4, 3.0)),
    ((0.0, 2.4, 0.0), (20.0, 4.4, 3.0)),
)
"""Two corridors with 0.4 m of rock between them, joined at their far end."""


def test_a_place_next_to_home_behind_a_wall_is_as_far_as_the_way_around():
    robot = flown((19.0, 1.0), (19.0, 3.4), (1.0, 3.4), rooms=HAIRPIN)
    here = np.array([1.0, 3.4, 1.5])
    assert np.linalg.norm(here - HOME) < 2.5
    assert robot.return_time(here) > 36.0
    assert robot.times_to(here, HOME[None], 2.5)[0] > 36.0
    assert robot.time_through(here, np.stack([FAR * (1, 0, 1) + (0, 1, 0), HOME]), 2.5) > 36.0
    plan = robot.go_to(here, HOME)
    assert plan.path[:, 0].max() > 17.0
    assert np.linalg.norm(plan.goal - HOME) < 2.0


def test_a_place_above_home_is_far_when_nothing_is_known_between():
    storeys = (
        ((0.0, 0.0, 0.0), (20.0, 2.0, 3.0)),
        ((18.0, 0.0, 0.0), (20.0, 2.0, 6.4)),
        ((0.0, 0.0, 3.4), (20.0, 2.0, 6.4)),
    )
    robot = flown((19.0, 1.0), rooms=storeys)
    robot.map = unsurfaced(*storeys)
    for step in (
        *((19.0, z) for z in np.arange(1.5, 4.1, 0.3)),
        *((x, 4.0) for x in np.arange(19.0, 1.0, -0.3)),
    ):
        robot.observe(np.array([step[0], 1.0, step[1]]))
    here = np.array([1.0, 1.0, 4.0])
    assert np.linalg.norm(here - HOME) < 2.6
    assert robot.return_time(here) > 36.0


def test_the_way_back_is_not_counted_through_walls():
    robot = flown((19.0, 1.0))
    behind = np.array([10.0, 9.0, 1.5])  # 8 m from the trail, in the other corridor
    assert np.isinf(robot.return_time(behind))
    wall(robot.map, (0.0, 2.0, 0.0), (20.0, 2.4, 3.0))
    assert np.isinf(robot.return_time(np.array([10.0, 3.2, 1.5])))


def test_a_flying_robot_that_plans_its_last_metres_again_and_again_does_not_climb_on():
    robot = flown((8.0, 1.0), rooms=(((0.0, 0.0, 0.0), (20.0, 2.0, 6.0)),))
    here, heights = np.array([4.0, 1.0, 1.0]), []
    for _ in range(5):
        plan = stop_short(robot.go_to(here, HOME), HOME, 2.0, robot.visible)
        here = plan.goal
        heights.append(here[2])
    assert heights[-1] == pytest.approx(HOME[2] + 1.0, abs=0.3)
    assert max(heights) < HOME[2] + 1.3


def test_a_way_that_ends_beside_its_target_is_gone_to_its_end():
    robot = flown((8.0, 1.0))
    beside = Plan(np.array([[8.0, 1.0, 1.5], [2.8, 1.0, 1.5]]), "route")
    for distance_m, end_x in ((0.5, 2.8), (1.8, 2.8), (2.6, 3.6)):
        assert stop_short(beside, HOME, distance_m, robot.visible).path[1, 0] == pytest.approx(end_x)


def test_visiting_two_places_takes_the_ways_between_them():
    robot = flown((19.0, 1.0))
    here = np.array([19.0, 1.0, 1.5])
    there_and_back = robot.time_through(here, np.stack([HOME, here]))
    assert there_and_back == pytest.approx(36.0, abs=1.5)
    assert robot.time_through(here, HOME[None]) == pytest.approx(18.0, abs=1.0)
