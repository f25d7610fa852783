"""The simulated base: postures, dead man, odometry; in lock-step, on bytes, and over zenoh."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from zenoh_waiting import free_endpoint, until

from drivers.base import BaseDriver
from drivers.ros_messages import (
    TriggerReply,
    decode_odometry,
    decode_trigger_reply,
    encode_command,
)
from onboard.core.base import BodyVelocity
from onboard.core.config import BaseLink
from onboard.core.geometry import Pose
from onboard.robot.base_control import BaseControl, BaseInputs, PostureAnswer
from onboard.robot.tracker import BaseTracker, Stamped, StampedPath
from simulation.base_node import BaseNode, ZenohBase
from simulation.ground_robot import GroundRobot
from simulation.legged_base import BaseTraits, LeggedBase

DT_S = 0.02
WAIT_MESSAGE_S = 0.2
FLOOR = (-10.0, -10.0, -0.2, 10.0, 10.0, 0.0)
EXACT = BaseTraits(slip=0.0, scale=1.0, turn_drift_rad_m=0.0, noise_m_s=0.0, noise_rad_s=0.0)
DDS = BaseLink(bridge="ros2dds")


class Puck:
    """Goes at once where it is told."""

    def __init__(self) -> None:
        self.pose = Pose.identity()
        self.velocity_m_s = np.zeros(3)

    def step(self, dt_s, velocity_xy, yaw_rate):
        self.velocity_m_s = np.array([*velocity_xy, 0.0])
        place = self.pose.position + self.velocity_m_s * dt_s
        self.pose = Pose.from_rpy(place, yaw_rad=self.pose.yaw + yaw_rate * dt_s)


def standing(traits=EXACT, seed=0):
    base = LeggedBase(Puck(), traits, seed)
    assert base.ask("stand") == (True, "")
    run(base, traits.rise_s + 0.1)
    assert base.posture == "stand"
    return base


def run(base, seconds, velocity=None):
    for _ in range(round(seconds / DT_S)):
        if velocity is not None:
            base.command(velocity)
        base.step(DT_S)


class TestBase:
    def test_it_does_not_walk_sitting_or_rising(self):
        base = LeggedBase(Puck(), EXACT)
        run(base, 1.0, BodyVelocity(0.5))
        base.ask("stand")
        run(base, EXACT.rise_s - 0.1, BodyVelocity(0.5))
        assert base.posture is None
        assert base.walker.pose.position[0] == 0.0
        run(base, 1.0, BodyVelocity(0.5))
        assert base.walker.pose.position[0] > 0.2

    def test_commands_take_effect_late_and_gradually(self):
        base = standing()
        run(base, EXACT.delay_s - DT_S, BodyVelocity(0.5))
        assert not base.walker.velocity_m_s.any()
        run(base, EXACT.lag_s, BodyVelocity(0.5))
        assert 0.2 < base.walker.velocity_m_s[0] < 0.45
        run(base, 1.0, BodyVelocity(0.5))
        assert base.walker.velocity_m_s[0] == pytest.approx(0.5, abs=0.01)

    def test_the_body_frame(self):
        base = standing()
        base.walker.pose = Pose.from_rpy(np.zeros(3), yaw_rad=np.pi / 2)
        run(base, 2.0, BodyVelocity(0.0, 0.3, 0.0))
        assert base.walker.velocity_m_s == pytest.approx([-0.3, 0.0, 0.0], abs=1e-3)

    def test_dead_man(self):
        base = standing()
        run(base, 2.0, BodyVelocity(0.5))
        run(base, EXACT.timeout_s - 0.05)
        assert base.walker.velocity_m_s[0] == pytest.approx(0.5, abs=0.01)
        run(base, 2.0)
        assert not base.walker.velocity_m_s.any()

    def test_a_deaf_base_stops(self):
        base = standing()
        run(base, 1.0, BodyVelocity(0.5))
        base.faults.deaf = True
        run(base, 3.0, BodyVelocity(0.5))
        assert not base.walker.velocity_m_s.any()

    def test_requests_are_refused_with_a_reason(self):
        base = standing()
        run(base, 1.0, BodyVelocity(0.5))
        assert base.ask("sit") == (False, "walking")
        base.faults.refuses = True
        assert base.ask("stand") == (False, "motors are off")

    def test_asking_twice_does_not_start_anew(self):
        base = LeggedBase(Puck(), EXACT)
        base.ask("stand")
        run(base, EXACT.rise_s / 2)
        base.ask("stand")
        run(base, EXACT.rise_s / 2 + 0.1)
        assert base.posture == "stand"

    def test_exact_odometry_tells_the_way(self):
        base = standing()
        run(base, 4.0, BodyVelocity(0.5, 0.0, 0.4))
        told = base.odometry()
        assert told.pose.matrix() == pytest.approx(base.walker.pose.matrix(), abs=1e-6)
        assert told.linear_m_s[0] == pytest.approx(0.5, abs=0.01)
        assert told.angular_rad_s[2] == pytest.approx(0.4, abs=0.01)

    def test_odometry_drifts_and_is_the_same_for_a_seed(self):
        traits = BaseTraits(scale=1.02, turn_drift_rad_m=0.01)
        first, second, other = standing(traits, 3), standing(traits, 3), standing(traits, 4)
        for base in (first, second, other):
            run(base, 10.0, BodyVelocity(0.5))
        told, true = first.odometry().pose, first.walker.pose
        assert np.linalg.norm(told.position) == pytest.approx(1.02 * np.linalg.norm(true.position), rel=0.01)
        assert told.yaw == pytest.approx(0.01 * np.linalg.norm(true.position), abs=0.02)
        assert told.position.tolist() == second.odometry().pose.position.tolist()
        assert told.position.tolist() != other.odometry().pose.position.tolist()

    def test_a_standing_base_tells_rest(self):
        base = standing(BaseTraits())
        run(base, 1.0)
        assert base.odometry().velocity.still
        assert base.odometry().pose.position.tolist() == [0.0, 0.0, 0.0]


class TestNode:
    def test_bytes_in_bytes_out(self):
        node = BaseNode(LeggedBase(Puck(), EXACT), DDS)
        assert decode_trigger_reply(node.serve("stand")) == TriggerReply(True, "")
        told = []
        for _ in range(200):
            node.receive(encode_command("TwistStamped", BodyVelocity(0.5), 0.0, "base_link"), None)
            told += [payload for payload in [node.step(0.01)] if payload is not None]
        assert len(told) == pytest.approx(100, abs=1)
        assert node.counters.commands == 200
        assert decode_odometry(told[-1]).linear_m_s[0] == pytest.approx(0.5, abs=0.05)

    def test_damage_is_counted_and_not_obeyed(self):
        node = BaseNode(standing(), DDS)
        node.receive(b"\x00\x01\x00\x00", None)
        assert (node.counters.damaged, node.counters.commands) == (1, 0)

    def test_rmw_zenoh_drops_what_has_no_attachment(self):
        node = BaseNode(standing(), BaseLink(bridge="rmw_zenoh"))
        payload = encode_command("TwistStamped", BodyVelocity(0.5), 0.0, "base_link")
        node.receive(payload, None)
        assert (node.counters.unattached, node.counters.commands) == (1, 0)
        node.receive(payload, bytes(33))
        assert node.counters.commands == 1

    def test_a_mute_base_tells_nothing(self):
        node = BaseNode(standing(), DDS)
        node.base.faults.mute = True
        assert [node.step(DT_S) for _ in range(20)] == [None] * 20


class Loop:
    """Tracker and simulated base in lock-step, on bytes: a path that is sent until `path_until_s`."""

    def __init__(self, scene, settings, start, traits=None):
        self.robot = GroundRobot(settings, scene, np.array(start), 0.0)
        self.node = BaseNode(LeggedBase(self.robot, traits or BaseTraits()), DDS)
        self.node.serve("stand")
        self.tracker = BaseTracker(settings, DDS.stairs_speed_m_s)
        self.halt = ""
        while self.node.base.posture != "stand":
            self.node.step(DT_S)

    def walk(self, points, seconds, path_until_s=np.inf, pose_until_s=np.inf):
        """Positions (N, 3) at every step."""
        begin_s = self.node.base.clock_s
        places = []
        for step in range(round(seconds / DT_S)):
            now_s = begin_s + step * DT_S
            self._pose = self.robot.pose if now_s - begin_s <= pose_until_s else self._pose
            where = Stamped(min(now_s, begin_s + pose_until_s), self._pose)
            path = StampedPath(min(now_s, begin_s + path_until_s), points)
            drive = self.tracker.step(now_s, where, path, True, self.robot.velocity_m_s)
            self.node.receive(encode_command("TwistStamped", drive.velocity, now_s, "base_link"), None)
            self.node.step(DT_S)
            self.halt = drive.halt
            places.append(self.robot.pose.position)
        return np.array(places)


def speeds_of(places):
    return np.hypot(*np.diff(places[:, :2], axis=0).T) / DT_S


class TestLoop:
    def test_keeps_to_a_path_round_corners(self, scene_of, ground_settings):
        loop = Loop(scene_of([FLOOR]), ground_settings, (-1.0, -4.0, 0.0))
        points = np.array([[-1.0, -4.0, 0.0], [4.0, -4.0, 0.0], [4.0, -1.0, 0.0], [2.0, -2.0, 0.0]])
        places = loop.walk(points, 26.0)
        assert loop.halt == "arrived"
        assert np.linalg.norm(places[-1] - points[-1]) < 0.3
        off = [_off(place, points) for place in places]
        assert np.median(off) < 0.03
        assert max(off) < 0.25

    @pytest.mark.parametrize("lost", ["path_until_s", "pose_until_s"])
    def test_stops_when_path_or_pose_cease(self, scene_of, ground_settings, lost):
        """0.3 s until it is told to stop, then delay, lag and 0.7 m/s at 0.8 m/s2 of braking."""
        loop = Loop(scene_of([FLOOR]), ground_settings, (-8.0, 0.0, 0.0))
        points = np.array([[-8.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
        places = loop.walk(points, 7.0, **{lost: 4.0})
        speeds = speeds_of(places)
        last_s = 4.0
        assert speeds[round((last_s + 0.25) / DT_S)] == pytest.approx(0.7, abs=0.02)
        assert speeds[round((last_s + 0.3 + 0.06 + 0.1) / DT_S)] < 0.68
        assert speeds[round((last_s + 1.6) / DT_S) :].max() == 0.0
        ahead = places[-1, 0] - places[round(last_s / DT_S), 0]
        assert ahead < 0.8

    def test_stairs_are_taken_slowly_and_the_landing_is_reached(self, stairs, ground_settings):
        loop = Loop(stairs(0.17, 0.29, 8), ground_settings, (-2.5, 0.0, 0.0))
        top = 8 * 0.29
        points = np.array([[-2.5, 0.0, 0.0], [0.0, 0.0, 0.0], [top, 0.0, 1.36], [top + 2.5, 0.0, 1.36]])
        places = loop.walk(points, 22.0)
        speeds, x = speeds_of(places), places[1:, 0]
        on_stairs = (x > 0.0) & (x < top - 0.3)
        assert speeds[on_stairs].max() < DDS.stairs_speed_m_s + 0.03
        assert speeds[x < -1.6].max() > 0.6
        assert places[-1, 2] == pytest.approx(1.36, abs=0.01)
        assert loop.halt == "arrived"
        assert loop.robot.collisions == 0


def _off(place, points):
    starts, legs = points[:-1, :2], np.diff(points[:, :2], axis=0)
    along = np.clip(np.einsum("ij,ij->i", place[:2] - starts, legs) / (legs**2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(starts + along[:, None] * legs - place[:2], axis=1).min())


class HearingNode(BaseNode):
    """Tells when a command has arrived."""

    def __init__(self, base, settings):
        super().__init__(base, settings)
        self.heard = threading.Event()

    def receive(self, payload, attachment):
        super().receive(payload, attachment)
        self.heard.set()


class Team:
    """Control, driver and base on two zenoh sessions; time is the base's, messages are waited for."""

    def __init__(self, bridge, settings):
        endpoint = free_endpoint()
        server = BaseLink(bridge=bridge, mode="peer", connect=(), listen=(endpoint,))
        link = BaseLink(bridge=bridge, connect=(endpoint,), settle_s=EXACT.rise_s)
        self.shell = ZenohBase(HearingNode(LeggedBase(Puck(), EXACT), server))
        self.node, self.base = self.shell.node, self.shell.node.base
        self.driver = BaseDriver(link, clock=lambda: self.base.clock_s)
        self.control = BaseControl(settings, link, lambda now_s, velocity, told: "")
        self.posture, self.points = "stand", np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [1.5, 0.5, 0.0]])
        self.halt = ""

    def tick(self):
        """The command arrives before time passes, and the odometry before the next command."""
        now_s = self.base.clock_s
        self.node.heard.clear()
        outputs = self.control.step(
            BaseInputs(
                now_s=now_s,
                odometry=self.driver.poll(0.0 if self.base.faults.mute else WAIT_MESSAGE_S),
                answers=[PostureAnswer(*answer) for answer in self.driver.answers()],
                where=Stamped(now_s, self.base.walker.pose),
                path=StampedPath(now_s, self.points),
                posture=self.posture,
            )
        )
        self.driver.send(outputs.velocity)
        if outputs.request is not None:
            self.driver.request(outputs.request)
        self.node.heard.wait(WAIT_MESSAGE_S)
        self.shell.step(DT_S)
        self.halt = outputs.halt

    def close(self):
        self.driver.close()
        self.shell.close()


@pytest.mark.parametrize("bridge", ["ros2dds", "rmw_zenoh"])
def test_stands_up_walks_and_sits_down_over_zenoh(bridge, ground_settings):
    team = Team(bridge, ground_settings)
    try:
        assert until(lambda: team.base.posture == "stand", team.tick)
        assert until(lambda: team.halt == "arrived", team.tick)
        assert team.base.walker.pose.position == pytest.approx(team.points[-1], abs=0.3)
        team.posture = "sit"
        assert until(lambda: team.base.posture == "sit", team.tick)
        assert team.node.counters.damaged == team.node.counters.unattached == 0
        assert team.driver.counters.damaged == 0
    finally:
        team.close()


def test_a_mute_base_is_not_driven(ground_settings):
    """Odometry ceases: the base is told to stop, though it would still obey."""
    team = Team("ros2dds", ground_settings)
    try:
        team.points = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
        assert until(lambda: team.base.walker.velocity_m_s[0] > 0.6, team.tick)
        team.base.faults.mute = True
        assert until(lambda: team.halt == "stale odometry", team.tick)
        assert until(lambda: not team.base.walker.velocity_m_s.any(), team.tick)
        team.base.faults.mute = False
        assert until(lambda: team.base.walker.velocity_m_s[0] > 0.6, team.tick)
    finally:
        team.close()
