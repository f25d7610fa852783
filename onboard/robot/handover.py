"""One deployment: share the map and the target, open the bracket, wait until the aerial robot is clear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from onboard.core.base import BaseOdometry
from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose, tilt
from onboard.mission import FLYING, Phase
from onboard.planning.deployment import AerialOutlook
from onboard.planning.local_graph import FloatArray
from onboard.robot.interface import BracketState
from onboard.robot.localised import Veto
from onboard.robot.roles import Team, vector
from onboard.safety import allow_release, departed, still_since
from onboard.safety_facts import ReleaseFacts, Token
from onboard.sharing.messages import Release, Status, Target

GIVE_UP_S = 60.0
LINGERS_S = 30.0
SILENT_S, ALOFT_M = 20.0, 0.3
"""Who was this far above its bracket when it was heard last, and then not for so long, is away."""
LOST_S = 120.0
"""Who is silent for so long is given up for lost, wherever it was: the carrier has to come home."""
REPEAT_S = 1.0
AVERAGE_S = 0.2
OPENING = frozenset({"RELEASING", "RELEASED"})


@dataclass(frozen=True, eq=False)
class Stance:
    """How the carrier stands and what its bracket says: readings of one step."""

    now_s: float
    pose: Pose
    odometry_s: float | None = None
    still_since_s: float | None = None
    bracket: BracketState | None = None


class Standing:
    """Since when the carrier has stood still, by its base's own odometry, whose noise is averaged away."""

    def __init__(self) -> None:
        self.odometry_s: float | None = None
        self.since_s: float | None = None
        self._speed: FloatArray = np.zeros(3)
        self._turn = 0.0

    def sensed(self, odometry: BaseOdometry | None) -> None:
        """The newest odometry, if there is any."""
        if odometry is None or odometry.stamp_s == self.odometry_s:
            return
        now_s = odometry.stamp_s
        last_s = now_s - AVERAGE_S if self.odometry_s is None else self.odometry_s
        share = 1.0 - np.exp((last_s - now_s) / AVERAGE_S)
        self._speed = self._speed + (odometry.linear_m_s - self._speed) * share
        self._turn += (float(odometry.angular_rad_s[2]) - self._turn) * share
        speed = float(np.linalg.norm(self._speed))
        self.since_s = still_since(self.since_s, last_s, now_s, speed, self._turn)
        self.odometry_s = now_s


class Outcome(Enum):
    """How far a deployment has come."""

    UNDER_WAY = auto()
    DONE = auto()
    ABORTED = auto()


class HandOver:
    """The carrier's side of one deployment. `release` names the robot while its bracket may open.

    `veto` says why it must not be released, if its co-localisation speaks against it.
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
        self.release: int | None = None
        self.opened_s: float | None = None
        self._team = team
        self._veto = veto
        self._regroup = regroup
        self._since_s = now_s
        self._repeated_s = -np.inf
        self._refusal = ""
        self._lingers = False
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

    def step(self, stance: Stance) -> Outcome:
        """One control cycle of a carrier that has been told to stand still."""
        self.release = None
        bracket = stance.bracket
        if self.opened_s is None and bracket is not None and bracket.is_open:
            self.opened_s = stance.now_s
            self._repeated_s = -np.inf
            self._team.log("release", deployed=self.robot.name)
        return self._share(stance) if self.opened_s is None else self._see_off(stance)

    def _share(self, stance: Stance) -> Outcome:
        """Target and map first, then the gate; what it refuses may still come, but not for ever."""
        now_s, link = stance.now_s, self._team.link
        if self._repeat(now_s):
            link.post(self._target, self.robot.id)
        veto = self._veto(now_s)
        refusal = self._refused(stance, colocalised=veto is None)
        if veto is not None and veto.final:
            return self._abort(veto.words)
        if stance.bracket is not None and stance.bracket.reason:
            return self._abort(stance.bracket.reason)
        if refusal == "":
            self.release = self.robot.id
        elif now_s - self._since_s > GIVE_UP_S:
            return self._abort(veto.words if veto is not None else refusal)
        self._tell(refusal, stance.bracket)
        return Outcome.UNDER_WAY

    def _refused(self, stance: Stance, *, colocalised: bool) -> str:
        """Why the bracket must not open now, "" for no reason."""
        link, robot, now_s = self._team.link, self.robot.id, stance.now_s
        if not link.in_contact(robot, now_s):
            return "no contact with the aerial robot aboard"
        if link.unshared(robot) or now_s - self._since_s <= REPEAT_S:
            return "map is being sent"
        status, bracket = link.peer_status(robot), stance.bracket
        return allow_release(
            ReleaseFacts(
                now_s=now_s,
                robot=robot,
                # the trigger stands behind it for as long as the deployment goes on
                token=Token("trigger", robot, now_s),
                phase=Phase.DEPLOYING,
                still_since_s=stance.still_since_s,
                base_stamp_s=stance.odometry_s,
                tilt_rad=tilt(stance.pose),
                aerial_ready=status is not None and status.phase == Phase.READY,
                aerial_stamp_s=None if status is None else status.stamp_s,
                colocalised=colocalised,
                bracket=None if bracket is None else bracket.state,
                bracket_stamp_s=None if bracket is None else bracket.heartbeat_s,
            )
        ).reason

    def _tell(self, refusal: str, bracket: BracketState | None) -> None:
        fired = bracket is not None and bracket.state in OPENING
        if refusal != self._refusal and not fired:
            self._refusal = refusal
            self._team.log("release_gate", allowed=refusal == "", reason=refusal)

    def _see_off(self, stance: Stance) -> Outcome:
        """Say that the way is free, as long as the carrier stands, until the robot is far enough away."""
        now_s, link = stance.now_s, self._team.link
        status = link.peer_status(self.robot.id)
        if stance.still_since_s is not None and self._repeat(now_s):
            link.post(Release(vector(self._regroup)), self.robot.id)
            link.post(self._target, self.robot.id)
        if status is not None and self._gone(stance, status):
            return Outcome.DONE
        assert self.opened_s is not None
        if now_s - self.opened_s > LINGERS_S and not self._lingers:
            self._lingers = True
            self._team.log("lingers", deployed=self.robot.name)
        return Outcome.UNDER_WAY

    def _gone(self, stance: Stance, status: Status) -> bool:
        """Far enough away by its own word; or in the air when it was heard last, and out of reach since."""
        offset = np.array(status.position_m) - stance.pose.position
        flies = status.phase in FLYING
        bracket_m = self._team.settings.size_m[2] + self._team.config.bracket.height_m
        aloft = flies and offset[2] > bracket_m + ALOFT_M
        if stance.now_s - status.stamp_s > (SILENT_S if aloft else LOST_S):
            return True
        return flies and departed(float(np.linalg.norm(offset)), float(offset[2]))

    def _abort(self, reason: str) -> Outcome:
        self._team.link.set_sharing(self.robot.id, False)
        self._team.log("abort", deployed=self.robot.name, reason=reason)
        return Outcome.ABORTED

    def _repeat(self, now_s: float) -> bool:
        if now_s - self._repeated_s < REPEAT_S:
            return False
        self._repeated_s = now_s
        return True
