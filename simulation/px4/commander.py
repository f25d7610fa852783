"""Who may arm, which mode runs, and what happens when something is lost."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.mavlink import modes
from simulation.px4.estimator import Estimator
from simulation.px4.parameters import Parameters
from simulation.px4.status import READY_S, Battery, Status

ACCEPTED, REJECTED, UNSUPPORTED, FAILED = 0, 1, 3, 4
"""MAV_RESULT."""
FORCE = 21196
EXTERNAL, LANDING, PREFLIGHT = 4, 6, 7
"""Places in PX4's arm_disarm_reason_t."""
MANUAL_MODES = {modes.MANUAL, modes.ALTCTL, modes.POSCTL, modes.STABILIZED}
GLOBAL_MODES = {modes.LOITER, modes.RTL, modes.MISSION}
NOTICED_S = 0.1
REPORT_S = 2.0
Send = Callable[..., None]
"""Called as send(event name, *argument bytes)."""


class Commander:
    """Arming, modes, failsafes."""

    def __init__(
        self, parameters: Parameters, status: Status, estimator: Estimator, battery: Battery, send: Send
    ) -> None:
        self._get, self._status, self._estimator = parameters, status, estimator
        self._battery, self._send = battery, send
        self._reported: tuple[str, ...] = ()
        self._reported_s = -math.inf

    def failing(self) -> list[str]:
        """Names of the checks that fail, whatever the mode."""
        status, now_s = self._status, self._status.now_s
        steady = self._estimator.heading_stable(now_s)
        return [
            name
            for name, fails in (
                ("check_modes_global_pos", status.origin is None or not steady),
                ("check_modes_mission", True),
                ("check_modes_home_position", status.home is None),
                ("check_modes_local_pos", not self._estimator.position_valid(now_s)),
                ("check_estimator_heading_not_stable", not steady),
                ("check_modes_offboard_signal", not self.offboard_fresh()),
                ("check_modes_manual_control", True),
                ("check_rc_dl_no_dllink", not self._station_heard()),
                ("check_battery_low", self._battery_state() > 3),
            )
            if fails
        ]

    def blocking(self, mode: int) -> list[str]:
        """Those of the failing checks that forbid a mode."""
        needed = {"check_battery_low"}
        if self._get["NAV_DLL_ACT"] >= 2:
            needed.add("check_rc_dl_no_dllink")
        if mode in MANUAL_MODES:
            needed.add("check_modes_manual_control")
        else:
            needed |= {"check_modes_local_pos", "check_estimator_heading_not_stable"}
        if mode in GLOBAL_MODES:
            needed.add("check_modes_global_pos")
        if mode == modes.OFFBOARD:
            needed.add("check_modes_offboard_signal")
        if mode == modes.MISSION:
            needed.add("check_modes_mission")
        return [name for name in self.failing() if name in needed]

    def offboard_fresh(self) -> bool:
        """Whether setpoints arrive."""
        return self._status.now_s - self._status.target_s < self._get["COM_OF_LOSS_T"] + NOTICED_S

    def _station_heard(self) -> bool:
        return self._status.now_s - self._status.station_s < self._get["COM_DL_LOSS_T"]

    def _battery_state(self) -> int:
        get = self._get
        return self._battery.state(get["BAT_LOW_THR"], get["BAT_CRIT_THR"], get["BAT_EMERGEN_THR"])

    def arm(self) -> int:
        """Arm if nothing forbids it. Returns MAV_RESULT."""
        status = self._status
        if status.armed:
            return ACCEPTED
        if status.now_s < READY_S or self.blocking(status.mode):
            self._send("commander_arm_denied_resolve_failures")
            return REJECTED
        status.armed, status.armed_s, status.lifted = True, status.now_s, False
        status.ramp_s = status.touch_s = math.inf
        self._send("commander_armed_by", EXTERNAL)
        return ACCEPTED

    def disarm(self, reason: int = EXTERNAL, forced: bool = False) -> int:
        """Disarm on the ground, or anywhere if forced. Returns MAV_RESULT."""
        status = self._status
        if status.armed and not status.landed and not forced:
            self._send("commander_disarm_denied_not_landed")
            return REJECTED
        if status.armed:
            status.armed, status.armed_s, status.ramp_s = False, math.inf, math.inf
            status.intended = status.mode = status.after_disarm
            status.failsafe = False
            self._send("commander_disarmed_by", reason)
        return ACCEPTED

    def change_mode(self, mode: int) -> int:
        """A mode that somebody asks for. On the ground everything is taken, in the air only what can run."""
        status = self._status
        if mode not in modes.NAMES:
            return REJECTED
        if status.armed and not self._runnable(mode):
            return REJECTED
        if mode in (modes.LAND, modes.TAKEOFF, modes.RTL):
            if status.intended not in (modes.LAND, modes.TAKEOFF, modes.RTL):
                status.after_disarm = status.intended
        else:
            status.after_disarm = mode
        status.intended = status.mode = mode
        status.failsafe = False
        return ACCEPTED

    def _runnable(self, mode: int) -> bool:
        return mode in (modes.LAND, modes.TERMINATION) or not self.blocking(mode)

    def supervise(self) -> None:
        """Choose the mode that runs now: the one asked for, or what a failsafe makes of it."""
        status = self._status
        if status.armed and status.intended != modes.TERMINATION:
            forced = self._forced_mode()
            if forced is None:
                status.mode, status.failsafe = status.intended, False
            else:
                self._enter(forced)
        self._auto_disarm()
        self._watch_companion()
        self._report()

    def _enter(self, mode: int) -> None:
        status = self._status
        if not status.failsafe:
            status.failsafe, status.failsafe_s = True, status.now_s
            self._send("commander_failsafe_enter_generic")
        status.mode = mode

    def _forced_mode(self) -> int | None:
        """The severest of what the losses ask for."""
        asked = [m for m in (self._power_loss(), self._fence(), self._mode_loss(), self._link_loss()) if m]
        for mode in (modes.TERMINATION, modes.LAND, modes.ALTCTL, modes.RTL, modes.LOITER):
            if mode in asked:
                return mode
        return None

    def _mode_loss(self) -> int | None:
        status, now_s = self._status, self._status.now_s
        if status.intended in MANUAL_MODES | {modes.LAND}:
            return None
        if not self._estimator.position_valid(now_s):
            act = self._get["COM_OBL_RC_ACT"] if status.intended == modes.OFFBOARD else 4
            return modes.ALTCTL if act == 0 else modes.LAND
        if status.intended == modes.OFFBOARD and not self.offboard_fresh():
            return self._offboard_action(int(self._get["COM_OBL_RC_ACT"]))
        return None

    def _offboard_action(self, act: int) -> int:
        if act == 7:
            self.disarm(forced=True)
            return modes.LAND
        if self._status.origin is None:
            return modes.LAND
        return {0: modes.RTL, 3: modes.RTL, 5: modes.LOITER}.get(act, modes.LAND)

    def _power_loss(self) -> int | None:
        status, state, act = self._status, self._battery_state(), int(self._get["COM_LOW_BAT_ACT"])
        if state > status.low_battery:
            self._send("check_battery_low")
        status.low_battery = state
        if act == 2 and state >= 3:
            return modes.LAND
        if act == 3 and state >= 3:
            return modes.RTL if status.origin is not None and state == 3 else modes.LAND
        return None

    def _fence(self) -> int | None:
        """The fence needs a global origin; without one it silently does nothing."""
        status, far_m = self._status, self._get["GF_MAX_HOR_DIST"]
        if status.origin is None or status.home is None or far_m <= 0.0:
            return None
        x, y, _ = self._estimator.position
        outside = math.hypot(x - status.home[0], y - status.home[1]) > far_m
        if outside and math.isinf(status.fence_s):
            status.fence_s = status.now_s
            self._send("navigator_geofence_violation")
        if math.isinf(status.fence_s):
            return None
        later = {2: modes.LOITER, 3: modes.RTL, 5: modes.LAND}.get(int(self._get["GF_ACTION"]))
        waiting = status.now_s - status.fence_s < self._get["COM_FAIL_ACT_T"]
        return modes.LOITER if later is not None and waiting else later

    def _link_loss(self) -> int | None:
        if self._get["NAV_DLL_ACT"] != 2 or self._station_heard():
            return None
        lost_s = self._status.now_s - self._status.station_s - self._get["COM_DL_LOSS_T"]
        return modes.LOITER if lost_s < self._get["COM_FAIL_ACT_T"] else modes.RTL

    def _auto_disarm(self) -> None:
        status = self._status
        if not status.armed or not status.landed:
            return
        if status.lifted and status.now_s - status.landed_s > self._get["COM_DISARM_LAND"]:
            self.disarm(LANDING)
        elif not status.lifted and status.now_s - status.armed_s > self._get["COM_DISARM_PRFLT"] + 1.1:
            self.disarm(PREFLIGHT)

    def _watch_companion(self) -> None:
        status = self._status
        lost = status.now_s - status.companion_s > self._get["COM_OBC_LOSS_T"] + 0.4
        if lost != status.companion_lost and math.isfinite(status.companion_s):
            status.companion_lost = lost
            self._send("commander_mission_comp_lost" if lost else "commander_mission_comp_regained")

    def _report(self) -> None:
        """Send the failing checks when they change, at most each two seconds."""
        status, failing = self._status, tuple(self.failing())
        if failing == self._reported or status.now_s - self._reported_s < REPORT_S:
            return
        self._reported, self._reported_s = failing, status.now_s
        self._send("commander_arming_check_summary", 0)
        for name in failing:
            self._send(name)
        self._send("commander_health_summary", 0)
