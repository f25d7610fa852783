"""Co-localisation at release: two scans of the carried robot against its carrier's cloud, or a refusal.

    FIRST_SCAN -> SECOND_SCAN -> ACCEPTED
         |             |
         +-------------+-> REFUSED

Both scans are located independently, each over the whole region that the guess may err by. They must agree on
where the frame of the robot's own odometry lies in the carrier's map: a chance fit does not come twice.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import Pose, apart
from onboard.localization.locate import Estimate, LocateSettings, Locator
from onboard.localization.verdict import Reason, words_of


@dataclass(frozen=True, slots=True)
class ColocalisationSettings:
    """When a second scan comes, and how well both must agree."""

    locate: LocateSettings = field(default_factory=LocateSettings)
    pause_s: float = 0.5
    """The second scan is taken so much later at least, by when the robot has swayed."""
    patience_s: float = 10.0
    """Later than this the odometry between both may have drifted: refused."""
    agree_m: float = 0.1
    agree_rad: float = float(np.deg2rad(1.0))


class State(Enum):
    """How far a co-localisation has come."""

    FIRST_SCAN = auto()
    SECOND_SCAN = auto()
    ACCEPTED = auto()
    REFUSED = auto()


@dataclass(frozen=True, eq=False)
class Verdict:
    """The end of a co-localisation. `map_from_odometry` leads from the robot's odometry frame to the map."""

    reason: Reason
    map_from_odometry: Pose | None
    estimates: tuple[Estimate, ...]

    @property
    def accepted(self) -> bool:
        return self.reason == Reason.ACCEPTED

    @property
    def words(self) -> str:
        """The reason in words, with the direction for a lack of hold."""
        last = self.estimates[-1] if self.estimates else None
        if self.reason != Reason.DEGENERATE or last is None or last.certainty is None:
            return words_of(self.reason)
        x, y, z = last.certainty.weakest
        return f"{words_of(self.reason)}: nothing holds it along ({x:.2f}, {y:.2f}, {z:.2f})"


class Colocalisation:
    """One try. `cloud` (N, 3) is the carrier's, `guess` the pose of the odometry frame in the carrier's map.

    The guess comes from the bracket: the carrier's pose, the place in the bracket and the LiDAR's mount say
    where the LiDAR is in the map, and the odometry says where it is in its own frame.
    """

    def __init__(
        self, cloud: NDArray[np.floating], guess: Pose, settings: ColocalisationSettings | None = None
    ) -> None:
        self._settings = settings or ColocalisationSettings()
        self._locator = Locator(np.asarray(cloud, dtype=np.float64), self._settings.locate)
        self._guess = guess
        self._first: tuple[float, Estimate, Pose] | None = None
        self.verdict: Verdict | None = None

    @property
    def state(self) -> State:
        if self.verdict is not None:
            return State.ACCEPTED if self.verdict.accepted else State.REFUSED
        return State.FIRST_SCAN if self._first is None else State.SECOND_SCAN

    def step(
        self, now_s: float, points: NDArray[np.floating] | None = None, odometry: Pose | None = None
    ) -> Verdict | None:
        """Take in returns (N, 3) of the LiDAR at pose `odometry` of its own frame; the verdict if any.

        Scans that come before the pause is over, or after the verdict, change nothing.
        """
        if self.verdict is None and self._first is not None:
            waited_s = now_s - self._first[0]
            if waited_s > self._settings.patience_s:
                self._end(Reason.LATE, None, (self._first[1],))
            elif waited_s < self._settings.pause_s:
                return None
        if self.verdict is None and points is not None and odometry is not None:
            self._take(now_s, points, odometry)
        return self.verdict

    def _take(self, now_s: float, points: NDArray[np.floating], odometry: Pose) -> None:
        estimate = self._locator.locate(points, self._guess.compose(odometry))
        frame = estimate.pose.compose(odometry.inverse())
        before = () if self._first is None else (self._first[1],)
        if not estimate.accepted:
            self._end(estimate.reason, None, (*before, estimate))
        elif self._first is None:
            self._first = (now_s, estimate, frame)
        else:
            self._compare(self._first[2], frame, odometry, (*before, estimate))

    def _compare(self, first: Pose, second: Pose, odometry: Pose, estimates: tuple[Estimate, ...]) -> None:
        """Where would the sensor be now by the first scan, and where is it by the second?"""
        shift_m, turn_rad = apart(first.compose(odometry), second.compose(odometry))
        agree = shift_m <= self._settings.agree_m and turn_rad <= self._settings.agree_rad
        self._end(Reason.ACCEPTED if agree else Reason.DISAGREE, second if agree else None, estimates)

    def _end(self, reason: Reason, frame: Pose | None, estimates: tuple[Estimate, ...]) -> None:
        self.verdict = Verdict(reason, frame, estimates)
