"""Posture, tracking and gate together: nothing moves unless all agree."""

from itertools import combinations

import numpy as np
import pytest

from onboard.core.base import STILL, BaseOdometry, BodyVelocity
from onboard.core.config import BaseLink
from onboard.core.geometry import Pose
from onboard.robot.base_control import BaseControl, BaseInputs, PostureAnswer
from onboard.robot.tracker import Stamped, StampedPath, StampedVelocity
from tests.robots import WALKER

PATH = np.array([[0.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
LINK = BaseLink(bridge="ros2dds", settle_s=1.0)
AGREED = PostureAnswer("stand", True, "")


def odometry(stamp_s, linear=(0.0, 0.0, 0.0)):
    zero = np.zeros(3)
    return BaseOdometry(stamp_s, stamp_s, Pose.identity(), np.array(linear), zero, np.eye(6), np.eye(6))


class Bench:
    """A control that is fed every 50 ms, with whatever a test takes away."""

    def __init__(self, gate=lambda now_s, velocity, told: ""):
        self.control = BaseControl(WALKER, LINK, gate)
        self.now_s = 0.0

    def step(
        self,
        without=(),
        posture="stand",
        linear=(0.0, 0.0, 0.0),
        yaw=0.0,
        pitch=0.0,
        answers=(),
        velocity=None,
        also_without=(),
    ):
        self.now_s += 0.05
        without = {*without, *also_without}
        pose = Pose.from_rpy(np.zeros(3), pitch_rad=pitch, yaw_rad=yaw)
        inputs = BaseInputs(
            now_s=self.now_s,
            odometry=[] if "odometry" in without else [odometry(self.now_s, linear)],
            answers=answers,
            where=None if "pose" in without else Stamped(self.now_s, pose),
            path=None if "path" in without else StampedPath(self.now_s, PATH),
            velocity=velocity,
            posture=posture,
        )
        return self.control.step(inputs)

    def stand_up(self, **options):
        assert self.step(**options).request == "stand"
        self.step(answers=[AGREED], **options)
        while self.now_s < 2.0:
            self.step(**options)
        return self

    def run(self, seconds, **options):
        outputs = [self.step(**options) for _ in range(round(seconds / 0.05))]
        return outputs[-1]


def test_stands_up_and_walks():
    bench = Bench().stand_up()
    walking = bench.run(1.5)
    assert walking.halt == ""
    assert walking.velocity.forward_m_s == pytest.approx(0.7)
    assert walking.request is None


def test_does_not_walk_before_it_stands():
    bench = Bench()
    assert bench.step().halt == "not standing"
    assert bench.step(answers=[AGREED]).velocity == STILL
    assert bench.run(0.9).halt == "not standing"
    assert bench.run(0.3).halt == ""


TAKEN = ["odometry", "pose", "path"]


@pytest.mark.parametrize("without", [{name} for name in TAKEN] + [set(p) for p in combinations(TAKEN, 2)])
def test_one_missing_fact_stops_it(without):
    bench = Bench().stand_up()
    bench.run(1.0)
    halted = bench.run(0.4, without=without)
    assert halted.velocity == STILL
    assert halted.halt != ""
    assert bench.run(1.5).velocity.forward_m_s == pytest.approx(0.7)


def test_the_gate_has_the_last_word():
    asked = []

    def gate(now_s, velocity, told):
        asked.append((now_s, velocity, told.stamp_s))
        return "phase is not one to walk in" if now_s > 3.0 else ""

    bench = Bench(gate).stand_up()
    assert bench.run(0.8).halt == ""
    bench.run(0.5)
    assert [bench.step().halt for _ in range(5)] == ["phase is not one to walk in"] * 5
    refused = bench.step()
    assert refused == type(refused)(STILL, None, "phase is not one to walk in")
    assert asked[-1][0] == asked[-1][2] == pytest.approx(bench.now_s)
    assert not asked[-1][1].still


def test_after_a_refusal_it_starts_from_rest():
    bench = Bench(lambda now_s, velocity, told: "no" if 3.0 < now_s < 3.5 else "").stand_up()
    bench.run(1.3)
    speeds = [bench.step().velocity.forward_m_s for _ in range(20)]
    assert 0.0 in speeds
    assert np.diff(speeds).max() <= WALKER.acceleration_m_s2 * 0.05 + 1e-9


def test_sits_down_after_it_has_stopped():
    bench = Bench().stand_up()
    bench.run(1.0, linear=(0.7, 0.0, 0.0))
    wanted = bench.step(posture="sit", linear=(0.6, 0.0, 0.0))
    assert wanted.velocity == STILL
    assert wanted.request is None
    requests = [bench.step(posture="sit").request for _ in range(12)]
    assert requests.count("sit") == 1
    assert requests.index("sit") * 0.05 == pytest.approx(0.45, abs=0.06)


def test_without_odometry_it_is_not_asked_to_sit():
    bench = Bench().stand_up()
    bench.run(0.4, without={"odometry"})
    assert {bench.step(posture="sit", without={"odometry"}).request for _ in range(20)} == {None}
    assert bench.run(0.4, posture="sit").request is None
    assert "sit" in [bench.step(posture="sit").request for _ in range(6)]


def test_drift_across_the_path_is_braked_in_the_maps_frame():
    """The body's velocity is turned into the map: what is forward for the body may be drift for the path."""
    bench = Bench().stand_up()
    along = bench.run(1.5, linear=(0.7, 0.0, 0.0)).velocity.forward_m_s
    across = bench.run(1.5, linear=(0.0, 0.5, 0.0)).velocity.forward_m_s
    assert along == pytest.approx(0.7)
    assert across < 0.1
    turned = Bench().stand_up()
    along_path = (1.4 * np.cos(0.2), -1.4 * np.sin(0.2), 0.0)
    velocity = turned.run(1.5, yaw=0.2, linear=along_path).velocity
    # half of the full speed for being turned by half of what stops it, nothing for drift
    assert np.hypot(velocity.forward_m_s, velocity.left_m_s) == pytest.approx(0.35)


def test_a_posture_that_is_not_named_stays():
    bench = Bench().stand_up()
    assert bench.run(1.0, posture=None).velocity.forward_m_s > 0.5


class TestVelocity:
    """Driven by a planner that closes its own loop."""

    @staticmethod
    def wanted(bench, forward=0.6, left=0.0, turn=0.0, age_s=0.0, **others):
        velocity = StampedVelocity(bench.now_s + 0.05 - age_s, BodyVelocity(forward, left, turn))
        return bench.step(without={"path"}, velocity=velocity, **others)

    def walking(self, seconds=1.5, gate=lambda now_s, velocity, told: "", **options):
        bench = Bench(gate)
        bench.stand_up(without={"path"})
        for _ in range(round(seconds / 0.05)):
            self.wanted(bench, **options)
        return bench

    def test_it_is_passed_on(self):
        bench = self.walking(forward=0.4, left=-0.2, turn=0.3)
        outputs = self.wanted(bench, 0.4, -0.2, 0.3)
        assert outputs.halt == ""
        assert outputs.velocity == BodyVelocity(0.4, -0.2, 0.3)

    def test_speed_and_turning_stay_inside_the_limits(self):
        bench = self.walking(3.0, forward=3.0, left=4.0, turn=-9.0)
        velocity = self.wanted(bench, 3.0, 4.0, -9.0).velocity
        assert np.hypot(velocity.forward_m_s, velocity.left_m_s) <= WALKER.speed_m_s
        assert (velocity.forward_m_s, velocity.left_m_s) == pytest.approx((0.42, 0.56))
        assert velocity.yaw_rate == -WALKER.yaw_rate_rad_s

    def test_it_speeds_up_gently_and_brakes_at_once(self):
        bench = self.walking(0.0)
        speeds = [self.wanted(bench).velocity.forward_m_s for _ in range(20)]
        assert np.diff([0.0, *speeds]).max() <= WALKER.acceleration_m_s2 * 0.05 + 1e-9
        assert speeds[-1] == pytest.approx(0.6)
        assert self.wanted(bench, forward=0.1).velocity.forward_m_s == pytest.approx(0.1)

    def test_the_other_way_begins_from_rest(self):
        bench = self.walking()
        assert self.wanted(bench, forward=-0.6).velocity.forward_m_s == pytest.approx(-0.04)

    @pytest.mark.parametrize("age_s", [0.31, 5.0, -0.05, np.nan])
    def test_stale_or_from_the_future(self, age_s):
        bench = self.walking()
        outputs = self.wanted(bench, age_s=age_s)
        assert (outputs.velocity, outputs.halt) == (STILL, "stale velocity")
        assert 0.0 < self.wanted(bench).velocity.forward_m_s < 0.1

    def test_it_is_good_for_a_little_while(self):
        assert self.wanted(self.walking(), age_s=0.29).velocity.forward_m_s == pytest.approx(0.6)

    @pytest.mark.parametrize("wrong", [np.nan, np.inf])
    @pytest.mark.parametrize("name", ["forward", "left", "turn"])
    def test_numbers_that_are_none(self, name, wrong):
        outputs = self.wanted(self.walking(), **{name: wrong})
        assert (outputs.velocity, outputs.halt) == (STILL, "unusable")

    def test_a_pose_is_needed(self):
        bench = self.walking()
        velocity = StampedVelocity(bench.now_s, BodyVelocity(0.5, 0.0, 0.0))
        assert bench.step(without={"path", "pose"}, velocity=velocity).halt == "stale pose"

    def test_two_masters_are_none(self):
        bench = self.walking()
        velocity = StampedVelocity(bench.now_s, BodyVelocity(0.5, 0.0, 0.0))
        outputs = bench.step(velocity=velocity)
        assert (outputs.velocity, outputs.halt) == (STILL, "path and velocity")

    def test_slower_where_the_body_is_tilted(self):
        assert self.wanted(self.walking(pitch=0.07), pitch=0.07).velocity.forward_m_s == pytest.approx(0.6)
        steep = self.wanted(self.walking(pitch=-0.5), pitch=-0.5).velocity
        assert steep.forward_m_s == pytest.approx(LINK.stairs_speed_m_s)

    def test_it_has_to_stand_and_the_gate_has_the_last_word(self):
        assert self.wanted(Bench()).halt == "not standing"
        refused = self.walking(gate=lambda now_s, velocity, told: "no" if not velocity.still else "")
        assert self.wanted(refused).velocity == STILL
        odometry = self.walking()
        halts = [self.wanted(odometry, also_without={"odometry"}).halt for _ in range(8)]
        assert halts[-1] == "stale odometry"

    def test_from_a_path_to_a_velocity(self):
        bench = Bench().stand_up()
        bench.run(1.5)
        assert self.wanted(bench).velocity.forward_m_s < 0.05
        assert bench.step().velocity.forward_m_s < 0.1
