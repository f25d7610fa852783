"""The host's side of the release bracket: a pure state machine, frames in and frames out.

    permitted, LOCKED -> arm (challenge of the last heartbeat) -> ARMED -> fire (its new challenge)
    -> RELEASING -> RELEASED; whatever is not as it should be -> FAULT, which `lock` acknowledges

The permission comes from outside (`onboard.safety.allow_release`) in every step and is needed up to the frame
that fires; after it only a fault or `lock` stops the latch halfway. A fault tells the bracket to de-energise
in two ways: by a lock command, and by heartbeats without HostOk. After a fault nothing is tried again
before it was acknowledged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from drivers.bracket_monitor import Monitor, shut
from drivers.bracket_types import Fault, Report, Sensors, State
from drivers.bracket_wire import BracketWire, CanFrame, Message, Sender
from drivers.can_protection import LOST_S, Sequence
from onboard.core.errors import WireError

HEARTBEAT_S = 0.1
EARLY_S = 1e-3
"""Steps of 0.1 s are sometimes a rounding shorter."""
FIRE_WITHIN_S = 1.0
ANSWER_S = 0.2
"""A command that was not answered is sent again after this."""
ARM_ATTEMPTS = 5


class Listener:
    """What the bracket says, as far as its frames are good."""

    def __init__(self, wire: BracketWire) -> None:
        self._wire = wire
        self._sequence = Sequence()
        self._damaged = 0
        self._heartbeat: Message | None = None
        self.heartbeat_s: float | None = None
        self.sensors: Sensors | None = None

    @property
    def refused(self) -> int:
        """Frames that were damaged, repeated or out of sequence."""
        return self._damaged + self._sequence.refused

    def receive(self, now_s: float, frame: CanFrame) -> None:
        """Take one frame; a bad one is counted and dropped."""
        try:
            message = self._wire.decode(frame)
        except WireError:
            self._damaged += 1
            return
        if message is None or message.from_host or not self._sequence.take(now_s, message.counter):
            return
        if message.name == "BracketHeartbeat":
            self._heartbeat, self.heartbeat_s = message, now_s
        else:
            self.sensors = _sensors(now_s, message)

    def heartbeat(self, now_s: float) -> Message | None:
        """The bracket's heartbeat, if it is not older than LOST_S."""
        fresh = self.heartbeat_s is not None and 0.0 <= now_s - self.heartbeat_s < LOST_S
        return self._heartbeat if fresh else None


def _sensors(now_s: float, message: Message) -> Sensors:
    signals = message.signals
    return Sensors(
        now_s,
        signals["MotorCurrent"],
        signals["MotorTemperature"],
        signals["LatchClosed"] == 1,
        signals["LatchOpen"] == 1,
    )


class Attempt:
    """One permission's way through the two steps: which were sent, and when."""

    def __init__(self) -> None:
        self._arms = 0
        self._armed_s = -math.inf
        self._challenge: float | None = None

    @property
    def exhausted(self) -> bool:
        """Whether the bracket was told to arm as often as makes sense."""
        return self._arms >= ARM_ATTEMPTS

    def arm_due(self, now_s: float) -> bool:
        """Whether the first step was not sent yet, or its answer is overdue."""
        return now_s - self._armed_s >= ANSWER_S - EARLY_S

    def open_for_fire(self, now_s: float) -> bool:
        """Whether the first step was sent, and not too long ago for the second."""
        return now_s - self._armed_s < FIRE_WITHIN_S

    def answered(self, challenge: float) -> bool:
        """Whether the bracket took the first step: then its challenge is a new one."""
        return challenge != self._challenge

    def armed(self, now_s: float, challenge: float) -> None:
        """The first step is on its way."""
        self._arms += 1
        self._armed_s, self._challenge = now_s, challenge


class Bracket:
    """Opens the bracket in two steps while it is permitted, and watches it.

    Lock-step: call `step` at 10 Hz or faster with the frames that came, and send what it returns.
    """

    def __init__(self, wire: BracketWire) -> None:
        self._sender = Sender(wire)
        self._listener = Listener(wire)
        self._monitor = Monitor()
        self._attempt: Attempt | None = None
        self._fired_s = -math.inf
        self._heartbeat: Message | None = None
        self._sent_s = -math.inf

    def step(
        self, now_s: float, frames: Iterable[CanFrame], permitted: bool = False, lock: bool = False
    ) -> list[CanFrame]:
        """Take what came, and say what to send.

        `permitted`: the release is wanted and allowed now. `lock`: de-energise, acknowledge faults.
        """
        for frame in frames:
            self._listener.receive(now_s, frame)
        self._heartbeat = self._listener.heartbeat(now_s)
        if lock:
            self._monitor.acknowledge()
            self._fired_s = -math.inf
        if self._heartbeat is not None:
            told_to_open = self._fired_s > -math.inf
            self._monitor.watch(now_s, _state(self._heartbeat), self._listener.sensors, told_to_open)
        if lock or not permitted or self._heartbeat is None or self._monitor.fault:
            self._attempt = None
        elif self._attempt is None:
            self._attempt = Attempt()
        command = self._command(now_s, lock)  # it may find a fault, which the heartbeat then tells
        return [*command, *self._own_heartbeat(now_s)]

    def report(self) -> Report:
        """The bracket after the last step."""
        heartbeat, listener, sensors = self._heartbeat, self._listener, self._listener.sensors
        state = State.FAULT if heartbeat is None else _state(heartbeat)
        reason = self._reason()
        switched = sensors is not None and sensors.open and not sensors.closed
        return Report(
            State.FAULT if reason else state,
            reason,
            listener.heartbeat_s,
            heartbeat is not None and _energised(heartbeat),
            switched and state == State.RELEASED and not reason,
            sensors,
            listener.refused,
        )

    def _reason(self) -> str:
        if self._heartbeat is None:
            return "bracket is silent"
        if self._monitor.fault or _state(self._heartbeat) != State.FAULT:
            return self._monitor.fault
        return f"bracket reports {Fault(int(self._heartbeat.signals['Fault'])).name}"

    def _own_heartbeat(self, now_s: float) -> list[CanFrame]:
        """The host's heartbeat when it is due; it tells whether the host is content."""
        if now_s - self._sent_s < HEARTBEAT_S - EARLY_S:
            return []
        self._sent_s = now_s
        content = self._heartbeat is not None and not self._monitor.fault
        return [self._sender.frame("HostHeartbeat", HostOk=int(content))]

    def _command(self, now_s: float, lock: bool) -> list[CanFrame]:
        heartbeat = self._heartbeat
        if lock or (heartbeat is not None and self._must_lock(now_s, heartbeat)):
            return [self._sender.frame("BracketLock")]
        if heartbeat is None or self._attempt is None:
            return []
        match _state(heartbeat):
            case State.LOCKED:
                return self._arm(now_s, heartbeat, self._attempt)
            case State.ARMED:
                return self._fire(now_s, heartbeat, self._attempt)
            case _:
                return []

    def _must_lock(self, now_s: float, heartbeat: Message) -> bool:
        """Whether the bracket has to be told to de-energise: after a fault, or armed for nobody.

        One that was fired just now is not stopped halfway for being reported as ARMED still.
        """
        wanted = self._attempt is not None and self._attempt.open_for_fire(now_s)
        wanted = wanted or not self._fire_due(now_s)
        armed_for_nobody = _state(heartbeat) == State.ARMED and not wanted
        return armed_for_nobody or (self._monitor.fault != "" and _energised(heartbeat))

    def _arm(self, now_s: float, heartbeat: Message, attempt: Attempt) -> list[CanFrame]:
        ready = heartbeat.signals["HostHeard"] == 1 and shut(now_s, self._listener.sensors)
        if not ready or not attempt.arm_due(now_s):
            return []
        if attempt.exhausted:
            self._monitor.fault = f"not open after {ARM_ATTEMPTS} attempts"
            return []
        challenge = heartbeat.signals["Challenge"]
        self._fired_s = -math.inf
        attempt.armed(now_s, challenge)
        return [self._sender.frame("BracketArm", Challenge=challenge)]

    def _fire(self, now_s: float, heartbeat: Message, attempt: Attempt) -> list[CanFrame]:
        challenge = heartbeat.signals["Challenge"]
        if not attempt.answered(challenge) or not self._fire_due(now_s):
            return []
        self._fired_s = now_s
        return [self._sender.frame("BracketFire", Challenge=challenge)]

    def _fire_due(self, now_s: float) -> bool:
        """Whether the second step was not sent, or its answer is overdue."""
        return now_s - self._fired_s >= ANSWER_S - EARLY_S


def _state(heartbeat: Message) -> State:
    return State(int(heartbeat.signals["State"]))


def _energised(heartbeat: Message) -> bool:
    return heartbeat.signals["Energised"] == 1
