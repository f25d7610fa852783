"""Missions whose bracket fails, or whose take-off does: nobody is let go, nobody walks off, all is said."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.bracket_wire import load_wire
from onboard.mission import ABOARD, Phase
from onboard.robot.handover import GIVE_UP_S
from simulation.aerial_robot import AerialRobot
from simulation.mission import Mission
from simulation.release import ReleaseRig
from simulation.scene import Scene
from simulation.walked import WalkedBase
from tests.simulation.small_mission import EAGER, Event, room, team

AERIAL = 2


def begun(duration_s: float = 90.0) -> tuple[Mission, list[Event]]:
    events: list[Event] = []
    world = room()
    config = team(mission={"duration_s": duration_s}, deployment=EAGER)
    mission = Mission(
        config,
        world,
        Scene(world.vertices, world.triangles),
        1,
        lambda time_s, kind, **fields: events.append((time_s, kind, fields)),
        poses="true",
    )
    return mission, events


def until(mission: Mission, events: list[Event], kind: str, limit_s: float) -> Event:
    while mission.now_s < limit_s:
        mission.tick()
        found = [event for event in events if event[1] == kind]
        if found:
            return found[0]
    raise AssertionError(f"no {kind} in {limit_s} s: {events[-3:]}")


def live(mission: Mission, seconds: float) -> None:
    for _ in range(round(seconds * 10)):
        mission.tick()


def test_permission_to_open_takes_less_than_a_second_and_ends_with_an_open_latch():
    rig = ReleaseRig(load_wire(), 1)
    for tick in range(10):
        rig.step(tick / 10, 0.1, permitted=False)
    assert rig.state.state == "LOCKED"
    assert rig.holds
    opened = next(tick for tick in range(10, 30) if _permitted(rig, tick))
    assert opened - 10 <= 8
    assert not rig.holds


def _permitted(rig: ReleaseRig, tick: int) -> bool:
    rig.step(tick / 10, 0.1, permitted=True)
    return rig.state.is_open


def test_a_jam_leaves_the_robot_aboard_disarmed_and_the_carrier_where_it_is():
    mission, events = begun()
    mission.rigs[AERIAL].node.faults.latch.sticks_at = 0.4
    _, _, aborted = until(mission, events, "abort", 40.0)
    assert "JAM" in str(aborted["reason"])
    live(mission, 5.0)
    carrier, flyer = mission.agents
    assert isinstance(flyer.body, AerialRobot)
    assert isinstance(carrier.body, WalkedBase)
    assert flyer.core.phase == Phase.CARRIED
    assert not flyer.body.report.armed
    assert flyer.body.attached
    place = carrier.pose.position.copy()
    live(mission, 20.0)
    assert np.linalg.norm(carrier.pose.position - place) < 0.01
    assert "bracket" in carrier.body.halt
    assert not [event for event in events if event[1] == "release"]


def test_without_can_nothing_is_released_and_nobody_walks_with_a_robot_that_may_be_loose():
    mission, events = begun()
    mission.rigs[AERIAL].node.faults.mute = True
    live(mission, 15.0)
    carrier, flyer = mission.agents
    assert isinstance(carrier.body, WalkedBase)
    assert carrier.body.path_m < 0.01
    assert "bracket" in carrier.body.halt
    assert flyer.core.phase in ABOARD
    assert not [event for event in events if event[1] == "release"]


def test_a_vehicle_that_must_not_be_armed_is_not_released():
    mission, events = begun()
    flyer = mission.agents[1].body
    assert isinstance(flyer, AerialRobot)
    until(mission, events, "deploy", 30.0)
    flyer.battery.used_wh = 0.97 * flyer.battery.capacity_wh
    _, _, aborted = until(mission, events, "abort", 30.0 + GIVE_UP_S + 5.0)
    assert "not ready" in str(aborted["reason"])
    assert mission.rigs[AERIAL].holds
    assert mission.agents[1].core.phase == Phase.CARRIED


def test_a_bracket_that_opens_by_itself_is_a_fault_and_the_robot_stays_on_the_back():
    mission, _ = begun()
    live(mission, 3.0)
    mission.rigs[AERIAL].node.faults.opens_by_itself = True
    live(mission, 6.0)
    carrier, flyer = mission.agents
    assert isinstance(carrier.body, WalkedBase)
    assert not mission.rigs[AERIAL].holds
    assert flyer.carried
    assert "bracket" in carrier.body.halt
    place = carrier.pose.position.copy()
    live(mission, 5.0)
    assert np.linalg.norm(carrier.pose.position - place) < 0.01
    assert flyer.pose.position == pytest.approx(carrier.pose.position + np.array([0.0, 0.0, 0.95]), abs=0.02)
