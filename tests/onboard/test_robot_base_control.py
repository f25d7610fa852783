"""Posture, tracking and gate together: nothing moves unless all agree."""

from itertools import combinations

import numpy as np
import pytest

from onboard.core.base import STILL, BaseOdometry
from onboard.core.config import BaseLink
from onboard.core.geometry import Pose
from onboard.robot.base_control import BaseControl, BaseInputs, PostureAnswer
from onboard.robot.tracker import Stamped, StampedPath
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

    def step(self, without=(), posture="stand", linear=(0.0, 0.0, 0.0), yaw=0.0, answers=()):
        self.now_s += 0.05
        pose = Pose.from_rpy(np.zeros(3), yaw_rad=yaw)
        inputs = BaseInputs(
            now_s=self.now_s,
            odometry=[] if "odometry" in without else [odometry(self.now_s, linear)],
            answers=answers,
            where=None if "pose" in without else Stamped(self.now_s, pose),
            path=None if "path" in without else StampedPath(self.now_s, PATH),
            posture=posture,
        )
        return self.control.step(inputs)

    def stand_up(self):
        assert self.step().request == "stand"
        self.step(answers=[AGREED])
        while self.now_s < 2.0:
            self.step()
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
