"""Whole missions of the cores in a small room: they deploy, explore, share, meet, with and without radio."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.config import Config
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import OWN, PEER
from onboard.mission import Phase
from onboard.planning.plan import Plan
from onboard.robot.core import RobotCore
from onboard.robot.interface import Inputs, Log
from onboard.robot.map_frame import Told
from simulation.mission import TICK_S, Mission
from tests.simulation.small_mission import EAGER, Event, played, room, team

Played = tuple[Mission, list[Event]]
EVERYWHERE = np.full(3, 100.0)


def both_robots(duration_s: float = 90.0, **radio: float) -> Config:
    return team(mission={"duration_s": duration_s}, deployment=EAGER, radio=radio)


@pytest.fixture(scope="module")
def shared() -> Played:
    """A team whose radio works."""
    return played(both_robots(), room())


@pytest.fixture(scope="module")
def cut_off() -> Played:
    """A team whose radio reaches little farther than the bracket."""
    return played(both_robots(range_m=2.0), room())


@pytest.fixture(scope="module")
def alone() -> Played:
    return played(team("ground", mission={"duration_s": 50.0}), room())


def phases(events: list[Event], robot: str) -> list[str]:
    return [fields["phase"] for _, kind, fields in events if kind == "phase" and fields["robot"] == robot]


def first(events: list[Event], wanted: str) -> Event:
    return next(event for event in events if event[1] == wanted)


def keyframes(mission: Mission, holder: int, source: int) -> dict[int, bytes]:
    store = mission.agents[holder].core.link.store
    wanted = mission.agents[source].settings.id
    return {frame.sequence: frame.payload for frame in store if frame.source == wanted}


def own_volume(mission: Mission, robot: int, source: int) -> int:
    return mission.agents[robot].core.explorer.map.known_count(-EVERYWHERE, EVERYWHERE, source)


def test_the_team_deploys_explores_meets_and_is_done_in_time(shared):
    mission, events = shared
    assert [agent.core.phase for agent in mission.agents] == [Phase.DONE, Phase.DONE]
    assert mission.now_s < 90.0
    assert phases(events, "ground")[0] == "deploying"
    assert phases(events, "aerial")[:3] == ["ready", "taking_off", "exploring"]
    assert phases(events, "ground")[-2:] == ["waiting", "done"]
    assert phases(events, "aerial")[-3:] == ["waiting", "landing", "done"]
    assert first(events, "deploy")[0] <= first(events, "release")[0]


def test_nobody_touched_anything_and_everybody_moved(shared):
    mission, _ = shared
    assert [agent.body.collisions for agent in mission.agents] == [0, 0]
    assert mission.meetings == 0
    assert all(agent.body.path_m > 2.0 for agent in mission.agents)
    assert all(agent.core.motion.stuck_events == 0 for agent in mission.agents)


def test_both_hold_the_same_keyframes_of_everybody(shared):
    mission, _ = shared
    for source, agent in enumerate(mission.agents):
        own = keyframes(mission, source, source)
        assert len(own) == len(agent.core.team.keyframe_positions) >= 1
        assert keyframes(mission, 1 - source, source) == own
        assert agent.core.team.all_received()
        assert agent.core.team.all_shared()
        assert agent.core.sensing.frames_bad == 0


def test_what_the_other_one_saw_is_in_the_map_and_marked_as_such(shared):
    mission, _ = shared
    for robot in (0, 1):
        assert own_volume(mission, robot, OWN) > 5_000
        assert own_volume(mission, robot, PEER) > 5_000


def test_they_meet_within_the_radius_of_the_agreed_point(shared):
    mission, _ = shared
    radius_m = mission.config.mission.regroup_radius_m
    points = [agent.core.role.regroup_point() for agent in mission.agents]
    assert points[0] == pytest.approx(points[1], abs=0.5)  # the carrier brakes while it hands over
    for agent in mission.agents:
        sensor = agent.core.sensing.sensor_pose(agent.pose).position
        assert np.linalg.norm(sensor - points[0]) < radius_m + 0.5


def test_the_same_seed_is_the_same_mission_and_another_one_is_not(shared):
    _, events = shared
    assert played(both_robots(), room())[1] == events
    assert played(both_robots(), room(), seed=7)[1] != events


def test_losing_a_third_of_all_frames_loses_no_keyframe():
    mission, events = played(both_robots(loss=0.33), room(), seed=2)
    assert phases(events, "ground")[-1] == phases(events, "aerial")[-1] == "done"
    assert sum(counters.frames_lost for counters in mission.radio.counters.values()) > 20
    assert keyframes(mission, 0, 1) == keyframes(mission, 1, 1)
    assert keyframes(mission, 1, 0) == keyframes(mission, 0, 0)


def test_without_radio_both_come_back_to_where_they_parted(cut_off):
    mission, events = cut_off
    assert "taking_off" in phases(events, "aerial")
    parted = np.array(first(events, "deploy")[2]["position"])
    for agent in mission.agents:
        assert agent.core.phase in (Phase.WAITING, Phase.DONE)
        assert agent.core.arrived_s is not None
        assert agent.core.arrived_s < 90.0
        sensor = agent.core.sensing.sensor_pose(agent.pose).position
        assert np.linalg.norm(sensor - parted) < mission.config.mission.regroup_radius_m + 0.5


def test_a_robot_that_was_never_heard_of_again_is_not_called_complete(cut_off):
    mission, events = cut_off
    late = [fields for time_s, kind, fields in events if kind == "regroup"]
    assert late == []
    held = keyframes(mission, 0, 1)
    if held != keyframes(mission, 1, 1):
        assert mission.agents[0].core.phase != Phase.DONE


def test_a_ground_robot_without_an_aerial_one_explores_at_once_and_comes_home(alone):
    mission, events = alone
    ground = mission.agents[0]
    assert len(mission.agents) == 1
    assert phases(events, "ground")[-3:] == ["returning", "waiting", "done"]
    assert {"deploying", "carrying"}.isdisjoint(phases(events, "ground"))
    assert np.linalg.norm(ground.pose.position - mission.world.start) < 3.0
    assert ground.core.arrived_s < 50.0
    assert not [event for event in events if event[1] in ("trigger", "deploy", "release")]
    assert ground.body.path_m > 5.0


def test_under_a_low_ceiling_nobody_takes_off_and_both_come_home():
    low = room([(-6.0, -4.0, 1.5, 6.0, 4.0, 1.7)])
    mission, events = played(both_robots(45.0), low)
    reasons = [fields["reason"] for _, kind, fields in events if kind == "trigger"]
    assert reasons[-1] == "take-off space not clear"
    assert mission.agents[1].carried
    assert mission.agents[1].body.path_m == 0.0
    assert mission.agents[0].core.arrived_s is not None
    assert np.linalg.norm(mission.agents[0].pose.position - mission.world.start) < 3.0


def test_the_room_behind_the_partition_is_seen(alone):
    mission, _ = alone
    seen = mission.agents[0].core.explorer.map
    assert seen.known_count([1.0, -3.5, 0.2], [5.5, 3.5, 1.5], OWN) * 0.2**3 > 0.6 * 4.5 * 7.0 * 1.3


def test_one_planning_or_mapping_step_is_timed_per_call(alone):
    times = alone[0].agents[0].core.profile.times_ms
    assert {"plan", "map", "encode"} <= set(times)
    assert all(time_ms >= 0 for kind in times for time_ms in times[kind])


def test_every_planning_cycle_leaves_a_record_of_what_it_weighed(alone):
    cycles = [fields for _, kind, fields in alone[1] if kind == "cycle"]
    assert [fields["cycle"] for fields in cycles] == list(range(1, len(cycles) + 1))
    chosen = [[c for c in fields["candidates"] if c["verdict"] == "chosen"] for fields in cycles]
    assert all(len(one) <= 1 for one in chosen)
    assert any(one and one[0]["gain_m3"] > 1 for one in chosen)
    assert all(fields["reason"] for fields in cycles)


def unheard(kind: str, **fields: object) -> None:
    """A log of nothing."""


def fresh(name: str, log: Log = unheard) -> tuple[RobotCore, Pose]:
    """A core that has not made a step yet."""
    config = both_robots()
    start = Pose.from_rpy(np.array([0.0, 0.0, 0.0 if name == "ground" else 0.95]))
    return RobotCore(config, config.robot(name), 1, start, log, lambda: 0.0), start


def test_a_robot_that_will_be_late_says_so_once_and_takes_it_back():
    told: list[tuple[bool, bool]] = []
    core, start = fresh("ground", lambda kind, **fields: told.append((fields["blocked"], fields["late"])))
    core.explorer.budget.remaining_s = 30.0
    for way_s in (20.0, 31.0, 32.0, 29.0, 10.0):
        core._report_way_back(start, Plan(np.zeros((2, 3)), "route", time_s=way_s))
    core.explorer.way_blocked = True
    core._report_way_back(start, Plan(np.zeros((2, 3)), "route", time_s=40.0))
    assert told == [(False, True), (False, False), (True, True)]


def test_a_carried_robot_keeps_still_and_maps_nothing():
    core, start = fresh("aerial")
    for tick in range(30):
        outputs = core.step(Inputs(tick * TICK_S, Told(start), 1.0))
        assert not outputs.velocity.linear.any()
        assert not outputs.release
    assert core.phase == Phase.CARRIED
    assert not core.maps()
    assert len(core.explorer.map.known_indices()) == 0


def test_garbage_on_the_air_is_counted_and_dropped():
    core, start = fresh("ground")
    rng = np.random.default_rng(3)
    garbage = tuple(rng.bytes(int(size)) for size in rng.integers(0, 300, 50))
    core.step(Inputs(0.0, Told(start), 1.0, None, (b"", *garbage)))
    assert core.link.frames_bad == 51
    assert core.phase == Phase.CARRYING


def test_beacons_tell_where_a_robot_is_and_what_it_does():
    ground, start = fresh("ground")
    aerial, _ = fresh("aerial")
    frames = [
        frame for tick in range(20) for frame in ground.step(Inputs(tick * TICK_S, Told(start), 0.5)).frames
    ]
    aerial.step(Inputs(2.0, Told(start), 1.0, None, tuple(frame for _, frame in frames)))
    status = aerial.link.peer_status(ground.settings.id)
    assert status is not None
    assert Phase(status.phase) == Phase.CARRYING
    assert status.battery_ratio == pytest.approx(0.5, abs=0.01)
    assert status.position_m == pytest.approx((0.0, 0.0, 0.0))
