"""One deployment: share the map and the target, open the bracket, wait until the aerial robot is clear."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose
from onboard.mission import FLYING, Phase
from onboard.planning.deployment import MAX_TILT_RAD, AerialOutlook, tilt
from onboard.planning.local_graph import FloatArray
from onboard.robot.localised import Veto
from onboard.robot.roles import Team, vector
from onboard.sharing.messages import Release, Target

CLEAR_M = 2.0
NO_CONTACT_S = 60.0
CLEAR_TIMEOUT_S = 20.0
STANDING_M_S = 0.05
REPEAT_S = 1.0


class Outcome(Enum):
    """How far a deployment has come."""

    UNDER_WAY = auto()
    DONE = auto()
    ABORTED = auto()


class HandOver:
    """The carrier's side of one deployment. `release` is true in the step in which the bracket shall open.

    `veto` says why it must not open, if anything speaks against it.
    """

    def __init__(
        self,
        team: Team,
        robot: RobotSettings,
        outlook: AerialOutlook,
        regroup: FloatArray,
        now_s: float,
        veto: Callable[[float], Veto | None],
    ) -> None:
        self.robot = robot
        self.release = False
        self._team = team
        self._veto = veto
        self._regroup = regroup
        self._since_s = now_s
        self._released_s: float | None = None
        self._repeated_s = -np.inf
        self._last: tuple[float, FloatArray] | None = None
        targets = [vector(target) for target in outlook.targets]
        self._target = Target(targets[0], tuple(targets[1:]))
        first = max(0, len(team.keyframe_positions) - team.config.deployment.keyframes_sent)
        team.link.set_sharing(robot.id, True, first)
        team.log(
            "deploy",
            deployed=robot.name,
            position=vector(regroup),
            target=targets[0],
            keyframes_from=first,
        )

    def step(self, now_s: float, pose: Pose) -> Outcome:
        """One control cycle of a carrier that stands still at `pose`."""
        self.release = False
        if self._released_s is None:
            return self._share(now_s, pose)
        return self._see_off(now_s, pose)

    def _share(self, now_s: float, pose: Pose) -> Outcome:
        """Nothing is let go from a carrier that moves or leans, nor without contact.

        A robot that hears nothing would not know that it is free.
        """
        link = self._team.link
        steady = self._steady(now_s, pose)
        if not link.in_contact(self.robot.id, now_s) or not steady:
            why = (
                "the carrier does not stand level"
                if not steady
                else "no contact with the aerial robot aboard"
            )
            return self._abort(why) if now_s - self._since_s > NO_CONTACT_S else Outcome.UNDER_WAY
        if self._repeat(now_s):
            link.post(self._target, self.robot.id)
        veto = self._veto(now_s)
        if veto is not None:
            late = now_s - self._since_s > NO_CONTACT_S
            return self._abort(veto.words) if veto.final or late else Outcome.UNDER_WAY
        if link.unshared(self.robot.id) == 0 and now_s - self._since_s > REPEAT_S:
            self._released_s, self.release = now_s, True
            self._team.log("release", deployed=self.robot.name)
        return Outcome.UNDER_WAY

    def _see_off(self, now_s: float, pose: Pose) -> Outcome:
        status = self._team.link.peer_status(self.robot.id)
        flying = status is not None and Phase(status.phase) in FLYING
        if not flying and self._repeat(now_s):
            self._team.link.post(Release(vector(self._regroup)), self.robot.id)
            self._team.link.post(self._target, self.robot.id)
        away = 0.0 if status is None else float(np.linalg.norm(np.array(status.position_m) - pose.position))
        assert self._released_s is not None
        late = now_s - self._released_s > CLEAR_TIMEOUT_S
        return Outcome.DONE if (flying and away > CLEAR_M) or late else Outcome.UNDER_WAY

    def _steady(self, now_s: float, pose: Pose) -> bool:
        last, self._last = self._last, (now_s, pose.position)
        if last is None or now_s <= last[0]:
            return False
        speed = float(np.linalg.norm(pose.position - last[1])) / (now_s - last[0])
        return speed < STANDING_M_S and tilt(pose) <= MAX_TILT_RAD

    def _abort(self, reason: str) -> Outcome:
        self._team.link.set_sharing(self.robot.id, False)
        self._team.log("abort", deployed=self.robot.name, reason=reason)
        return Outcome.ABORTED

    def _repeat(self, now_s: float) -> bool:
        if now_s - self._repeated_s < REPEAT_S:
            return False
        self._repeated_s = now_s
        return True
