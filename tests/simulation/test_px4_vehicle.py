"""The simulated vehicle against what a real PX4 v1.17 did on the wire (docs/autopilot.md)."""

from __future__ import annotations

import math
import time
from statistics import median

import pytest
from px4_bench import FLOWN, NAN, Bench

from drivers.mavlink import modes
from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from drivers.mavlink.signing import Signer
from simulation.px4.vehicle import Px4Vehicle


def test_rates_are_those_of_a_companion_link() -> None:
    bench = Bench()
    bench.run(20.0)
    rates = {name: len(bench.all(name)) / 20.0 for name in {p.get_type() for _, p in bench.heard}}
    wanted = {"ATTITUDE": 100, "HIGHRES_IMU": 50, "ODOMETRY": 30, "LOCAL_POSITION_NED": 30, "TIMESYNC": 10}
    wanted |= {"EXTENDED_SYS_STATE": 5, "SYS_STATUS": 5, "HEARTBEAT": 1, "CURRENT_MODE": 0.5}
    for name, rate in wanted.items():
        assert rates[name] == pytest.approx(rate, rel=0.15), name
    assert "GLOBAL_POSITION_INT" not in rates
    assert "STATUSTEXT" not in rates


def test_ready_and_lift_off_take_their_time() -> None:
    bench = Bench()
    bench.setpoint_hz = 20.0
    ready_s = bench.until(lambda: bench.mode(modes.OFFBOARD) == [0, 0] and bench.arm() == [0], 8.0)
    assert 2.4 < ready_s < 4.5
    armed_s = bench.status.armed_s
    bench.until(lambda: bench.status.landed_state == modes.IN_AIR, 5.0)
    assert bench.now_s - armed_s == pytest.approx(1.95, abs=0.2)
    bench.until(lambda: bench.place[2] < -0.02, 5.0)
    assert bench.now_s - armed_s == pytest.approx(3.27, abs=0.3)
    bench.until(lambda: bench.place[2] < -1.35, 10.0)
    assert 4.5 < bench.now_s - armed_s < 7.5


def test_refusals() -> None:
    bench = Bench()
    bench.vision_hz = 0.0
    bench.run(4.0)
    assert bench.arm() == [1]
    assert "Arming denied: Resolve system health failures first" in bench.events(4.0)
    assert "No valid local position estimate" in bench.events()
    assert bench.mode(modes.OFFBOARD) == [0, 0], "on the ground any mode is taken"
    assert bench.arm() == [1], "and arming then refused"
    assert bench.command(400, 1, system=9) == [], "commands to somebody else have no answer"
    assert bench.command(511, message["HEARTBEAT"].id, 100_000) == [4]
    assert bench.command(31_000) == [3]


def test_loiter_needs_an_origin_and_offboard_needs_setpoints() -> None:
    bench = Bench()
    bench.run(4.0)
    bench.mode(modes.LOITER)
    assert bench.arm() == [1]
    bench.mode(modes.OFFBOARD)
    assert bench.arm() == [1]
    bench.setpoint_hz = 20.0
    bench.run(0.3)
    assert bench.arm() == [0]


def test_mode_change_has_two_acks_and_the_first_always_says_yes() -> None:
    bench = Bench()
    bench.fly()
    assert bench.mode(modes.LOITER) == [0, 1]
    assert bench.status.mode == modes.OFFBOARD
    bench.run(0.2)
    seen = [p.custom_mode for p in bench.all("CURRENT_MODE")]
    assert modes.LOITER not in seen[3:]
    assert bench.mode(modes.LAND) == [0, 0]
    assert bench.all("CURRENT_MODE")[-1].custom_mode == modes.LAND, "sent when it changes"


def test_mode_on_request_comes_with_a_new_status_only_and_with_a_heartbeat_always() -> None:
    bench = Bench()
    bench.run(4.0)
    bench.command(511, message["CURRENT_MODE"].id, 20_000)
    bench.run(0.5)
    begun_s, before = bench.now_s, len(bench.all("CURRENT_MODE"))
    for _ in range(10):
        bench.command(512, message["CURRENT_MODE"].id)
        bench.command(512, message["HEARTBEAT"].id)
        bench.run(0.1)
    told, most = len(bench.all("CURRENT_MODE")) - before, 2 * (bench.now_s - begun_s)
    assert most - 1.5 <= told <= most + 1.5, "twice a second, however often it is wanted"
    assert len(bench.all("HEARTBEAT")) >= 10


@pytest.mark.parametrize(
    ("act", "origin", "mode"),
    [
        (0, False, modes.LAND), (3, False, modes.LAND), (4, False, modes.LAND), (5, False, modes.LAND),
        (0, True, modes.RTL), (3, True, modes.RTL), (5, True, modes.LOITER), (4, True, modes.LAND),
    ],
)  # fmt: skip
def test_setpoints_stop(act: int, origin: bool, mode: int) -> None:
    bench = Bench(COM_OBL_RC_ACT=act)
    bench.fly()
    if origin:
        bench.send(message["SET_GPS_GLOBAL_ORIGIN"](1, 473_977_420, 85_455_940, 489_400, 0))
        bench.run(1.0)
        assert bench.status.mode == modes.OFFBOARD
    bench.setpoint_hz = 0.0
    lost_s = bench.until(lambda: bench.status.mode != modes.OFFBOARD, 3.0)
    assert 1.0 < lost_s < 1.3
    assert bench.status.mode == mode
    bench.run(4.0)
    if mode == modes.RTL:
        assert bench.place[2] < -4.0, "it climbs"


def test_motors_off_in_the_air_when_told_so() -> None:
    bench = Bench(COM_OBL_RC_ACT=7)
    bench.fly()
    bench.setpoint_hz = 0.0
    bench.run(2.5)
    assert not bench.status.armed
    assert bench.place[2] == 0.0


def test_shorter_timeout_of_the_setpoints() -> None:
    bench = Bench(COM_OF_LOSS_T=0.3)
    bench.fly()
    bench.setpoint_hz = 0.0
    assert 0.3 < bench.until(lambda: bench.status.mode != modes.OFFBOARD, 2.0) < 0.6


def test_it_returns_to_offboard_by_itself_even_from_the_ground() -> None:
    bench = Bench()
    bench.fly()
    bench.setpoint_hz = 0.0
    bench.run(1.5)
    bench.setpoint_hz = 20.0
    assert bench.until(lambda: bench.status.mode == modes.OFFBOARD, 2.0) < 0.6
    bench.setpoint_hz = 0.0
    bench.until(lambda: bench.status.landed, 12.0)
    assert bench.status.armed
    bench.setpoint_hz = 20.0
    bench.run(5.0)
    assert bench.place[2] < -0.8, "it takes off again: streams must not come back after a failsafe"


def test_disarm_in_the_air_is_refused_unless_forced() -> None:
    bench = Bench()
    bench.fly()
    assert bench.command(400, 0) == [1]
    assert "Disarming denied: not landed" in bench.events(bench.now_s - 0.2)
    assert bench.command(400, 0, 21196) == [0]
    bench.run(1.5)
    assert bench.place[2] == 0.0


def test_landing_and_disarming() -> None:
    bench = Bench()
    bench.fly()
    bench.command(21)
    assert bench.status.landed_state == modes.LANDING
    down_s = bench.until(lambda: bench.status.landed, 10.0)
    assert 2.5 < down_s < 6.0
    assert bench.until(lambda: not bench.status.armed, 5.0) == pytest.approx(2.0, abs=0.2)
    assert bench.status.mode == modes.OFFBOARD, "back to what was wanted before"


def test_armed_but_not_flown_disarms() -> None:
    bench = Bench(COM_DISARM_PRFLT=10)
    bench.run(4.0)
    bench.setpoint_hz, bench.target = 20.0, (0.0, 0.0, 0.3)
    bench.run(0.6)
    bench.mode(modes.OFFBOARD)
    bench.arm()
    assert bench.until(lambda: not bench.status.armed, 15.0) == pytest.approx(11.0, abs=0.4)


@pytest.mark.parametrize(
    ("hz", "ready"), [(5.0, True), (10.0, True), (50.0, True), (4.0, False), (2.5, False)]
)
def test_vision_is_fused_from_five_hertz_on(hz: float, ready: bool) -> None:
    bench = Bench()
    bench.vision_hz = hz
    bench.run(8.0)
    assert bench.vehicle.autopilot.estimator.heading_stable(bench.now_s) is ready


@pytest.mark.parametrize(("key", "value"), [("estimator", 8), ("frame", 20)])
def test_vision_that_a_px4_does_not_arm_with(key: str, value: int) -> None:
    bench = Bench()
    bench.vision[key] = value
    bench.setpoint_hz = 20.0
    bench.run(8.0)
    bench.mode(modes.OFFBOARD)
    assert bench.arm() == [1]
    if key == "estimator":
        assert "ODOMETRY: unsupported estimator_type 8" in bench.events() or any(
            "unsupported estimator_type" in text for text in bench.events()
        )


def test_jump_of_vision_moves_the_vehicle() -> None:
    bench = Bench()
    bench.fly()
    before, resets = list(bench.place), bench.all("ODOMETRY")[-1].reset_counter
    bench.vision["jump"] = 2.0
    bench.run(8.0)
    assert 1.8 < math.dist(before, bench.place) < 2.3
    assert bench.all("ODOMETRY")[-1].reset_counter == resets + 1
    assert bench.status.mode == modes.OFFBOARD


@pytest.mark.parametrize(("timeout_us", "early_s", "late_s"), [(5_000_000, 4.3, 5.1), (1_000_000, 0.6, 0.9)])
def test_vision_lost(timeout_us: int, early_s: float, late_s: float) -> None:
    bench = Bench(EKF2_NOAID_TOUT=timeout_us)
    bench.command(511, message["ESTIMATOR_STATUS"].id, 200_000)
    bench.fly()
    bench.vision_hz = 0.0
    lost_s = bench.until(lambda: bench.status.mode == modes.LAND, 7.0)
    assert early_s < lost_s < late_s
    flags = [(t, p.flags) for t, p in bench.heard if p.get_type() == "ESTIMATOR_STATUS"]
    assert flags[-1][1] & 256 == 0 or lost_s < 1.0
    bench.run(8.0)
    assert bench.status.landed


def test_without_remote_control_the_factory_action_drifts() -> None:
    bench = Bench(COM_OBL_RC_ACT=0)
    bench.fly()
    bench.vision_hz = 0.0
    bench.until(lambda: bench.status.mode == modes.ALTCTL, 7.0)


def test_range_finder_as_height_is_wrong_on_the_carrier() -> None:
    heights = {}
    for control in (0, 1):
        bench = Bench(lift_m=0.8, EKF2_RNG_CTRL=control)
        bench.run(5.0)
        heights[control] = bench.all("LOCAL_POSITION_NED")[-1].z
    assert heights[0] == pytest.approx(-0.8, abs=0.1)
    assert heights[1] == pytest.approx(-0.11, abs=0.1)


def test_stamps_count_only_after_five_hundred_timesyncs() -> None:
    bench = Bench()

    def answer() -> None:
        for _, packet in bench.heard:
            if packet.get_type() == "TIMESYNC":
                bench.send(message["TIMESYNC"](round((bench.now_s + 1000.0) * 1e9), packet.ts1))
        bench.heard.clear()

    bench.run(40.0, answer)
    assert bench.vehicle.autopilot.estimator.synced_samples < 500
    bench.run(15.0, answer)
    assert bench.vehicle.autopilot.estimator.synced_samples >= 500


def test_fence_without_an_origin_does_nothing() -> None:
    far = {}
    for origin in (False, True):
        bench = Bench(GF_MAX_HOR_DIST=3.0, GF_ACTION=5)
        bench.fly()
        if origin:
            bench.send(message["SET_GPS_GLOBAL_ORIGIN"](1, 473_977_420, 85_455_940, 489_400, 0))
        bench.target = (6.0, 0.0, -1.5)
        bench.run(4.0)
        far[origin] = bench.status.mode
    assert far == {False: modes.OFFBOARD, True: modes.LOITER}


@pytest.mark.parametrize(("act", "mode"), [(0, modes.OFFBOARD), (2, modes.LAND), (3, modes.LAND)])
def test_critical_battery(act: int, mode: int) -> None:
    bench = Bench(COM_LOW_BAT_ACT=act)
    bench.fly()
    bench.vehicle.autopilot.battery.held = True
    bench.vehicle.autopilot.battery.remaining = 0.06
    bench.run(1.0)
    assert bench.status.mode == mode


def test_station_lost_where_it_is_required() -> None:
    bench = Bench(NAV_DLL_ACT=2)
    bench.run(4.0)
    bench.setpoint_hz = 20.0
    bench.run(0.6)
    bench.mode(modes.OFFBOARD)
    assert bench.arm() == [1], "no station was ever heard"
    bench.beat = 6
    bench.run(2.0)
    assert bench.arm() == [0]
    assert bench.all("STATUSTEXT"), "texts are sent once a station was heard"
    bench.run(8.0)
    bench.beat = 18
    bench.until(lambda: bench.status.mode == modes.LOITER, 13.0)
    bench.until(lambda: bench.status.mode == modes.RTL, 7.0)


def test_companion_lost_is_an_event_only() -> None:
    bench = Bench()
    bench.fly()
    bench.beat = None
    bench.run(7.0)
    assert "Connection to mission computer lost" in bench.events()
    assert bench.status.mode == modes.OFFBOARD


def test_setpoints_in_the_bodys_frame() -> None:
    bench = Bench()
    bench.fly()
    bench.setpoint_hz = 0.0
    bench.send(bench.setpoint(frame=8))
    bench.run(0.1)
    assert "SET_POSITION_TARGET_LOCAL_NED: invalid" in bench.events(bench.now_s - 0.2)


# Tracking of a 6 x 4 m rounded rectangle with vision at 20 Hz and 2 cm on a real PX4 (docs/autopilot.md):
# medians of how late and how far beside the path, metres.
MEASURED = {
    (1.0, False): (1.54, 0.12),
    (1.0, True): (0.68, 0.30),
    (2.0, False): (2.80, 0.20),
    (2.0, True): (1.53, 0.44),
}


def rectangle(along: float) -> tuple[float, float, float]:
    """North, east, heading on a rectangle of 6 x 4 m with corners of 0.5 m radius."""
    radius, north, east, heading = 0.5, 0.5, 0.0, 0.0
    arc = math.pi / 2 * radius
    along %= 2 * (5.0 + 3.0) + 4 * arc
    for straight in (5.0, 3.0, 5.0, 3.0):
        step = min(along, straight)
        north, east = north + step * math.cos(heading), east + step * math.sin(heading)
        if along <= straight:
            break
        turn = min(along - straight, arc) / radius
        middle = (north - radius * math.sin(heading), east + radius * math.cos(heading))
        heading += turn
        north, east = middle[0] + radius * math.sin(heading), middle[1] - radius * math.cos(heading)
        if along <= straight + arc:
            break
        along -= straight + arc
    return north, east, heading


@pytest.mark.parametrize(("speed", "feed"), list(MEASURED))
def test_trails_its_setpoints_like_a_real_one(speed: float, feed: bool) -> None:
    bench = Bench(seed=3)
    bench.target = (*rectangle(0.0)[:2], -1.5)
    bench.fly()
    begin_s = bench.now_s
    lap = [rectangle(0.05 * k)[:2] for k in range(400)]
    late, beside = [], []

    def each() -> None:
        north, east, heading = rectangle(speed * (bench.now_s - begin_s))
        bench.target, bench.heading = (north, east, -1.5), heading
        bench.velocity = (speed * math.cos(heading), speed * math.sin(heading), 0.0) if feed else None
        if bench.now_s - begin_s > 2.0:
            late.append(math.dist(bench.place[:2], (north, east)))
            if len(late) % 10 == 0:
                beside.append(min(math.dist(bench.place[:2], corner) for corner in lap))

    bench.run(25.0, each)
    assert median(late) == pytest.approx(MEASURED[speed, feed][0], rel=0.3)
    assert median(beside) == pytest.approx(MEASURED[speed, feed][1], abs=0.16)


def test_same_seed_same_bytes_and_cheap() -> None:
    def flight(seed: int) -> list[float]:
        bench = Bench(seed=seed)
        bench.fly()
        return list(bench.place)

    assert flight(4) == flight(4)
    assert flight(4) != flight(5)
    vehicle = Px4Vehicle(FLOWN)
    begin_s = time.process_time()
    for k in range(1, 601):
        vehicle.step(k * 0.1)
    assert time.process_time() - begin_s < 6.0, "900 s of flight must stay well below a minute"


def test_a_target_of_nothing_is_refused() -> None:
    bench = Bench()
    bench.run(4.0)
    bench.target = (NAN, NAN, NAN)
    bench.send(bench.setpoint())
    bench.run(0.1)
    assert bench.status.target_s == -math.inf


KEY = bytes(range(32))


@pytest.mark.parametrize(
    ("config", "key", "taken"),
    [(2, KEY, True), (2, None, False), (2, bytes(32), False), (0, None, True), (0, bytes(32), True)],
)
def test_who_may_command_a_vehicle_with_a_key(config: int, key: bytes | None, taken: bool) -> None:
    vehicle = Px4Vehicle(FLOWN | {"MAV_SIGN_CFG": config}, key=KEY)
    sender = Channel(1, 191, None if key is None else Signer(key, 10**6))
    order = sender.pack(message["COMMAND_LONG"](1, 1, 512, 0, message["HEARTBEAT"].id, 0, 0, 0, 0, 0, 0))
    answers = Channel(1, 2, Signer(KEY)).receive(vehicle.step(0.01, order) + vehicle.step(0.02, order))
    acks = [packet for packet in answers if packet.get_type() == "COMMAND_ACK"]
    assert bool(acks) is taken
    assert vehicle.counts.refused == (0 if config == 0 else 1 if taken else 2)
    assert len(acks) == (0 if not taken else 2 if config == 0 else 1), "the second is a replay"
