"""The carrier's question at every planning step: would a flying robot gain far more than I can myself?

Two rules. `paper`: `phi_g <= exp(-gamma) phi_a` on the gains of the best ground path and the best vertex of a
virtual aerial graph. `rate`: the same comparison on gains per second, so that speed and distance count, with
`gamma` fading to zero once the remaining mission is no longer than the aerial robot's endurance: from then on
every second in the bracket is flight time that can never be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from onboard.core.config import DeploymentSettings, RobotSettings
from onboard.core.geometry import Pose, tilt
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.aerial_graph import AerialGraph
from onboard.planning.body import Body
from onboard.planning.local_graph import FloatArray, thin

MAX_TILT_RAD = math.radians(4.5)
"""The gate of the release refuses from 5 degrees on."""
TAKE_OFF_M = 0.6
"""Height of the take-off point above the carrier's back."""


@dataclass(frozen=True, eq=False)
class AerialOutlook:
    """What an aerial robot starting here could gain: best vertices (K, 3), first one best.

    `ray_count` is the best one by the paper's measure, 0 unless it was asked for.
    """

    targets: FloatArray
    volume_m3: float
    rate_m3_s: float
    ray_count: float


@dataclass(frozen=True)
class Decision:
    """Outcome of one evaluation with its terms; `reason` says what held it back."""

    fire: bool
    reason: str
    ground: float
    aerial: float
    threshold: float


def aerial_outlook(
    voxel_map: VoxelMap,
    body: Body,
    take_off: FloatArray,
    rng: np.random.Generator,
    launch_s: float,
    left: Callable[[FloatArray], FloatArray] | None = None,
    count_rays: bool = False,
) -> AerialOutlook | None:
    """Virtual aerial graph rooted at `take_off` (3,) on the carrier's own map; None if it is boxed in.

    `left` tells which share (N,) of the gains at places (N, 3) other robots leave to this one; `count_rays`
    whether the paper's measure is wanted, which costs as much again.
    """
    graph = body.graph(voxel_map, take_off, rng, None)
    assert isinstance(graph, AerialGraph)
    if len(graph.points) < 10 or np.linalg.norm(graph.points[0] - take_off) > 0.5:
        return None
    views = thin(graph.points, 2.0, body.planner.gain_vertices)
    gains = body.gains(voxel_map, graph.points[views])
    if left is not None:
        gains = gains * left(graph.points[views])
    rates = gains / (graph.distances_m[views] / body.settings.speed_m_s + launch_s)
    order = np.argsort(-rates, kind="stable")
    targets = _apart(graph.points[views[order]], 3)
    best = int(order[0])
    count = 0.0
    if count_rays:
        eyes = graph.points[views] + body.mount
        count = float(np.max(body.gain_model.ray_count(voxel_map, eyes, body.area_m)))
    return AerialOutlook(targets, float(gains[best]), float(rates[best]), count)


def _apart(points: FloatArray, count: int, spacing_m: float = 4.0) -> FloatArray:
    chosen = [points[0]]
    for point in points[1:]:
        if len(chosen) < count and min(float(np.linalg.norm(point - other)) for other in chosen) > spacing_m:
            chosen.append(point)
    return np.stack(chosen)


class Trigger:
    """Debounced deployment decision of a carrier."""

    def __init__(self, settings: DeploymentSettings, aerial: RobotSettings) -> None:
        self._settings = settings
        self._endurance_s = flight_time(aerial)
        self._cycles = 0

    def evaluate(
        self,
        ground: float,
        outlook: AerialOutlook | None,
        remaining_s: float,
        carrier: Pose,
        charge: float | None = 1.0,
    ) -> Decision:
        """One planning cycle. `ground` is the carrier's best gain: m^3/s for `rate`, ray count for `paper`.

        `charge` in [0, 1] is that of the robot aboard, None if nothing was heard of it.
        """
        decision = self._decide(ground, outlook, remaining_s, carrier)
        veto = self._veto(carrier, charge)
        if decision.fire and veto is not None:
            decision = Decision(False, veto, decision.ground, decision.aerial, decision.threshold)
        self._cycles = self._cycles + 1 if decision.fire else 0
        if decision.fire and self._cycles < self._settings.debounce_cycles:
            return Decision(False, "debounce", decision.ground, decision.aerial, decision.threshold)
        return decision

    def _decide(
        self, ground: float, outlook: AerialOutlook | None, remaining_s: float, carrier: Pose
    ) -> Decision:
        settings = self._settings
        if outlook is None:
            return Decision(False, "take-off space not clear", ground, 0.0, 0.0)
        paper = settings.rule == "paper"
        aerial = outlook.ray_count if paper else outlook.rate_m3_s
        floor = 0.0 if paper else settings.min_rate_m3_s
        gamma = settings.gamma if paper else settings.gamma * self.scarcity(remaining_s)
        if self._cycles > 0 and not paper:
            gamma -= settings.hysteresis  # a wish that was there a cycle ago need not be as strong again
        threshold = float(np.exp(gamma)) * max(ground, floor)
        if outlook.volume_m3 < settings.min_volume_m3:
            return Decision(False, "too little to gain in the air", ground, aerial, threshold)
        if aerial < threshold:
            return Decision(False, "the carrier does well itself", ground, aerial, threshold)
        return Decision(True, "the aerial robot would gain more", ground, aerial, threshold)

    def _veto(self, carrier: Pose, charge: float | None) -> str | None:
        """What forbids a release however much there is to gain."""
        if tilt(carrier) > MAX_TILT_RAD:
            return "carrier not level"
        if charge is None:
            return "no word from the robot aboard"
        if charge < self._settings.min_battery:
            return "the robot aboard is not charged"
        return None

    def scarcity(self, remaining_s: float) -> float:
        """1 while flight time is scarce, 0 when the rest of the mission fits into one flight."""
        return float(np.clip((remaining_s - self._endurance_s) / self._endurance_s, 0.0, 1.0))


def flight_time(aerial: RobotSettings, charge: float = 1.0) -> float:
    """Seconds that an aerial robot can hover with a charge in [0, 1] above its reserve."""
    return max(0.0, charge - aerial.reserve) * aerial.battery_wh * 3600.0 / aerial.hover_power_w
