"""The path tracking core: when it moves, where to, and how fast."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.base import STILL, BodyVelocity
from onboard.core.geometry import Pose, tilt
from onboard.planning.pace import FLAT_RAD, STEEP_RAD, pace
from onboard.robot.pace import slope_limit, slopes_ahead
from onboard.robot.tracker import LEAD_M, STALE_S, BaseTracker, Stamped, StampedPath, aimed
from tests.robots import WALKER

STAIRS_M_S = 0.35
AHEAD = np.array([[0.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
STAIRS = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [6.0, 0.0, 1.8], [9.0, 0.0, 1.8]])


def at(x=0.0, y=0.0, z=0.0, yaw=0.0, pitch=0.0, stamp_s=0.0):
    return Stamped(stamp_s, Pose.from_rpy(np.array([x, y, z]), pitch_rad=pitch, yaw_rad=yaw))


def settled(where, points=AHEAD, now_s=10.0, seconds=1.5, moving=None):
    """The command after `seconds` on the spot: what the ramp of the speed does not hide."""
    tracker = BaseTracker(WALKER, STAIRS_M_S)
    moving = np.zeros(3) if moving is None else moving
    for step in range(round(seconds / 0.05) + 1):
        time_s = now_s + step * 0.05
        drive = tracker.step(
            time_s, replace(where, stamp_s=time_s), StampedPath(time_s, points), True, moving
        )
    return drive


class TestStops:
    def step(self, now_s=10.0, pose_s=10.0, path_s=10.0, standing=True, where=None, points=AHEAD):
        tracker = BaseTracker(WALKER, STAIRS_M_S)
        tracker.step(9.9, at(stamp_s=9.9), StampedPath(9.9, AHEAD), True)
        where = replace(where or at(), stamp_s=pose_s)
        return tracker.step(now_s, where, StampedPath(path_s, points), standing)

    def test_moves_when_all_is_well(self):
        assert self.step().halt == ""
        assert self.step().velocity.forward_m_s > 0

    @pytest.mark.parametrize("age_s", [STALE_S, STALE_S + 1e-6, 5.0, -0.01, np.nan, np.inf, -np.inf])
    def test_stale_and_impossible_stamps(self, age_s):
        assert self.step(path_s=10.0 - age_s).halt == "stale path"
        assert self.step(pose_s=10.0 - age_s).halt == "stale pose"
        assert self.step(path_s=10.0 - age_s).velocity == STILL
        assert self.step(pose_s=10.0 - age_s).velocity == STILL

    @pytest.mark.parametrize("age_s", [0.0, 0.1, STALE_S - 1e-6])
    def test_young_enough(self, age_s):
        assert self.step(path_s=10.0 - age_s, pose_s=10.0 - age_s).halt == ""

    def test_a_clock_that_is_no_number(self):
        assert self.step(now_s=np.nan).velocity == STILL

    def test_nothing_to_follow(self):
        tracker = BaseTracker(WALKER, STAIRS_M_S)
        assert tracker.step(0.0, at(), None, True).halt == "no path"
        assert tracker.step(0.0, at(), StampedPath(0.0, np.zeros((0, 3))), True).halt == "no path"
        assert tracker.step(0.0, None, StampedPath(0.0, AHEAD), True).halt == "stale pose"

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_numbers_that_are_none(self, bad):
        assert self.step(points=np.array([[0.0, 0.0, 0.0], [bad, 0.0, 0.0]])).halt == "unusable"
        assert self.step(where=at(x=bad)).halt == "unusable"
        turned = Stamped(10.0, Pose(np.zeros(3), np.array([0.0, 0.0, bad, 1.0])))
        assert self.step(where=turned).halt == "unusable"

    def test_a_sitting_base_is_not_driven(self):
        assert self.step(standing=False) == self.step(standing=False)
        assert self.step(standing=False).halt == "not standing"
        assert self.step(standing=False).velocity == STILL

    @pytest.mark.parametrize("points", [AHEAD[:1], AHEAD, np.repeat(AHEAD[-1:], 3, axis=0)])
    def test_arrives(self, points):
        drive = self.step(where=at(x=float(points[-1, 0]) - 0.1), points=points)
        assert drive.halt == "arrived"
        assert drive.velocity == STILL

    def test_speeds_up_from_rest_after_every_stop(self):
        tracker = BaseTracker(WALKER, STAIRS_M_S)
        speeds = []
        for step in range(60):
            now_s = step * 0.05
            path_s = now_s if step < 30 or step > 40 else 1.45
            drive = tracker.step(now_s, at(stamp_s=now_s), StampedPath(path_s, AHEAD), True)
            speeds.append(drive.velocity.forward_m_s)
        assert max(speeds[:30]) == pytest.approx(WALKER.speed_m_s)
        assert speeds[36] == 0.0
        gains = np.diff(speeds)
        assert gains.max() <= WALKER.acceleration_m_s2 * 0.05 + 1e-9
        assert speeds[41] == 0.0
        assert speeds[-1] > 0.5


class TestSteering:
    def test_straight_ahead_at_full_speed(self):
        velocity = settled(at()).velocity
        assert velocity.forward_m_s == pytest.approx(WALKER.speed_m_s)
        assert velocity.left_m_s == pytest.approx(0.0)
        assert velocity.yaw_rate == pytest.approx(0.0)

    @pytest.mark.parametrize("side", [0.1, -0.1])
    def test_back_to_the_leg(self, side):
        """Beside the path: towards a point LEAD_M ahead on it, not towards its far end."""
        velocity = settled(at(y=side)).velocity
        bearing = np.arctan2(velocity.left_m_s, velocity.forward_m_s)
        assert bearing == pytest.approx(-np.arctan2(side, LEAD_M), abs=0.01)
        assert np.sign(velocity.yaw_rate) == -np.sign(side)

    @given(st.floats(-np.pi, np.pi))
    @settings(max_examples=40, deadline=None)
    def test_the_body_frame_is_the_bases(self, yaw):
        """Wherever the body points, what it is told is along the path in the world."""
        velocity = settled(at(yaw=yaw), seconds=0.5).velocity
        cos, sin = np.cos(yaw), np.sin(yaw)
        across = sin * velocity.forward_m_s + cos * velocity.left_m_s
        along = cos * velocity.forward_m_s - sin * velocity.left_m_s
        assert across == pytest.approx(0.0, abs=1e-9)
        assert along >= 0.0

    def test_turns_before_it_walks(self):
        velocity = settled(at(yaw=1.2)).velocity
        assert velocity.yaw_rate == pytest.approx(-WALKER.yaw_rate_rad_s)
        assert np.hypot(velocity.forward_m_s, velocity.left_m_s) == pytest.approx(0.0)

    def test_a_leg_that_was_left_is_not_taken_up_again(self):
        """Out and back on the same line: at the same place it goes the way that comes later."""
        points = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 0.2, 0.0], [-2.0, 0.2, 0.0]])
        tracker = BaseTracker(WALKER, STAIRS_M_S)
        path = StampedPath(0.0, points)
        for place in (at(x=3.0), at(x=4.0, y=0.15), at(x=3.0, y=0.2, yaw=np.pi)):
            tracker.step(0.0, place, path, True)
        drive = [
            tracker.step(t, at(x=2.0, y=0.08, yaw=np.pi, stamp_s=t), StampedPath(t, points), True)
            for t in (0.1, 0.2, 0.3)
        ][-1]
        assert drive.velocity.forward_m_s > 0.05

    def test_the_aim_stays_on_the_leg_and_corners_stay_corners(self):
        corner = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.4], [2.0, 2.0, 0.4]])
        assert aimed(np.array([0.5, 0.2, 0.0]), corner)[1] == pytest.approx([1.0, 0.0, 0.2])
        assert aimed(np.array([1.8, 0.1, 0.0]), corner) is corner
        assert aimed(np.array([-3.0, 0.0, 0.0]), corner)[1] == pytest.approx([LEAD_M, 0.0, LEAD_M / 5])
        assert aimed(np.zeros(3), corner[:1]) is not None

    def test_brakes_for_the_end(self):
        speeds = [settled(at(x=x)).velocity.forward_m_s for x in (3.0, 5.5, 5.72)]
        assert speeds == sorted(speeds, reverse=True)
        assert speeds[-1] < 0.5

    @given(
        st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=1, max_size=6),
        st.tuples(*[st.floats(-5, 5)] * 3),
        st.floats(-3.1, 3.1),
        st.tuples(*[st.floats(-1, 1)] * 3),
    )
    @settings(max_examples=60, deadline=None)
    def test_never_outside_its_limits(self, points, place, yaw, moving):
        where = Stamped(0.0, Pose.from_rpy(np.array(place), yaw_rad=yaw))
        velocity = settled(where, np.array(points), seconds=1.0, moving=np.array(moving)).velocity
        assert np.hypot(velocity.forward_m_s, velocity.left_m_s) <= WALKER.speed_m_s + 1e-9
        assert abs(velocity.yaw_rate) <= WALKER.yaw_rate_rad_s + 1e-9


class TestPace:
    def test_between_flat_and_steep(self):
        assert pace(FLAT_RAD, 0.7, 0.35) == pytest.approx(0.7)
        assert pace(-STEEP_RAD, 0.7, 0.35) == pytest.approx(0.35)
        assert pace((FLAT_RAD + STEEP_RAD) / 2, 0.7, 0.35) == pytest.approx(0.525)
        assert pace(1.2, 0.7, 0.35) == pytest.approx(0.35)
        assert pace(1.2, 0.3, 0.35) == pytest.approx(0.3)  # nobody is made faster by stairs

    @pytest.mark.parametrize("points", [STAIRS, STAIRS[::-1]])
    def test_slow_on_stairs_up_and_down(self, points):
        middle = (points[1] + points[2]) / 2
        yaw = 0.0 if points[1, 0] < points[2, 0] else np.pi
        where = at(middle[0], 0.0, middle[2], yaw=yaw)
        assert settled(where, points).velocity.forward_m_s == pytest.approx(STAIRS_M_S)

    def test_slowed_down_in_time(self):
        """Wherever it is, braking at the base's own rate it is as slow as it must be at the first tread."""
        first_tread = 3.0 - WALKER.size_m[0] / 2
        for x in np.arange(0.0, first_tread, 0.1):
            limit = slope_limit(at(x=x).pose, STAIRS, 0.93, 0.7, STAIRS_M_S, 0.8)
            reached = np.sqrt(max(0.0, limit**2 - 2 * 0.8 * (first_tread - x)))
            assert reached <= STAIRS_M_S + 0.01
        assert slope_limit(at(x=0.5).pose, STAIRS, 0.93, 0.7, STAIRS_M_S, 0.8) >= 0.7

    def test_what_has_just_been_climbed_does_not_count(self):
        assert slope_limit(at(x=6.5, z=1.8).pose, STAIRS, 0.93, 0.7, STAIRS_M_S, 0.8) >= 0.7

    def test_the_bodys_own_tilt_counts(self):
        """A flat path and a tilted body: the map is wrong, the body is not."""
        assert settled(at(pitch=-0.5)).velocity.forward_m_s == pytest.approx(STAIRS_M_S)
        assert tilt(at(yaw=2.0, pitch=-0.5).pose) == pytest.approx(0.5)

    def test_a_kerb_is_no_staircase(self):
        kerb = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.05, 0.0, 0.12], [5.0, 0.0, 0.12]])
        steepest = max(abs(slope) for _, slope in slopes_ahead(kerb, 0.93))
        assert steepest == pytest.approx(np.arctan2(0.12, 0.93), abs=0.01)

    def test_short_ways_have_no_slope(self):
        assert slopes_ahead(AHEAD[:1], 0.93) == []
        assert slopes_ahead(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]]), 0.93) == []

    def test_body_velocity_is_its_own_type(self):
        assert isinstance(settled(at()).velocity, BodyVelocity)
