"""A mission's ground robot behind its control, gate, wire and base, in lock-step."""

import numpy as np
import pytest

from onboard.core.config import BaseLink
from onboard.core.geometry import Pose
from onboard.mission import Phase
from onboard.planning.follower import HALT, Velocity
from onboard.safety import NO_BRACKET, STALE_S
from onboard.safety_facts import BaseFacts
from simulation.legged_base import BaseTraits
from simulation.walked import WalkedBase

FLOOR = (-10.0, -10.0, -0.2, 10.0, 10.0, 0.0)
WALL = (2.0, -10.0, 0.0, 2.2, 10.0, 2.0)
TICK_S = 0.1
SURE = {"phase": Phase.EXPLORING, "bracket": NO_BRACKET, "departed": True}
FORWARD = Velocity(np.array([0.5, 0.0, 0.0]), 0.0)


class Mission:
    """Ticks of a mission, with the facts that a test wants."""

    def __init__(self, scene, settings, yaw_rad=0.0, **options):
        self.body = WalkedBase(settings, scene, np.array([-1.0, 0.0, 0.0]), yaw_rad, **options)
        self.ticks = 0

    @property
    def now_s(self):
        return self.ticks * TICK_S

    def tick(self, velocity=FORWARD, believed=None, **facts):
        believed = self.body.pose if believed is None else believed
        told = BaseFacts(now_s=self.now_s, **(SURE | facts))
        self.body.step(self.now_s, TICK_S, velocity, believed, told)
        self.ticks += 1
        return self.body

    def run(self, seconds, *args, **facts):
        for _ in range(round(seconds / TICK_S)):
            self.tick(*args, **facts)
        return self.body


@pytest.fixture
def mission(scene_of, ground_settings):
    return Mission(scene_of([FLOOR]), ground_settings)


def test_stands_when_the_mission_begins(mission):
    assert mission.body.base.posture == "stand"
    assert mission.body.path_m == 0.0
    mission.tick()
    mission.tick()
    assert mission.body.halt == ""
    assert mission.run(0.5).velocity_m_s[0] > 0.1


def test_walks_as_the_planner_wants_a_little_later(mission):
    """0.5 m/s at 0.8 m/s2, and dead time and lag of 0.2 s, cost 0.27 m of 2 m."""
    body = mission.run(4.0)
    assert body.velocity_m_s[0] == pytest.approx(0.5, abs=0.005)
    assert body.pose.position[0] == pytest.approx(-1.0 + 2.0 - 0.27, abs=0.05)
    assert 0.0 < body.pose.position[1] < 0.05
    assert body.path_m == pytest.approx(body.pose.position[0] + 1.0, abs=0.01)
    assert body.battery_left < 1.0
    assert (body.collisions, body.blocked) == (0, False)


def test_a_wrong_belief_turns_the_way(mission):
    """Who believes to look north and wants to go north walks ahead."""
    for _ in range(30):
        here = mission.body.pose
        believed = Pose.from_rpy(here.position, yaw_rad=here.yaw + np.pi / 2)
        mission.tick(Velocity(np.array([0.0, 0.5, 0.0]), 0.0), believed)
    assert mission.body.pose.position[0] > 0.0
    assert abs(mission.body.pose.position[1]) < 0.05


def test_turns_on_the_spot(mission):
    body = mission.run(2.0, Velocity(np.zeros(3), 0.5))
    assert body.pose.yaw == pytest.approx(0.5 * (2.0 - 0.2), abs=0.05)
    assert body.path_m < 0.01


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({"phase": Phase.DEPLOYING}, "phase is not one to walk in"),
        ({"phase": None}, "phase is not one to walk in"),
        ({"departed": False}, "a released robot is still close"),
        ({"bracket": "FIRING"}, "bracket holds a robot and is at work, faulty or unknown"),
        ({"tilt_rad": 0.8}, "tilted too far"),
    ],
)
def test_stops_when_the_gate_refuses(mission, facts, reason):
    assert mission.run(2.0).velocity_m_s[0] > 0.45
    assert mission.tick(**facts).halt == reason
    assert not mission.run(1.5, **facts).velocity_m_s.any()
    assert mission.run(2.0).velocity_m_s[0] > 0.45


def test_an_empty_bracket_does_not_hold_it(mission):
    assert mission.run(2.0, bracket="FAULT", bracket_empty=True).velocity_m_s[0] > 0.45


def test_the_pose_gives_the_tilt(mission):
    leaning = Pose.from_rpy(np.zeros(3), pitch_rad=0.75)
    assert mission.run(1.0, FORWARD, leaning).halt == "tilted too far"


def test_odometry_is_young_and_never_from_the_future(mission):
    for _ in range(100):
        body = mission.tick()
        age_s = mission.now_s - body.odometry.stamp_s
        assert 0.0 < age_s < STALE_S
    assert body.odometry.velocity.forward_m_s == pytest.approx(0.5, abs=0.1)
    assert body.link.node.counters.damaged == body.link.counters.damaged == body.link.counters.unordered == 0
    still = mission.run(2.0, HALT).odometry
    assert np.hypot(*still.linear_m_s[:2]) < 0.05


def test_a_mute_base_is_stopped(mission):
    mission.run(2.0)
    mission.body.base.faults.mute = True
    assert mission.run(0.5).halt == "stale odometry"
    assert not mission.run(1.5).velocity_m_s.any()


def test_a_deaf_base_stops_by_its_dead_man(mission):
    mission.run(2.0)
    mission.body.base.faults.deaf = True
    assert not mission.run(2.5).velocity_m_s.any()


def test_one_that_refuses_to_stand_never_walks(scene_of, ground_settings, monkeypatch):
    monkeypatch.setattr(
        "simulation.legged_base.LeggedBase.ask", lambda self, posture: (False, "motors are off")
    )
    mission = Mission(scene_of([FLOOR]), ground_settings)
    body = mission.run(2.0)
    assert body.halt == "not standing"
    assert body.control.posture.trouble == "motors are off"
    assert body.path_m == 0.0


def test_a_wall_stops_the_body_and_is_counted(scene_of, ground_settings):
    mission = Mission(scene_of([FLOOR, WALL]), ground_settings)
    body = mission.run(8.0)
    assert body.blocked
    assert body.collisions == 1
    assert body.pose.position[0] < 2.0 - 0.93 / 2
    assert body.min_clearance_m < 0.1


def test_slow_where_it_is_steep(ramp, ground_settings):
    """On 25 degrees it walks as on stairs."""
    mission = Mission(ramp(25.0), ground_settings)
    body = mission.run(8.0, Velocity(np.array([0.7, 0.0, 0.0]), 0.0))
    assert 0.5 < body.pose.position[0] < 5.0
    assert np.linalg.norm(body.velocity_m_s) == pytest.approx(0.35, abs=0.03)


def test_the_same_seed_walks_the_same_way(scene_of, ground_settings):
    def end(seed):
        body = Mission(scene_of([FLOOR]), ground_settings, seed=seed).run(3.0)
        return (*body.pose.position, *body.odometry.linear_m_s)

    assert end(1) == end(1)
    assert end(1) != end(2)


@pytest.mark.parametrize("command_type", ["TwistStamped", "Twist"])
def test_any_bridge_is_the_same(scene_of, ground_settings, command_type):
    link = BaseLink(bridge="rmw_zenoh", command_type=command_type, settle_s=1.0)
    settings = ground_settings.model_copy(update={"base": link})
    mission = Mission(scene_of([FLOOR]), settings, traits=BaseTraits(slip=0.0))
    body = mission.run(3.0)
    assert body.link.node.counters.unattached == 0
    assert body.pose.position[0] > 0.0
    assert body.pose.position[1] == pytest.approx(0.0, abs=1e-3)
    assert body.link.node.counters.commands == body.link.counters.sent
    assert mission.tick(HALT).halt == ""
