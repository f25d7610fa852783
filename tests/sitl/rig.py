"""A vehicle to test on and our pilot: the same for the built-in vehicle and for a real PX4.

External vision is made of the truth about the vehicle, late and with noise.
"""

from __future__ import annotations

import math
import random
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean

from vehicles import KEY, BuiltIn, RealPx4, Truth, Vector

from drivers.mavlink.channel import Channel
from drivers.mavlink.frames import Pose
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.parameter_check import Expected, load_parameters
from drivers.mavlink.signing import Signer, stamp_of
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import Guidance, Order, Wish
from onboard.autopilot.settings import FlightSettings
from onboard.daemons.pilot import Pilot

ROOT = Path(__file__).parents[2]
PARAMETERS = load_parameters(ROOT / "config/px4/aerial.params")
POSE_EVERY, POSE_LATE_S, POSE_NOISE_M = 10, 0.04, 0.02
TRAIL_S, HOVER_S = 8.0, 5.0
CALM_M = 0.1
"""A vehicle that wanders farther than this in an undisturbed hover gets the rest on top of a limit."""
Vehicle = BuiltIn | RealPx4


def hold(now_s: float) -> Guidance | None:
    """A planner that lives and has nothing to fly."""
    return Guidance(now_s)


@dataclass
class Rig:
    """Pilot and vehicle on one clock."""

    vehicle: Vehicle
    settings: FlightSettings = field(default_factory=FlightSettings)
    expected: tuple[Expected, ...] = PARAMETERS
    seed: int = 0

    def __post_init__(self) -> None:
        self.truth = Truth()
        self.notes: list[tuple[float, str]] = []
        self.guidance: Callable[[float], Guidance | None] = hold
        self.seeing = True
        self.cut = False
        """Nothing comes through between pilot and vehicle, either way."""
        self.modes: list[tuple[float, int]] = []
        """What a listener on the wire has heard of the mode while our process was dead."""
        self.jump: Vector = (0.0, 0.0, 0.0)
        self.sent: list[float] = []
        self.wander_m = 0.0
        self._trail: deque[tuple[float, Vector]] = deque()
        self._noise = random.Random(self.seed)
        self._late: list[tuple[float, Pose]] = []
        self._data = b""
        self._tick = 0
        self._truth_channel, self._listener = Channel(255, 190), Channel(255, 191)
        self.signer = Signer(KEY, stamp_of(time.time()))
        self.start_pilot()

    @property
    def now_s(self) -> float:
        return self.vehicle.now_s

    def start_pilot(self) -> None:
        """A new process of ours: nothing of the one before is left but the time in the key's file."""
        self.signer = Signer(KEY, self.signer.timestamp + 1)
        self.link = VehicleLink(
            LinkSettings(vehicle_system=self.system, parameters=self.expected), self.signer
        )
        self.pilot = Pilot(
            AutopilotCore(self.settings), self.link, lambda t, text: self.notes.append((t, text))
        )
        self._late, self._data = [], b""

    @property
    def system(self) -> int:
        return int(getattr(getattr(self.vehicle, "vehicle", None), "system", 1))

    def said(self, text: str) -> bool:
        """Whether a note contains a text."""
        return any(text in note for _, note in self.notes)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass with everything running."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-6:
            self._feed()
            streaming = self.link.streaming
            out = self.pilot.step(self.now_s, b"" if self.cut else self._data)
            if streaming and self.pilot.outputs.setpoint is not None:
                self.sent.append(self.now_s)
            self._data = self.vehicle.exchange(b"" if self.cut else out)
            self._hear_truth()
            self._remember()
            if each is not None:
                each()

    def run_dead(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass while our process does not exist."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-6:
            for packet in self._listener.receive(self.vehicle.exchange(b"")):
                if packet.get_type() == "CURRENT_MODE":
                    self.modes.append((self.now_s, packet.custom_mode))
            self._hear_truth()
            self._remember()
            if each is not None:
                each()

    def run_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Let time pass until something holds. Returns whether it did."""
        end_s = self.now_s + seconds
        while not done():
            if self.now_s > end_s:
                return False
            self.run(0.1)
        return True

    def _hear_truth(self) -> None:
        for packet in self._truth_channel.receive(self.vehicle.truth()):
            if packet.get_type() == "HIL_STATE_QUATERNION":
                self.truth.note(packet)

    def _remember(self) -> None:
        self._trail.append((self.now_s, self.truth.position))
        while self._trail[0][0] < self.now_s - TRAIL_S:
            self._trail.popleft()

    def _feed(self) -> None:
        self._tick += 1
        if self._tick % POSE_EVERY == 0 and self.truth.heard:
            self._late.append((self.now_s + POSE_LATE_S, self._measured()))
        while self._late and self._late[0][0] <= self.now_s:
            pose = self._late.pop(0)[1]
            if self.seeing:
                self.pilot.set_pose(pose)
        if self._tick % 10 == 0 and (guidance := self.guidance(self.now_s)) is not None:
            self.pilot.set_guidance(guidance)

    def _measured(self) -> Pose:
        truth = self.truth
        x, y, z = (
            p + j + self._noise.gauss(0.0, POSE_NOISE_M)
            for p, j in zip(truth.position, self.jump, strict=True)
        )
        half = truth.yaw / 2
        return Pose(self.now_s, (x, y, z), (0.0, 0.0, math.sin(half), math.cos(half)), truth.velocity)

    def order(self, wish: Wish, height_m: float = 0.0) -> None:
        """An explicit command."""
        self.pilot.order(Order(self.now_s, wish, height_m, 2.0))

    def take_off(self, height_m: float = 1.2) -> None:
        """Stand on the carrier, arm, climb, hover; how much it wanders while nothing happens is noted."""
        self.wait_ready()
        self.order(Wish.TAKE_OFF, height_m)
        assert self.run_until(lambda: self.said("took off"), 20.0), self.notes
        self.run(2.0 + HOVER_S)
        middle = self.place(HOVER_S)
        hover = [place for t, place in self._trail if t > self.now_s - HOVER_S]
        self.wander_m = max(math.dist(middle, place) for place in hover)

    def wait_ready(self) -> None:
        """Until nothing speaks against arming, and its heading has had time to settle."""
        ready = self.run_until(lambda: not self.link.problems and self.link.state.sees(self.now_s), 20.0)
        assert ready, (self.link.problems, self.link.counts)
        self.run(4.0)

    def landed(self, seconds: float) -> bool:
        """Whether it stands, disarmed, within so long."""
        state = self.link.state
        return self.run_until(lambda: state.on_ground and state.armed is False, seconds)

    def place(self, seconds: float = 1.0) -> Vector:
        """Where it was lately, in the mean: the noise of a hover is not what tests look for."""
        x, y, z = zip(*(place for t, place in self._trail if t > self.now_s - seconds), strict=True)
        return fmean(x), fmean(y), fmean(z)

    def allowed(self, limit_m: float) -> float:
        """A limit of motion for this vehicle: a PX4 with SIH wanders by decimetres all the time."""
        return limit_m + max(0.0, self.wander_m - CALM_M)

    def drift_m_s(self) -> float:
        """How fast it moves on in the mean, over two seconds."""
        before = self.place()
        self.run(2.0)
        return math.dist(before, self.place()) / 2.0

    def moved(self, seconds: float, run: Callable[..., None] | None = None) -> float:
        """How far from where it was it goes, horizontally, while time passes."""
        begin, far = self.place(), [0.0]
        (run or self.run)(seconds, lambda: far.append(math.dist(begin[:2], self.truth.position[:2])))
        return max(far)
