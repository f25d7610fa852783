"""The link to a base: odometry in host time, and both wires over real zenoh sessions on the loopback."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zenoh
from zenoh_waiting import WAIT_S, free_endpoint, until

from drivers.base import QUEUED, BaseCounters, BaseDriver, OdometryReader
from drivers.ros_messages import decode_command, encode_odometry
from drivers.ros_wire import unpack_attachment
from drivers.zenoh_session import close_session, open_session
from onboard.core.base import BaseOdometry, BodyVelocity
from onboard.core.config import BaseLink
from onboard.core.errors import InputError, WireError
from onboard.core.geometry import Pose

BRIDGES = ("ros2dds", "rmw_zenoh")
CLOCKS_APART_S = 1_000_000.0


def odometry(device_s: float, x: float = 0.0) -> BaseOdometry:
    zero = np.zeros(3)
    pose = Pose.from_rpy(np.array([x, 0.0, 0.0]))
    return BaseOdometry(0.0, device_s, pose, zero, zero, np.eye(6), np.eye(6))


def message(device_s: float, x: float = 0.0) -> bytes:
    return encode_odometry(odometry(device_s, x), "odom", "base_link")


class TestReader:
    def test_stamps_are_turned_into_host_time(self):
        reader = OdometryReader(BaseCounters())
        for index in range(20):
            delay_s = 0.002 if index % 5 else 0.030  # held up now and then
            sample = reader.read(message(CLOCKS_APART_S + index * 0.02), index * 0.02 + delay_s)
        assert sample is not None
        assert sample.stamp_s == pytest.approx(19 * 0.02 + 0.002, abs=1e-3)
        assert sample.device_stamp_s == pytest.approx(CLOCKS_APART_S + 19 * 0.02)

    def test_a_stamp_is_never_later_than_the_arrival(self):
        reader = OdometryReader(BaseCounters())
        for index in range(200):
            host_s = index * 0.02 * (1 - 4e-5) + 0.001  # the base's clock is fast
            sample = reader.read(message(index * 0.02), host_s)
            assert sample is None or sample.stamp_s <= host_s

    def test_repetition_and_the_past_are_counted_and_dropped(self):
        counters = BaseCounters()
        reader = OdometryReader(counters)
        assert reader.read(message(5.00), 0.000) is not None
        assert reader.read(message(5.02), 0.020) is not None
        assert reader.read(message(5.02), 0.021) is None
        assert reader.read(message(5.01), 0.022) is None
        assert (counters.odometry, counters.unordered) == (2, 2)

    def test_damage_is_counted(self):
        counters = BaseCounters()
        assert OdometryReader(counters).read(message(1.0)[:-5], 0.0) is None
        assert OdometryReader(counters).read(b"", 0.0) is None
        assert counters.damaged == 2

    def test_a_base_that_starts_anew_is_believed_after_three_samples(self):
        counters = BaseCounters()
        reader = OdometryReader(counters)
        for index in range(10):
            reader.read(message(500.0 + index * 0.02), index * 0.02)
        got = [reader.read(message(3.0 + index * 0.02), 4.0 + index * 0.02) for index in range(5)]
        assert [sample is not None for sample in got] == [False, False, True, True, True]
        assert got[-1] is not None
        assert got[-1].stamp_s == pytest.approx(4.08)


class Robot:
    """The other end: whatever the base's side of the wire sees, in order."""

    def __init__(self, bridge: str, **options: str) -> None:
        self.settings = BaseLink.model_validate(
            {"bridge": bridge, "connect": [free_endpoint()], "mode": "client", **options}
        )
        self.session = open_session("peer", listen=self.settings.connect)
        self.driver = BaseDriver(self.settings)

    def close(self) -> None:
        self.driver.close()
        close_session(self.session)

    def hear(self, key: str) -> zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]:
        return self.session.declare_subscriber(key, zenoh.handlers.FifoChannel(64))


@pytest.fixture
def robot_on():
    robots: list[Robot] = []

    def build(bridge: str, **options: str) -> Robot:
        robots.append(Robot(bridge, **options))
        return robots[-1]

    yield build
    for robot in robots:
        robot.close()


COMMAND_KEYS = {
    "ros2dds": "cmd_vel",
    "rmw_zenoh": "0/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/"
    "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}
ODOMETRY_KEYS = {
    "ros2dds": "odom",
    "rmw_zenoh": "0/odom/nav_msgs::msg::dds_::Odometry_/"
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
}


@pytest.mark.parametrize("bridge", BRIDGES)
def test_commands_arrive_under_the_key_and_with_the_attachment_of_the_wire(robot_on, bridge):
    robot = robot_on(bridge)
    inbox = robot.hear(COMMAND_KEYS[bridge])
    received: list[zenoh.Sample] = []

    def send() -> None:
        robot.driver.send(BodyVelocity(0.5, -0.1, 0.2))
        sample = inbox.try_recv()
        if sample is not None:
            received.append(sample)

    assert until(lambda: len(received) >= 3, send)
    command = decode_command("TwistStamped", received[0].payload.to_bytes())
    assert command.velocity == BodyVelocity(0.5, -0.1, 0.2)
    if bridge == "ros2dds":
        assert received[0].attachment is None
        return
    told = [unpack_attachment(sample.attachment.to_bytes()) for sample in received]
    assert [entry[0] - told[0][0] for entry in told] == [0, 1, 2]
    assert len({entry[2] for entry in told}) == 1


@pytest.mark.parametrize("bridge", BRIDGES)
def test_odometry_arrives(robot_on, bridge):
    robot = robot_on(bridge)
    samples: list[BaseOdometry] = []
    stamp = iter(np.arange(100.0, 1000.0, 1e-4))

    def publish() -> None:
        robot.session.put(ODOMETRY_KEYS[bridge], message(float(next(stamp)), x=7.0))
        samples.extend(robot.driver.poll())

    assert until(lambda: len(samples) > 0, publish)
    assert samples[0].pose.position.tolist() == [7.0, 0.0, 0.0]
    assert samples[0].stamp_s <= time.monotonic()


@pytest.mark.parametrize("bridge", BRIDGES)
def test_a_base_is_asked_to_stand_and_answers(robot_on, bridge):
    robot = robot_on(bridge)
    key = (
        "stand"
        if bridge == "ros2dds"
        else (
            "0/stand/std_srvs::srv::dds_::Trigger_/"
            "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
        )
    )
    asked: list[tuple[bytes, bool]] = []

    def serve(query: zenoh.Query) -> None:
        asked.append((query.payload.to_bytes(), query.attachment is not None))
        query.reply(key, bytes.fromhex("0001000001000000030000006f6b00"))

    robot.session.declare_queryable(key, serve, complete=True)
    robot.driver.request("stand")
    assert robot.driver.answers(WAIT_S) == [("stand", True, "ok")]
    assert asked == [(b"\x00\x01\x00\x00\x00", bridge == "rmw_zenoh")]


def test_no_answer_and_nonsense_are_refusals(robot_on):
    robot = robot_on("ros2dds")
    robot.driver.request("sit")
    (answer,) = robot.driver.answers(WAIT_S)
    assert (answer.posture, answer.ok) == ("sit", False)
    assert "nobody answered" in answer.text
    robot.session.declare_queryable("sit", lambda query: query.reply("sit", b"\x00\x01\x00\x00"))
    robot.driver.request("sit")
    (answer,) = robot.driver.answers(WAIT_S)
    assert not answer.ok
    assert "TriggerReply" in answer.text
    assert robot.driver.answers() == []


def test_a_plain_twist_by_configuration(robot_on):
    robot = robot_on("ros2dds", command_type="Twist", command_topic="spot/cmd_vel", namespace="bot1")
    inbox = robot.hear("bot1/spot/cmd_vel")
    received: list[zenoh.Sample | None] = [None]

    def send() -> None:
        robot.driver.send(BodyVelocity(0.25))
        received[0] = inbox.try_recv()

    assert until(lambda: received[0] is not None, send)
    assert len(received[0].payload.to_bytes()) == 4 + 48
    assert decode_command("Twist", received[0].payload.to_bytes()).velocity == BodyVelocity(0.25)


def test_commands_bear_the_bases_own_time(robot_on):
    robot = robot_on("ros2dds")
    inbox = robot.hear("cmd_vel")
    start_s = time.monotonic()
    stamps: list[float] = []

    def exchange() -> None:
        robot.session.put("odom", message(50_000.0 + time.monotonic() - start_s))
        robot.driver.poll()
        robot.driver.send(BodyVelocity())
        sample = inbox.try_recv()
        if sample is not None and robot.driver.counters.odometry > 3:
            stamps.append(decode_command("TwistStamped", sample.payload.to_bytes()).stamp_s)

    assert until(lambda: any(abs(stamp - 50_000.0) < 60.0 for stamp in stamps), exchange)


def test_a_ros_graph_sees_the_node(robot_on):
    robot = robot_on("rmw_zenoh")
    tokens: list[str] = []

    def look() -> None:
        found = robot.session.liveliness().get("@ros2_lv/0/**", timeout=1.0)
        tokens[:] = [str(reply.ok.key_expr) for reply in found if reply.ok is not None]

    assert until(lambda: len(tokens) >= 5, look)
    kinds = sorted(token.split("/")[5] for token in tokens)
    assert kinds == ["MP", "MS", "NN", "SC", "SC"]
    assert all(token.split("/")[8] == "marsupial" for token in tokens)


def test_of_too_many_samples_the_newest_stay(robot_on):
    robot = robot_on("ros2dds")
    sent = iter(range(1, 100_000))

    def flood() -> None:
        robot.session.put("odom", message(next(sent) * 1e-3))

    assert until(lambda: robot.driver.counters.overflowed > 5, flood)
    assert len(robot.driver.poll()) <= QUEUED


def test_what_is_no_number_is_not_sent(robot_on):
    with pytest.raises(WireError, match="not a number"):
        robot_on("ros2dds").driver.send(BodyVelocity(float("nan")))


def test_a_base_that_is_not_there_is_named():
    endpoint = free_endpoint()
    settings = BaseLink(bridge="ros2dds", connect=(endpoint,))
    with pytest.raises(InputError, match=endpoint):
        BaseDriver(settings)


def test_a_bridge_that_is_restarted_is_found_again(robot_on):
    """Without a word from us: commands arrive again, nothing that was said meanwhile is replayed."""
    robot = robot_on("ros2dds")
    inbox = robot.hear("cmd_vel")
    assert until(lambda: inbox.try_recv() is not None, lambda: robot.driver.send(BodyVelocity(0.1)))
    close_session(robot.session)
    for _ in range(50):
        robot.driver.send(BodyVelocity(0.2))
    robot.session = open_session("peer", listen=robot.settings.connect)
    inbox = robot.hear("cmd_vel")
    received: list[zenoh.Sample | None] = [None]

    def send() -> None:
        robot.driver.send(BodyVelocity(0.3))
        received[0] = inbox.try_recv()

    assert until(lambda: received[0] is not None, send)
    assert decode_command("TwistStamped", received[0].payload.to_bytes()).velocity == BodyVelocity(0.3)


@pytest.mark.parametrize("bad", ["/cmd_vel", "cmd vel", "", "a//b", "cmd_vel/", "a/*"])
def test_names_that_ros_does_not_know_are_refused(bad):
    with pytest.raises(ValueError, match="command_topic"):
        BaseLink.model_validate({"bridge": "ros2dds", "command_topic": bad})
