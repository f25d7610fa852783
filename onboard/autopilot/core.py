"""The autopilot's core: orders and guidance in, setpoints and actions out; a pure state machine.

Dead-man: a pose or a planner silent for `hold_after_s` means hold, for `stop_after_s` the stream ends and the
vehicle's own failsafe acts. A stream that has ended begins again on an explicit order only.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from onboard.autopilot.inputs import Action, Drive, Gate, Inputs, Order, Outputs, Path, Phase, Wish
from onboard.autopilot.reference import Aim, Reference
from onboard.autopilot.senses import Senses
from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.shaper import Shaper
from onboard.autopilot.take_off import TakeOff
from onboard.autopilot.vectors import ZERO
from onboard.safety import allow_hold, allow_setpoint
from onboard.safety_facts import Setpoint

ORDER_S = 2.0
STEP_MAX_S = 0.2
RETRY_S = 1.0


class AutopilotCore:
    """One aerial robot's flight. `step` is called at the rate of the setpoints."""

    def __init__(
        self, settings: FlightSettings, allow: Gate = allow_setpoint, allow_hold: Gate = allow_hold
    ) -> None:
        self.settings = settings
        self.phase = Phase.IDLE
        self.reference = Reference(settings)
        self.shaper = Shaper(settings, allow, allow_hold)
        self._take_off: TakeOff | None = None
        self._senses = Senses(settings)
        self._last_s: float | None = None
        self._since_s = -math.inf
        self._decided = False
        self._order_s = -math.inf
        self._jumps = 0
        self._map_s = -math.inf
        self._acted: dict[Action, float] = {}
        self._actions: list[Action] = []
        self._notes: list[str] = []
        self._handlers: dict[Phase, Callable[[Inputs, float], Setpoint | None]] = {
            Phase.IDLE: self._idle,
            Phase.ENGAGING: self._engaging,
            Phase.ARMING: self._arming,
            Phase.CLIMBING: self._climbing,
            Phase.FLYING: self._flying,
            Phase.LANDING: self._landing,
            Phase.LOST: self._lost,
        }

    def step(self, inputs: Inputs) -> Outputs:
        """One cycle."""
        now_s = inputs.now_s
        if self._last_s is None:
            self._senses.begin(now_s)
            self._jumps = inputs.vehicle.map_jumps
        dt_s = 0.0 if self._last_s is None else min(STEP_MAX_S, now_s - self._last_s)
        self._last_s, self._actions, self._notes = now_s, [], []
        self._follow_map(inputs)
        self._obey(inputs)
        setpoint = self._handlers[self.phase](inputs, dt_s)
        flying = self.phase in (Phase.FLYING, Phase.CLIMBING)
        where = self.reference.position if flying else None
        held = self.reference.holding
        return Outputs(self.phase, setpoint, tuple(self._actions), tuple(self._notes), held, where)

    def _go(self, inputs: Inputs, phase: Phase, note: str = "") -> None:
        self.phase, self._since_s, self._acted = phase, inputs.now_s, {}
        self._senses.since_s = inputs.now_s
        if note:
            self._notes.append(note)

    def _act(self, inputs: Inputs, action: Action) -> None:
        """Ask the link for something, again after a while as long as it is wanted."""
        if inputs.now_s - self._acted.get(action, -math.inf) >= RETRY_S:
            self._acted[action] = inputs.now_s
            self._actions.append(action)

    def _follow_map(self, inputs: Inputs) -> None:
        """The map has jumped: every number of before is of another map. Stay, until there is a new path."""
        if inputs.vehicle.map_jumps == self._jumps:
            return
        self._jumps = inputs.vehicle.map_jumps
        self._restart(inputs)
        if self._take_off is not None and inputs.pose is not None:
            self._take_off.rebase(inputs.pose)
        self._notes.append("the map has moved: holding until there is a new path")
        self._map_s = inputs.now_s

    def _obey(self, inputs: Inputs) -> None:
        """Carry out an order once, if it is new and was given after this process began."""
        order = inputs.order
        if order is None or order.issued_s <= self._order_s:
            return
        self._order_s = order.issued_s
        if order.issued_s < self._senses.begun_s or inputs.now_s - order.issued_s > ORDER_S:
            self._notes.append(f"order '{order.wish.value}' is too old and was not carried out")
            return
        match order.wish:
            case Wish.TAKE_OFF:
                self._order_take_off(inputs, order)
            case Wish.LAND if self.phase not in (Phase.IDLE, Phase.ENGAGING, Phase.ARMING):
                self._go(inputs, Phase.LANDING, "landing")
            case Wish.RESUME if self.phase is Phase.LOST:
                self._order_resume(inputs)
            case Wish.DISARM | Wish.LAND:
                self._give_up(inputs, "disarmed on order")
            case _:
                self._notes.append(f"order '{order.wish.value}' does not fit while {self.phase.value}")

    def _order_take_off(self, inputs: Inputs, order: Order) -> None:
        vehicle, pose = inputs.vehicle, inputs.pose
        standing = self.phase is Phase.IDLE and vehicle.on_ground
        if not standing or pose is None or not self._senses.sees(inputs):
            self._notes.append("take-off refused: not on the ground, or pose missing")
        elif not vehicle.ready:
            self._notes.append("take-off refused: the vehicle link is not ready")
        else:
            self._take_off = TakeOff(self.settings, order, pose)
            self.shaper.forget()
            self._go(inputs, Phase.ENGAGING, "take-off: engaging")

    def _order_resume(self, inputs: Inputs) -> None:
        if not (inputs.vehicle.in_air and self._senses.sees(inputs) and self._senses.guided(inputs)):
            self._notes.append("resume refused: not in the air, or pose or planner missing")
            return
        self._take_off = None
        self._restart(inputs)
        self._go(inputs, Phase.ENGAGING, "resuming")

    def _restart(self, inputs: Inputs) -> None:
        self.shaper.forget()
        if inputs.pose is not None:
            self.reference.start(inputs.pose.position, inputs.pose.velocity, inputs.pose.yaw)

    def _emit(self, inputs: Inputs, aim: Aim) -> Setpoint | None:
        """The setpoint of an aim. Blind, the robot is where the vehicle believes it is, and only holds."""
        pose, vehicle = inputs.pose, inputs.vehicle
        if pose is not None and self._senses.sees(inputs):
            return self.shaper.shape(inputs.now_s, aim, pose.position, pose.stamp_s)
        if vehicle.position is None:
            return None
        held = Aim(aim.position, ZERO, aim.yaw, None)
        return self.shaper.shape(inputs.now_s, held, vehicle.position, vehicle.position_s)

    def _idle(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        """On the ground, or just started: in flight the stream goes on, holding, before anything else."""
        vehicle = inputs.vehicle
        if vehicle.known and not self._decided:
            blind = self._senses.blindness_s(inputs) > self.settings.stop_after_s
            if vehicle.offboard and vehicle.in_air and not blind:
                return self._adopt(inputs, dt_s)
            self._decided = True
            if vehicle.in_air:
                self._actions.append(Action.STOP)
                self._go(inputs, Phase.LOST, "started in flight, without pose or offboard")
        return None

    def _adopt(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        """Hold where the vehicle was going: at once in its own words, with the first pose in the map's."""
        pose, vehicle, leash_m = inputs.pose, inputs.vehicle, self.settings.leash_m
        self._actions += [] if vehicle.streaming else [Action.ADOPT]
        if pose is None or not self._senses.sees(inputs):
            if vehicle.position is None or vehicle.yaw is None:
                return None
            held = Aim(vehicle.goal(vehicle.position, leash_m), ZERO, vehicle.yaw, None)
            return self.shaper.shape(inputs.now_s, held, vehicle.position, vehicle.position_s)
        self._decided = True
        self.shaper.forget()
        self.reference.start(vehicle.goal(pose.position, leash_m), ZERO, pose.yaw)
        self._go(inputs, Phase.FLYING, "started in flight: holding")
        return self._flying(inputs, dt_s)

    def _engaging(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        """Stream, and wait for OFFBOARD."""
        vehicle = inputs.vehicle
        self._act(inputs, Action.ENGAGE)
        waited_s = inputs.now_s - self._since_s
        if vehicle.offboard and vehicle.streaming and waited_s > 0.0:
            self._go(inputs, Phase.FLYING if self._take_off is None else Phase.ARMING)
        elif waited_s > 5.0:
            self._give_up(inputs, "offboard was not reached")
            return None
        if self._take_off is not None:
            return self._emit(inputs, self._take_off.waiting(inputs.pose))
        self.reference.step(dt_s, inputs.pose)
        return self._emit(inputs, self.reference.aim())

    def _arming(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        assert self._take_off is not None
        vehicle = inputs.vehicle
        if not vehicle.streaming or inputs.now_s - self._since_s > self.settings.lift_off_s:
            self._give_up(inputs, "arming failed")
            return None
        if vehicle.armed:
            self._take_off.armed(inputs.now_s)
            self._go(inputs, Phase.CLIMBING, "armed")
        else:
            self._act(inputs, Action.ARM)
        return self._emit(inputs, self._take_off.waiting(inputs.pose))

    def _climbing(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        """Straight up; on the carrier until the rotors carry, then above the place of lift-off."""
        take_off = self._take_off
        assert take_off is not None
        if self._silent(inputs, guided=False):
            return None
        trouble = take_off.step(inputs.now_s, dt_s, inputs.pose, inputs.may_climb)
        if not inputs.vehicle.streaming or inputs.vehicle.armed is False:
            trouble = "the vehicle has left offboard or disarmed"
        if trouble:
            self._abort(inputs, trouble, take_off.lifted)
            return None
        if take_off.done and inputs.pose is not None:
            self._take_off = None
            self.reference.start(take_off.target(), ZERO, take_off.yaw)
            self._go(inputs, Phase.FLYING, "took off")
            return self._emit(inputs, self.reference.aim())
        self.reference.position = take_off.target()
        return self._emit(inputs, take_off.aim())

    def _abort(self, inputs: Inputs, trouble: str, lifted: bool) -> None:
        note = f"take-off aborted: {trouble}"
        self._take_off = None
        if lifted:
            self._go(inputs, Phase.LANDING, note)
            self._act(inputs, Action.LAND)
        else:
            self._give_up(inputs, note)

    def _give_up(self, inputs: Inputs, note: str) -> None:
        """Stop stream and rotors; in the air a vehicle refuses the latter, and its failsafe lands it."""
        self._take_off = None
        self._actions += [Action.STOP, Action.DISARM]
        self._go(inputs, Phase.LOST if inputs.vehicle.in_air else Phase.IDLE, note)

    def _silent(self, inputs: Inputs, guided: bool) -> bool:
        """End the stream if pose or planner have been silent for too long."""
        blind_s = self._senses.blindness_s(inputs)
        silence_s = self._senses.silence_s(inputs) if guided else 0.0
        if max(blind_s, silence_s) <= self.settings.stop_after_s:
            return False
        who = "pose" if blind_s > self.settings.stop_after_s else "planner"
        self._actions.append(Action.STOP)
        self._take_off = None
        self._go(inputs, Phase.LOST, f"{who} silent for {self.settings.stop_after_s:g} s: setpoints stopped")
        return True

    def _flying(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        adopting = Action.ADOPT in self._actions
        if not inputs.vehicle.streaming and not adopting:
            self._go(inputs, Phase.LOST, "the vehicle has left offboard")
            return None
        if self._silent(inputs, guided=True):
            return None
        sees = self._senses.sees(inputs)
        motion = self._motion(inputs)
        if not sees or motion is None:
            self.reference.hold()
        elif isinstance(motion, Path):
            self.reference.follow(motion)
        elif isinstance(motion, Drive):
            self.reference.drive(motion)
        self.reference.step(dt_s, inputs.pose if sees else None)
        return self._emit(inputs, self.reference.aim())

    def _motion(self, inputs: Inputs) -> Path | Drive | None:
        """What the planner wants, if it is fresh, of the map as it is now, and makes sense."""
        guidance = inputs.guidance
        if guidance is None or not self._senses.guided(inputs) or guidance.stamp_s <= self._map_s:
            return None
        motion = guidance.motion
        return motion if motion is not None and motion.usable else None

    def _landing(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        """The vehicle lands by itself; setpoints hold until it has taken over."""
        vehicle = inputs.vehicle
        if vehicle.on_ground and vehicle.armed is False:
            self._actions.append(Action.STOP)
            self._go(inputs, Phase.IDLE, "landed")
            return None
        if not vehicle.landing:
            self._act(inputs, Action.LAND)
        if not vehicle.streaming:
            return None
        self.reference.hold()
        self.reference.step(dt_s, inputs.pose if self._senses.sees(inputs) else None)
        return self._emit(inputs, self.reference.aim())

    def _lost(self, inputs: Inputs, dt_s: float) -> Setpoint | None:
        if inputs.vehicle.on_ground and inputs.vehicle.armed is False:
            self._go(inputs, Phase.IDLE, "on the ground")
        return None
