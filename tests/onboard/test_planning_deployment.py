"""When a carrier releases: the formulas, the vetoes, the debounce, and outlooks on real maps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.config import DeploymentSettings, RobotSettings
from onboard.core.geometry import Pose, tilt
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.body import Body
from onboard.planning.deployment import (
    MAX_TILT_RAD,
    AerialOutlook,
    Decision,
    Trigger,
    aerial_outlook,
    flight_time,
)
from tests.onboard.air_scenes import hollow, wall

FLYER = RobotSettings.model_validate(
    {
        "name": "aerial",
        "id": 2,
        "kind": "aerial",
        "size_m": (0.38, 0.38, 0.24),
        "speed_m_s": 1.0,
        "yaw_rate_rad_s": 0.8,
        "acceleration_m_s2": 0.8,
        "battery_wh": 90.0,
        "hover_power_w": 250.0,
        "reserve": 0.2,
        "lidar": {"model": "os0-64", "mount_m": (0.0, 0.0, 0.05)},
        "keyframes": {"translation_m": 3.0},
    }
)
ENDURANCE_S = 0.8 * 90.0 * 3600 / 250.0
LEVEL = Pose.from_rpy(np.zeros(3))
LONG_S = 10 * ENDURANCE_S


def settings(**values: object) -> DeploymentSettings:
    return DeploymentSettings.model_validate({"debounce_cycles": 1, **values})


def outlook(rate: float = 5.0, volume: float = 200.0, rays: float = 1e5) -> AerialOutlook:
    return AerialOutlook(np.zeros((1, 3)), volume, rate, rays)


def decide(
    ground: float,
    air: AerialOutlook | None,
    remaining_s: float = LONG_S,
    carrier: Pose = LEVEL,
    **values: object,
) -> Decision:
    return Trigger(settings(**values), FLYER).evaluate(ground, air, remaining_s, carrier)


def test_flight_time_is_the_energy_above_the_reserve_over_the_power():
    assert flight_time(FLYER) == pytest.approx(ENDURANCE_S)
    assert flight_time(FLYER, 0.6) == pytest.approx(ENDURANCE_S / 2)
    assert flight_time(FLYER, 0.2) == flight_time(FLYER, 0.0) == 0.0


@given(st.floats(0, 1.5), st.floats(-np.pi, np.pi))
def test_tilt_is_the_angle_to_the_vertical_whatever_the_heading(angle, yaw):
    assert tilt(Pose.from_rpy(np.zeros(3), pitch_rad=angle, yaw_rad=yaw)) == pytest.approx(angle, abs=1e-6)
    assert tilt(Pose.from_rpy(np.zeros(3), roll_rad=-angle, yaw_rad=yaw)) == pytest.approx(angle, abs=1e-6)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(0, 5))
def test_the_papers_rule_is_its_formula(phi_g, phi_a, gamma):
    wanted = np.exp(gamma) * phi_g <= phi_a
    assert decide(phi_g, outlook(rays=phi_a), rule="paper", gamma=gamma).fire == wanted


def test_the_papers_rule_looks_at_nothing_but_ray_counts():
    at_the_edge = np.exp(-3.5) * 1e5
    for remaining_s in (1.0, LONG_S):
        for ground, fires in ((at_the_edge * 0.999, True), (at_the_edge * 1.001, False)):
            air = outlook(rate=1e-9, rays=1e5)
            assert decide(ground, air, remaining_s, rule="paper", gamma=3.5).fire is fires


@given(st.floats(0, 50), st.floats(0, 50), st.floats(0, LONG_S))
def test_the_rate_rule_compares_gains_per_second_and_fades_with_the_time_left(ground, air, remaining_s):
    scarcity = min(1.0, max(0.0, remaining_s / ENDURANCE_S - 1))
    threshold = np.exp(0.7 * scarcity) * max(ground, 0.05)
    decision = decide(ground, outlook(rate=air), remaining_s, gamma=0.7, min_rate_m3_s=0.05)
    assert decision.threshold == pytest.approx(threshold)
    assert (decision.ground, decision.aerial) == (ground, air)
    if abs(air - threshold) > 1e-9:
        assert decision.fire == (air > threshold)


def test_flight_time_is_scarce_until_the_mission_fits_into_one_flight():
    trigger = Trigger(settings(), FLYER)
    expected = [(0.0, 0.0), (1.0, 0.0), (1.5, 0.5), (2.0, 1.0), (9.0, 1.0)]
    for flights, scarcity in expected:
        assert trigger.scarcity(flights * ENDURANCE_S) == pytest.approx(scarcity)


def test_nothing_to_gain_in_the_air_is_no_reason_to_fly():
    decision = decide(0.0, outlook(volume=49.0), min_volume_m3=50.0)
    assert not decision.fire
    assert decision.reason == "too little to gain in the air"


def test_a_carrier_that_does_well_keeps_the_other_one_aboard():
    decision = decide(4.0, outlook(rate=5.0))
    assert not decision.fire
    assert decision.reason == "the carrier does well itself"
    assert decide(4.0, outlook(rate=5.0), remaining_s=ENDURANCE_S).fire


def test_a_tilted_carrier_never_releases():
    for angle in (MAX_TILT_RAD + 0.01, 0.5):
        tilted = Pose.from_rpy(np.zeros(3), roll_rad=angle)
        assert decide(0.0, outlook(), carrier=tilted).reason == "carrier not level"
    assert decide(0.0, outlook(), carrier=Pose.from_rpy(np.zeros(3), pitch_rad=MAX_TILT_RAD - 0.01)).fire


@pytest.mark.parametrize(
    ("charge", "reason"),
    [(None, "no word from the robot aboard"), (0.59, "the robot aboard is not charged"), (0.6, "")],
)
def test_nothing_is_released_without_word_or_charge(charge, reason):
    decision = Trigger(settings(min_battery=0.6), FLYER).evaluate(0.0, outlook(), LONG_S, LEVEL, charge)
    assert decision.fire is (reason == "")
    assert decision.reason == (reason or "the aerial robot would gain more")


@pytest.mark.parametrize(("second", "fires"), [(0.9, True), (0.75, False)])
def test_a_wish_that_was_there_a_cycle_ago_need_not_be_as_strong_again(second, fires):
    trigger = Trigger(settings(debounce_cycles=2, gamma=0.0, hysteresis=0.2), FLYER)
    assert trigger.evaluate(4.0, outlook(rate=4.0), LONG_S, LEVEL).reason == "debounce"
    assert trigger.evaluate(4.0, outlook(rate=4.0 * second), LONG_S, LEVEL).fire is fires


def test_the_papers_rule_has_no_memory():
    trigger = Trigger(settings(rule="paper", debounce_cycles=2, gamma=0.0, hysteresis=0.2), FLYER)
    assert trigger.evaluate(1e5, outlook(rays=1e5), LONG_S, LEVEL).reason == "debounce"
    assert not trigger.evaluate(1e5, outlook(rays=0.99e5), LONG_S, LEVEL).fire


def corridor() -> AerialOutlook | None:
    """A low corridor that goes on into the unknown: what one sees from the air one sees from the ground."""
    voxel_map = VoxelMap(0.2)
    voxel_map.assume_free((0, 0, 0), (14, 2.4, 2.4))
    for lower, upper in (
        ((-0.2, -0.2, -0.2), (14, 2.6, 0.0)),
        ((-0.2, -0.2, 2.4), (14, 2.6, 2.6)),
        ((-0.2, -0.2, 0.0), (14, 0.0, 2.4)),
        ((-0.2, 2.4, 0.0), (14, 2.6, 2.4)),
    ):
        wall(voxel_map, lower, upper)
    rng = np.random.default_rng(0)
    take_off = np.array([1.2, 1.2, 1.4])
    return aerial_outlook(voxel_map, Body(FLYER, 0.2), take_off, rng, 30.0, count_rays=True)


@pytest.mark.parametrize(
    ("scene", "ground_m3_s", "fires"),
    [
        ("flat maze", 4.0, False),
        ("atrium", 1.0, True),
        ("blocked stairs", 0.0, True),
        ("sealed dead end", 0.0, False),
    ],
)
def test_the_team_flies_where_flying_pays(scene, ground_m3_s, fires):
    makers = {"flat maze": corridor, "sealed dead end": lambda: look(ROOM)}
    air = makers.get(scene, unroofed)()
    assert air is not None
    trigger = Trigger(DeploymentSettings(), FLYER)
    answers = [trigger.evaluate(ground_m3_s, air, LONG_S, LEVEL).fire for _ in range(3)]
    assert answers == [False, False, fires]
    if scene == "flat maze":
        assert air.volume_m3 > DeploymentSettings().min_volume_m3  # there is something to see, for both


def test_what_others_look_at_is_no_reason_to_fly():
    alone = unroofed()
    shared = unroofed(lambda points: np.full(len(points), 0.25))
    assert alone is not None
    assert shared is not None
    assert shared.volume_m3 == pytest.approx(alone.volume_m3 / 4)
    assert shared.rate_m3_s == pytest.approx(alone.rate_m3_s / 4)


def test_a_boxed_in_flyer_is_not_released():
    decision = decide(0.0, None)
    assert not decision.fire
    assert decision.reason == "take-off space not clear"


@pytest.mark.parametrize("cycles", [1, 2, 3, 5])
def test_firing_needs_that_many_cycles_in_a_row(cycles):
    trigger = Trigger(settings(debounce_cycles=cycles), FLYER)
    answers = [trigger.evaluate(0.0, outlook(), LONG_S, LEVEL).fire for _ in range(cycles + 1)]
    assert answers == [False] * (cycles - 1) + [True, True]


@given(st.lists(st.booleans(), min_size=1, max_size=25), st.integers(1, 4))
def test_one_doubt_starts_the_count_again(wishes, cycles):
    trigger = Trigger(settings(debounce_cycles=cycles), FLYER)
    row = 0
    for wish in wishes:
        row = row + 1 if wish else 0
        decision = trigger.evaluate(0.0 if wish else 100.0, outlook(), LONG_S, LEVEL)
        assert decision.fire == (row >= cycles)
        assert (decision.reason == "debounce") == (0 < row < cycles)


ROOM = ((0, 0, 0), (8, 8, 3))


def look(*rooms: tuple, take_off: tuple[float, float, float] = (4.1, 4.1, 1.5)) -> AerialOutlook | None:
    rng = np.random.default_rng(0)
    place = np.array(take_off)
    return aerial_outlook(hollow(*rooms), Body(FLYER, 0.2), place, rng, 30.0, count_rays=True)


def unroofed(left: Callable[[np.ndarray], np.ndarray] | None = None) -> AerialOutlook | None:
    """8 x 8 m of known free space with nothing seen around and above it."""
    voxel_map = VoxelMap(0.2)
    voxel_map.assume_free((0, 0, 0), (8, 8, 3))
    return aerial_outlook(
        voxel_map, Body(FLYER, 0.2), np.array([4.1, 4.1, 1.5]), np.random.default_rng(0), 30.0, left, True
    )


def test_a_closed_room_offers_nothing_and_an_unseen_surrounding_much():
    closed, opened = look(ROOM), unroofed()
    assert closed is not None
    assert opened is not None
    assert closed.volume_m3 < 1.0
    assert closed.rate_m3_s < 0.05
    assert not decide(0.0, closed).fire
    assert decide(0.0, opened).fire
    assert opened.ray_count > closed.ray_count


def test_rays_are_counted_only_for_the_rule_that_asks():
    body, place, voxel_map = Body(FLYER, 0.2), np.array([4.1, 4.1, 1.5]), VoxelMap(0.2)
    voxel_map.assume_free((0, 0, 0), (8, 8, 3))
    uncounted = aerial_outlook(voxel_map, body, place, np.random.default_rng(0), 30.0)
    counted = unroofed()
    assert uncounted is not None
    assert counted is not None
    assert uncounted.ray_count == 0 < counted.ray_count
    assert uncounted.rate_m3_s == counted.rate_m3_s


def test_blocked_on_the_ground_with_much_above_fires_after_the_debounce():
    air = unroofed()
    assert air is not None
    assert air.volume_m3 > 50.0
    assert air.rate_m3_s == pytest.approx(air.volume_m3 / 30.0, rel=0.5)
    trigger = Trigger(DeploymentSettings(), FLYER)
    reasons = [trigger.evaluate(0.0, air, 900.0, LEVEL).reason for _ in range(3)]
    assert reasons == ["debounce", "debounce", "the aerial robot would gain more"]


def test_targets_are_apart_reachable_and_few():
    air = unroofed()
    assert air is not None
    assert 1 <= len(air.targets) <= 3
    gaps = np.linalg.norm(air.targets[:, None] - air.targets[None], axis=2)
    assert gaps[~np.eye(len(gaps), dtype=bool)].min(initial=9.0) > 4.0
    assert (air.targets > 0).all()
    assert (air.targets < [8, 8, 3]).all()


@pytest.mark.parametrize("ceiling_m", [0.8, 1.2])
def test_too_little_room_to_take_off_is_no_outlook(ceiling_m):
    assert look(((0, 0, 0), (8, 8, ceiling_m)), take_off=(4.1, 4.1, 1.3)) is None


def test_the_outlook_is_the_same_for_the_same_seed():
    first, second = unroofed(), unroofed()
    assert first is not None
    assert second is not None
    assert first.targets.tobytes() == second.targets.tobytes()
    assert (first.volume_m3, first.rate_m3_s, first.ray_count) == (
        second.volume_m3,
        second.rate_m3_s,
        second.ray_count,
    )
