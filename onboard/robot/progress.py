"""Noticing that a robot does not get on, and getting it out again (progress watchdog, planner.md 3.5)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import Pose, wrap_angle
from onboard.planning.follower import Velocity
from onboard.planning.local_graph import FloatArray, polyline_length
from onboard.planning.plan import Plan, remaining_path

STUCK_S = 5.0
PROGRESS_M = 0.3
PROGRESS_RAD = 0.4
MAX_TURNS = 8
BACK_OFF_S = 4.0
BACK_OFF_M = 0.8
BACK_OFF_SPEED_M_S = 0.3
OTHER_WAY_RAD = 2.4
OTHER_WAYS = 8
FEEL_AFTER = 3
RETREATS = 4
RETREAT_M = 1.5
PLACE_M = 2.0
VISITS = 4
VISITS_S = 120.0


@dataclass
class _Mark:
    """The last progress towards a goal."""

    goal: FloatArray
    time_s: float
    left_m: float
    position: FloatArray
    yaw_rad: float
    turns: int = 0


class Watchdog:
    """Tells when no progress towards the same goal was made for STUCK_S, by walking or by turning."""

    def __init__(self) -> None:
        self._mark: _Mark | None = None

    def idle(self) -> None:
        """The robot has no goal."""
        self._mark = None

    def stuck(self, now_s: float, pose: Pose, plan: Plan) -> bool:
        """To be called at every step with a plan."""
        left_m = polyline_length(remaining_path(pose.position, plan.path))
        mark = self._mark
        if mark is None or np.linalg.norm(mark.goal - plan.goal) > 1.0:
            self._mark = _Mark(plan.goal, now_s, left_m, pose.position, pose.yaw)
            return False
        if left_m < mark.left_m - PROGRESS_M:
            self._mark = _Mark(plan.goal, now_s, left_m, pose.position, pose.yaw)
        elif left_m > mark.left_m + PROGRESS_M and _away(pose, mark) > PROGRESS_M:
            # another, longer way to the same goal, which it walks: only a shorter rest than that one's counts
            mark.left_m, mark.position = left_m, pose.position
        elif abs(wrap_angle(pose.yaw - mark.yaw_rad)) > PROGRESS_RAD and mark.turns < MAX_TURNS:
            mark.time_s, mark.yaw_rad, mark.turns = now_s, pose.yaw, mark.turns + 1
        return now_s - mark.time_s > STUCK_S


def _away(pose: Pose, mark: _Mark) -> float:
    return float(np.linalg.norm(pose.position - mark.position))


class Pacing:
    """Tells when a robot goes to and fro: the same place VISITS times within VISITS_S, with a goal that it
    had before it turned to another one."""

    def __init__(self) -> None:
        self._visits: list[tuple[float, FloatArray]] = []
        self._goals: list[tuple[float, FloatArray]] = []

    def going_round(self, now_s: float, position: FloatArray, goal: FloatArray) -> bool:
        """To be called at every step with a plan; true once, then it counts anew."""
        self._visits = [entry for entry in self._visits if now_s - entry[0] < VISITS_S]
        self._goals = [entry for entry in self._goals if now_s - entry[0] < VISITS_S]
        if not self._goals or np.linalg.norm(self._goals[-1][1] - goal) > PLACE_M:
            self._goals.append((now_s, goal))
        if self._visits and np.linalg.norm(self._visits[-1][1] - position) <= PLACE_M:
            return False
        places = [place for _, place in self._visits if np.linalg.norm(place - position) <= PLACE_M / 2]
        # the first place of a visit stands for all later ones, or the cells would creep along
        self._visits.append((now_s, places[0] if places else position.copy()))
        before = [old for _, old in self._goals[:-2] if np.linalg.norm(old - goal) <= PLACE_M]
        if len(places) + 1 < VISITS or not before:
            return False
        self._visits, self._goals = [], []
        return True


class BackOff:
    """Going back a little on the own trail without turning.

    When even that does not move the robot it tries other directions, one after the other.
    """

    def __init__(self) -> None:
        self._until_s = -np.inf
        self._target: FloatArray | None = None
        self._from: FloatArray | None = None
        self._tries = 0
        self._turn = 0

    def start(
        self, now_s: float, pose: Pose, trail: list[FloatArray], blocked: Callable[[FloatArray], bool]
    ) -> None:
        """Begin to go back to the newest place of the trail that is far enough away.

        `blocked` tells of a target (3,) whether the map shows something in the body's way there; the first
        free direction is taken, another one at each attempt. Where all are blocked it stays, for it came
        turned another way. If nothing helps it feels its way, whatever the map says, the trail first.
        """
        moved = self.useful(pose)
        self._tries = 0 if moved else self._tries + 1
        self._turn = 0 if moved else self._turn + 1
        self._from = pose.position.copy()
        self._until_s = now_s + BACK_OFF_S
        places = [place for place in trail if np.linalg.norm(place - pose.position) >= BACK_OFF_M]
        self._target = None
        if not places:
            return
        offset = places[-1] - pose.position
        offset *= BACK_OFF_M / np.linalg.norm(offset)
        if self._tries >= FEEL_AFTER:
            turn = self._tries - FEEL_AFTER
            self._target = pose.position + _turned(offset, turn * OTHER_WAY_RAD)
            return
        for turn in range(self._turn, self._turn + OTHER_WAYS):
            target = pose.position + _turned(offset, turn * OTHER_WAY_RAD)
            if not blocked(target):
                self._target, self._turn = target, turn
                return

    def useful(self, pose: Pose) -> bool:
        """Whether the robot has moved since it last began to back off."""
        return self._from is None or float(np.linalg.norm(pose.position - self._from)) > PROGRESS_M

    def command(self, now_s: float, pose: Pose) -> Velocity | None:
        """The velocity of this step, None when the robot is not backing off (any more)."""
        if self._target is None or now_s >= self._until_s:
            return None
        offset = self._target - pose.position
        distance = float(np.linalg.norm(offset))
        if distance < 0.2:
            self._target = None
            return None
        return Velocity(offset / distance * BACK_OFF_SPEED_M_S, 0.0)


class Retreats:
    """Counts how often a robot went back from a place where it could not turn.

    Where going back leads to no better place, it would go to and fro for ever: after RETREATS of them within
    RETREAT_M it has to turn after all.
    """

    def __init__(self) -> None:
        self._places: deque[FloatArray] = deque(maxlen=2 * RETREATS)

    def again(self, place: FloatArray) -> bool:
        """Whether to go back once more from `place` (3,)."""
        near = sum(float(np.linalg.norm(other - place)) <= RETREAT_M for other in self._places)
        if near >= RETREATS:
            return False
        self._places.append(place.copy())
        return True


def _turned(offset: FloatArray, angle_rad: float) -> FloatArray:
    return np.asarray(Pose.from_rpy(np.zeros(3), yaw_rad=angle_rad).rotation @ offset)
