"""Core and link of one aerial robot: bytes in, bytes out. The daemon and the simulator run the same one."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.mavlink import modes
from drivers.mavlink.frames import Pose
from drivers.mavlink.link import VehicleLink
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import (
    Action,
    FlightReport,
    Guidance,
    Inputs,
    Order,
    Outputs,
    Phase,
    VehicleFacts,
)

Listener = Callable[[float, str], None]
MODE_OLD_S = 2.5


class Pilot:
    """Owns the newest pose, guidance and order, and runs the core at its rate."""

    def __init__(self, core: AutopilotCore, link: VehicleLink, listener: Listener | None = None) -> None:
        self.core, self.link = core, link
        self._listener = listener
        self._pose: Pose | None = None
        self._guidance: Guidance | None = None
        self._order: Order | None = None
        self._due_s = -math.inf
        self.may_climb = True
        self.outputs = Outputs(Phase.IDLE)

    def set_pose(self, pose: Pose) -> None:
        """A new pose of our odometry, map frame."""
        if self.link.set_pose(pose):
            self._tell(pose.stamp_s, "the pose has jumped: map and vehicle are joined anew")
        self._pose = self.link.feed.pose

    def set_guidance(self, guidance: Guidance) -> None:
        """The planner's newest word."""
        self._guidance = guidance

    def order(self, order: Order) -> None:
        """An explicit command."""
        self._order = order

    def step(self, now_s: float, data: bytes = b"") -> bytes:
        """Take what the wire brought, give what it shall carry. Call it at 50 Hz or more."""
        link = self.link
        link.receive(now_s, data)
        for notice in link.notices():
            self._tell(notice.stamp_s, notice.text)
        if now_s >= self._due_s - 1e-6:
            period_s = 1.0 / self.core.settings.rate_hz
            self._due_s = self._due_s + period_s if now_s - self._due_s < period_s else now_s + period_s
            self._think(now_s)
        return link.flush()

    def _think(self, now_s: float) -> None:
        facts = self._facts(now_s)
        inputs = Inputs(now_s, facts, self._pose, self._guidance, self._order, self.may_climb)
        self.outputs = self.core.step(inputs)
        for note in self.outputs.notes:
            self._tell(now_s, note)
        for action in self.outputs.actions:
            self._do(action)
        s = self.outputs.setpoint
        if s is not None:
            self.link.send_setpoint(s.position, s.velocity, s.acceleration, s.yaw, s.yaw_rate)

    def _facts(self, now_s: float) -> VehicleFacts:
        state, link = self.link.state, self.link
        return VehicleFacts(
            alive=state.alive(now_s),
            offboard=state.mode == modes.OFFBOARD and now_s - state.mode_s < MODE_OLD_S,
            armed=state.armed,
            in_air=state.in_air,
            on_ground=state.on_ground,
            landing=state.mode == modes.LAND,
            streaming=link.streaming,
            ready=not link.problems,
            map_jumps=link.feed.jumps,
            known=state.mode is not None and state.landed_state is not None,
            position=link.position(),
            position_s=state.position_s,
            yaw=link.yaw(),
            target=link.target(),
        )

    def _do(self, action: Action) -> None:
        link = self.link
        actions: dict[Action, Callable[[], object]] = {
            Action.ENGAGE: link.engage,
            Action.ADOPT: link.adopt,
            Action.STOP: link.stop_stream,
            Action.ARM: link.arm,
            Action.DISARM: link.disarm,
            Action.LAND: link.land,
        }
        actions[action]()

    def _tell(self, now_s: float, text: str) -> None:
        if self._listener is not None:
            self._listener(now_s, text)

    def report(self) -> FlightReport:
        """Where things stand."""
        state = self.link.state
        return FlightReport(
            self.outputs.phase,
            state.mode_name,
            bool(state.armed),
            state.in_air,
            state.on_ground,
            self.link.streaming,
            state.charge,
            state.heartbeat_s,
            self.link.problems,
        )
