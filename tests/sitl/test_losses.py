"""What happens when something is lost: each test is a row of the failsafe table in docs/safety.md."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from rig import Rig, hold
from vehicles import CARRIER_M, KEY

from drivers.mavlink import commands, modes
from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from drivers.mavlink.signing import Signer
from onboard.autopilot.inputs import Drive, Guidance, Path, Phase, Wish
from onboard.autopilot.settings import FlightSettings

KILLS = 20
DOWN_S = 0.3
"""A service manager waits 0.2 s, and the daemon is up 0.1 s later."""
STRAIGHT = Path(1, ((0.0, 0.0, 2.0), (12.0, 0.0, 2.0)), (3.0, 3.0))


def gap_after(rig: Rig, since_s: float) -> float:
    """Longest silence of the setpoints since then."""
    times = [since_s, *(t for t in rig.sent if t > since_s)]
    return max(b - a for a, b in itertools.pairwise(times))


def test_half_a_second_without_pose_is_survived(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    rig.seeing = False
    far_m = rig.moved(0.5)
    rig.seeing = True
    far_m = max(far_m, rig.moved(4.0))
    assert far_m <= rig.allowed(0.4)
    assert rig.pilot.outputs.phase is Phase.FLYING
    assert rig.link.state.mode == modes.OFFBOARD


def test_five_seconds_without_pose_end_in_a_landing(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    rig.seeing = False
    rig.run(1.6)
    assert rig.said("pose silent") or rig.said("went to AUTO.LAND"), "whoever is first: both wait for 1 s"
    assert not rig.link.streaming
    assert rig.run_until(lambda: rig.link.state.mode == modes.LAND, 1.0)
    rig.run(2.4)
    rig.seeing = True
    sent = len(rig.sent)
    assert rig.landed(20.0)
    rig.run(3.0)
    assert len(rig.sent) == sent, "setpoints came back after a failsafe"


@pytest.mark.parametrize("way", [(2.0, 0.0, 0.0), (-1.2, 1.6, 0.0)])
def test_pose_that_jumps_two_metres_moves_nothing(
    build_rig: Callable[..., Rig], way: tuple[float, float, float]
) -> None:
    rig = build_rig()
    rig.take_off()
    rig.jump = way
    assert rig.moved(6.0) <= rig.allowed(0.3)
    assert rig.said("the pose has jumped")
    assert rig.pilot.outputs.phase is Phase.FLYING
    x, y, z = rig.truth.position
    there = (x + way[0] + 2.0, y + way[1], z)
    path = Path(9, (rig.pilot.core.reference.position, there), (3.0, 3.0))
    rig.guidance = lambda now_s: Guidance(now_s, path)
    assert 1.6 < rig.moved(5.0) < rig.allowed(2.4), "a path of the new map is flown in the new map"


def test_old_path_is_not_flown_after_a_jump(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    said = rig.now_s
    rig.guidance = lambda now_s: Guidance(said, STRAIGHT)
    rig.jump = (2.0, 0.0, 0.0)
    assert rig.moved(1.0) <= rig.allowed(0.3)


def test_planner_that_hangs_means_hold_then_landing(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    rig.guidance = lambda now_s: Guidance(now_s, STRAIGHT)
    rig.run(4.0)
    rig.guidance = lambda now_s: None
    silent_s = rig.now_s
    assert rig.run_until(lambda: rig.pilot.outputs.holding, 1.0)
    assert rig.now_s - silent_s < 0.5
    assert rig.run_until(lambda: not rig.link.streaming, 1.5)
    assert 0.9 < rig.now_s - silent_s < 1.3
    assert rig.run_until(lambda: rig.link.state.mode == modes.LAND, 2.5)
    assert rig.now_s - silent_s < 3.5
    rig.guidance = hold
    sent = len(rig.sent)
    assert rig.landed(20.0)
    rig.run(3.0)
    assert len(rig.sent) == sent, "setpoints came back because the planner did"


def test_twenty_kills_in_flight(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    begin = rig.place()
    worst_m = worst_s = 0.0
    changed = {rig.link.state.mode}
    for _ in range(KILLS):
        killed_s = rig.sent[-1]
        worst_m = max(worst_m, rig.moved(DOWN_S, rig.run_dead))
        rig.start_pilot()
        worst_m = max(worst_m, rig.moved(1.5))
        worst_s = max(worst_s, gap_after(rig, killed_s))
        changed.add(rig.link.state.mode)
        assert rig.pilot.outputs.phase is Phase.FLYING
    assert worst_s <= 0.5
    assert worst_m <= rig.allowed(0.5)
    assert math.dist(begin, rig.place()) <= 0.5, "it has wandered from kill to kill"
    assert changed == {modes.OFFBOARD}


def test_kill_on_the_way_holds_and_does_not_go_on(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    rig.guidance = lambda now_s: Guidance(now_s, STRAIGHT)
    rig.run(5.0)
    rig.run_dead(DOWN_S)
    rig.start_pilot()
    rig.guidance = hold
    assert rig.moved(5.0) < 1.2
    assert rig.drift_m_s() < 0.2


def test_kill_after_a_jump_of_the_map_moves_nothing(build_rig: Callable[..., Rig]) -> None:
    """The process that joined map and vehicle anew is gone, and so is what it knew."""
    rig = build_rig()
    rig.take_off()
    rig.jump = (2.0, 0.0, 0.0)
    rig.run(3.0)
    rig.run_dead(DOWN_S)
    rig.start_pilot()
    assert rig.moved(5.0) <= rig.allowed(0.5)
    assert rig.pilot.outputs.phase is Phase.FLYING


def test_companion_that_stays_dead_ends_in_a_landing(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    dead_s = rig.now_s
    rig.run_dead(20.0)
    assert 0.5 < next(t for t, mode in rig.modes if mode == modes.LAND) - dead_s < 1.6
    assert rig.truth.position[2] < CARRIER_M + 0.15
    rig.start_pilot()
    rig.run(3.0)
    assert rig.link.state.armed is False
    assert not rig.link.streaming


def test_companion_that_comes_back_late_does_not_take_over(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off(4.0)
    rig.run_dead(2.5)
    rig.start_pilot()
    rig.run(1.0)
    assert rig.pilot.outputs.phase is Phase.LOST
    assert not rig.link.streaming
    assert rig.link.state.mode == modes.LAND
    rig.order(Wish.RESUME)
    assert rig.run_until(lambda: rig.pilot.outputs.phase is Phase.FLYING, 4.0), "an explicit order resumes"
    assert rig.link.state.mode == modes.OFFBOARD
    assert rig.moved(4.0) < rig.allowed(0.5)


@pytest.mark.parametrize("seconds", [0.5, 2.0, 3.5])
def test_link_that_is_cut_for_a_while(build_rig: Callable[..., Rig], seconds: float) -> None:
    """Half a second is survived; after a failsafe the stream has ended before the wire is back."""
    rig = build_rig()
    rig.take_off(4.0)
    rig.cut = True
    cut_s = rig.now_s
    rig.run(seconds)
    rig.cut = False
    if seconds < 1.0:
        assert rig.moved(4.0) <= rig.allowed(0.4)
        assert rig.pilot.outputs.phase is Phase.FLYING
        return
    assert not rig.link.streaming
    assert 0.7 < rig.sent[-1] - cut_s < 1.0
    sent = len(rig.sent)
    rig.run(1.0)
    assert rig.link.state.mode == modes.LAND
    assert rig.landed(20.0)
    assert len(rig.sent) == sent


def test_process_that_stood_still_does_not_take_over_again(build_rig: Callable[..., Rig]) -> None:
    """Stopped for longer than the vehicle waits; what it said meanwhile is lost, all senders are fresh."""
    rig = build_rig()
    rig.take_off(4.0)
    rig.run_dead(1.5)
    sent = len(rig.sent)
    rig.run(1.0)
    assert len(rig.sent) == sent
    assert not rig.link.streaming
    assert rig.link.state.mode == modes.LAND


def test_frames_without_the_key_move_nothing(build_rig: Callable[..., Rig]) -> None:
    """Neither the vehicle nor we listen to them, and we count them."""
    rig = build_rig()
    rig.take_off()
    land = commands.command_long((rig.system, 1), commands.LAND, ())
    for signer in (None, Signer(bytes(32), rig.signer.timestamp + 10), Signer(KEY, 1, link_id=9)):
        rig.vehicle.command(Channel(255, 190, signer).pack(land))
        before = rig.link.counts.refused
        forged = Channel(rig.system, 1, signer).pack(message["CURRENT_MODE"](0, modes.LAND, modes.LAND))
        rig.pilot.step(rig.now_s, forged)
        assert rig.link.counts.refused == before + 1
    rig.run(2.0)
    assert rig.link.state.mode == modes.OFFBOARD
    assert rig.pilot.outputs.phase is Phase.FLYING


def test_low_battery_lands_and_stays_down(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig(SIM_BAT_DRAIN=40.0, SIM_BAT_MIN_PCT=0.0)
    rig.take_off()
    assert rig.run_until(lambda: rig.link.state.mode == modes.LAND, 45.0)
    assert rig.link.state.charge is not None
    assert 0.02 < rig.link.state.charge < 0.11, "at 7 %, told once a second"
    rig.run(0.3)
    assert not rig.link.streaming
    assert rig.said("went to AUTO.LAND")
    assert rig.landed(20.0)


def test_fence_is_not_crossed(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.settings = FlightSettings(fence_x_m=(-2.0, 3.0), altitude_m=(0.0, 2.5))
    rig.start_pilot()
    rig.take_off()
    path = Path(1, ((0.0, 0.0, 2.0), (4.0, 0.0, 2.0), (8.0, 0.0, 6.0)), (3.0, 3.0, 3.0))
    rig.guidance = lambda now_s: Guidance(now_s, path)
    far = [0.0]
    rig.run(12.0, lambda: far.append(rig.truth.position[0]))
    assert 2.0 < max(far) < 3.5
    x, y, z = rig.pilot.core.reference.position
    up = Path(2, ((x, y, z), (x, y, z + 4.0)), (3.0, 3.0))
    rig.guidance = lambda now_s: Guidance(now_s, up)
    high = [0.0]
    rig.run(8.0, lambda: high.append(rig.truth.position[2]))
    assert 2.2 < max(high) < 2.8
    rig.guidance = lambda now_s: Guidance(now_s, Drive((1.0, 0.0, 0.5), 0.0, 3.0))
    rig.run(
        8.0,
        lambda: far.append(rig.truth.position[0]),
    )
    assert max(far) < 3.5, "a velocity ends at the fence, too"
    assert rig.truth.position[2] < 2.8
    assert rig.pilot.outputs.phase is Phase.FLYING


def test_path_towards_an_obstacle_ends_before_it(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    points = tuple((float(x), 0.0, 2.0) for x in range(8))
    path = Path(1, points, tuple(max(0.0, 5.0 - x) for x, _, _ in points))
    rig.guidance = lambda now_s: Guidance(now_s, path)
    rig.run(14.0)
    assert 3.3 < rig.truth.position[0] < 4.8


def test_somebody_else_changes_the_mode(build_rig: Callable[..., Rig]) -> None:
    """The operator's tablet lands it: setpoints stop at once and do not come back."""
    rig = build_rig()
    rig.take_off()
    tablet = Channel(255, 190, Signer(bytes(range(32)), rig.signer.timestamp + 10, link_id=7))
    told_s = rig.now_s
    rig.vehicle.command(tablet.pack(commands.command_long((rig.system, 1), commands.LAND, ())))
    rig.run(0.5)
    assert not rig.link.streaming
    assert rig.sent[-1] - told_s < 0.3
    assert rig.pilot.outputs.phase is Phase.LOST
    sent = len(rig.sent)
    assert rig.landed(20.0)
    rig.run(3.0)
    assert len(rig.sent) == sent


def test_velocities_stop_with_their_sender(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    drive = Drive((1.0, 0.0, 0.0), 0.0, 3.0)
    rig.guidance = lambda now_s: Guidance(now_s, drive)
    assert rig.moved(4.0) > 2.0
    rig.guidance = hold
    assert rig.moved(4.0) < 1.5
    assert rig.drift_m_s() < 0.2
