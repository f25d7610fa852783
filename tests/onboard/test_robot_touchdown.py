"""Climbing out of the bracket as high as the map allows, and coming down on known ground only."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.autopilot.inputs import FlightReport, Wish
from onboard.autopilot.inputs import Phase as FlightPhase
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.mission import Phase
from onboard.planning.plan import Plan
from onboard.robot import touchdown
from onboard.robot.departure import HIGHEST_M, LOWEST_M, Departure
from onboard.robot.flight import Flight
from onboard.robot.touchdown import AGAIN_S, REACHED_WITHIN_S, Touchdown

SIZE = (0.38, 0.38, 0.24)
HERE = Pose.from_rpy(np.array([0.1, 0.1, 1.0]))
STANDING = FlightReport(FlightPhase.IDLE, "hold", False, False, True, False, 0.9, 10.0)
IN_AIR = replace(STANDING, phase=FlightPhase.FLYING, armed=True, in_air=True, on_ground=False)


def team_of(voxel_map: VoxelMap, **others: Any) -> Any:
    return SimpleNamespace(
        log=lambda *_, **__: None,
        settings=SimpleNamespace(size_m=SIZE, reserve=0.2),
        explorer=SimpleNamespace(map=voxel_map, go_to=lambda a, b: Plan(np.stack([a, b]), "way")),
        peers=[],
        **others,
    )


def below(free_m: float) -> VoxelMap:
    """Known to be free up to so far above the robot's centre."""
    voxel_map = VoxelMap(0.2)
    voxel_map.assume_free([-2.0, -2.0, 0.0], [2.0, 2.0, 1.0 + free_m])
    return voxel_map


def departure(free_m: float, report: FlightReport = STANDING) -> tuple[Departure, Flight]:
    flight = Flight(lambda *_, **__: None)
    flight.sensed(report)
    made = Departure(team_of(below(free_m)), flight)
    made.charge = 0.9
    return made, flight


@pytest.mark.parametrize(("free_m", "height_m"), [(0.6, LOWEST_M), (1.2, 0.88), (3.0, HIGHEST_M)])
def test_it_climbs_as_high_as_it_is_known_to_be_free(free_m, height_m):
    made, flight = departure(free_m)
    assert made.free(HERE)
    made.prepare(10.0, HERE)
    order = flight.orders().order
    assert order is not None
    assert order.wish is Wish.TAKE_OFF
    assert order.height_m == pytest.approx(height_m, abs=0.01)
    assert made.leave(HERE)[2] == pytest.approx(1.0 + height_m, abs=0.01)


@pytest.mark.parametrize("free_m", [0.0, 0.4])
def test_under_something_it_is_not_even_armed(free_m):
    made, flight = departure(free_m)
    assert not made.free(HERE)
    made.prepare(10.0, HERE)
    assert flight.orders().order is None


def test_the_gate_is_asked_with_what_is_known_now():
    made, flight = departure(2.0)
    made.prepare(10.0, HERE)
    flight.sensed(replace(STANDING, phase=FlightPhase.CLIMBING, armed=True))
    made.step(10.5, Phase.TAKING_OFF, HERE, located=True)
    assert not flight.orders().may_climb, "nobody has said that the bracket is open"
    made.released_s = 10.4
    made.step(10.5, Phase.TAKING_OFF, HERE, located=True)
    assert flight.orders().may_climb
    for now_s, phase, pose, located in (
        (12.5, Phase.TAKING_OFF, HERE, True),
        (10.5, Phase.READY, HERE, True),
        (10.5, Phase.TAKING_OFF, Pose.from_rpy(HERE.position, roll_rad=0.2), True),
        (10.5, Phase.TAKING_OFF, HERE, False),
    ):
        made.step(now_s, phase, pose, located=located)
        assert not flight.orders().may_climb


class Landing:
    """A landing of which the map's answer is given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *places: Any) -> None:
        self.asked: list[Any] = []
        self._places = list(places)
        monkeypatch.setattr(touchdown, "landing_place", self._answer)
        self.flight = Flight(lambda *_, **__: None)
        self.flight.sensed(IN_AIR)
        self.made = Touchdown(team_of(VoxelMap(0.2)), self.flight, 0.0, HERE.position)

    def _answer(self, voxel_map: VoxelMap, near: Any, size_m: Any, **given: Any) -> Any:
        self.asked.append(near)
        return self._places.pop(0)

    @property
    def lands(self) -> bool:
        order = self.flight.orders().order
        return order is not None and order.wish is Wish.LAND


PLACE = SimpleNamespace(ground=np.array([2.1, 0.1, 0.0]), above=np.array([2.1, 0.1, 1.0]))


def test_it_flies_over_the_place_and_descends_there_only(monkeypatch):
    landing = Landing(monkeypatch, PLACE)
    landing.made.step(0.1, HERE)
    assert not landing.lands
    plan = landing.made.plan(HERE)
    assert plan is not None
    assert plan.goal == pytest.approx(PLACE.above)
    landing.made.step(3.0, Pose.from_rpy(np.array([1.95, 0.15, 1.3])))
    assert landing.lands
    assert landing.made.plan(HERE) is None


def test_where_no_ground_is_known_to_be_flat_it_hovers_and_looks_again(monkeypatch):
    landing = Landing(monkeypatch, None, None, PLACE)
    for tick in range(round((2 * AGAIN_S + 0.5) * 10)):
        landing.made.step(tick / 10, HERE)
        assert not landing.lands
        assert landing.made.plan(HERE) is None or len(landing.asked) == 3
    assert len(landing.asked) == 3
    assert landing.made.plan(HERE) is not None


def test_between_two_floors_it_lands_on_the_one_below(monkeypatch):
    storeys = VoxelMap(0.2)
    steps = np.arange(-4.0, 4.0, 0.1)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    sensor = np.eye(4)
    for floor_m in (0.1, 3.3):
        sensor[2, 3] = floor_m + 1.5
        points = np.column_stack([x, y, np.full(len(x), -1.5)])
        for _ in range(4):
            storeys.integrate(points.astype(np.float32), sensor, min_range_m=0.1)
    flight = Flight(lambda *_, **__: None)
    told: list[Any] = []
    team = team_of(storeys)
    team.log = lambda kind, **fields: told.append(fields["ground"])
    Touchdown(team, flight, 0.0, np.array([0.1, 0.1, 2.9]))
    assert told[0] is not None
    assert told[0][2] == pytest.approx(0.1, abs=0.15)


def test_a_place_that_cannot_be_reached_is_left_for_another(monkeypatch):
    landing = Landing(monkeypatch, PLACE, None)
    landing.made.step(REACHED_WITHIN_S + 0.1, HERE)
    assert len(landing.asked) == 2
    assert not landing.lands
