"""What the core of an aerial robot orders from its autopilot: arm in the bracket, climb, land."""

from __future__ import annotations

from dataclasses import dataclass

from onboard.autopilot.inputs import FlightReport, Order, Wish
from onboard.autopilot.inputs import Phase as FlightPhase
from onboard.robot.interface import FlightOrders, Log
from onboard.safety import allow_take_off
from onboard.safety_facts import TakeOffFacts

AGAIN_S = 3.0
"""An order that shows no effect is given again after this."""
ATTEMPTS = 3
"""Climbs that were broken off by the autopilot before a person has to look."""
BEFORE_CLIMB = frozenset({FlightPhase.ENGAGING, FlightPhase.ARMING, FlightPhase.CLIMBING})


@dataclass(frozen=True)
class Climb:
    """How high to climb above where the robot stands, and the least distance to anything on the way."""

    height_m: float
    room_m: float


class Flight:
    """Orders by what the autopilot reports. Without a report nothing is ordered but standing down."""

    def __init__(self, log: Log) -> None:
        self.report: FlightReport | None = None
        self._log = log
        self._order: Order | None = None
        self._may_climb = False
        self._refusal = ""
        self._climbs = 0
        self._was: FlightPhase | None = None

    def sensed(self, report: FlightReport | None) -> None:
        """The autopilot's newest report."""
        before, self.report = self._was, report
        self._was = None if report is None else report.phase
        if before is not None and self._was is FlightPhase.LOST and before is not FlightPhase.LOST:
            self._log("flight_lost", mode=report.mode if report is not None else "")
        if before is FlightPhase.CLIMBING and self._was in (FlightPhase.IDLE, FlightPhase.LANDING):
            self._climbs += self._may_climb
            self._may_climb = False

    @property
    def airborne(self) -> bool:
        """Whether the vehicle says that it flies."""
        return self.report is not None and self.report.in_air

    @property
    def armed_below(self) -> bool:
        """Whether the rotors turn, nothing is wrong, and the robot stands until it may climb."""
        report = self.report
        return (
            report is not None
            and report.phase is FlightPhase.CLIMBING
            and report.armed
            and not report.in_air
            and not report.problems
        )

    @property
    def flying(self) -> bool:
        """Whether the climb is done and the robot takes velocities."""
        return self.report is not None and self.report.phase is FlightPhase.FLYING

    @property
    def ready(self) -> bool:
        """Whether the autopilot's own checks have passed."""
        return self.report is not None and not self.report.problems

    @property
    def given_up(self) -> bool:
        """Whether climbing was tried often enough."""
        return self._climbs >= ATTEMPTS

    @property
    def idle(self) -> bool:
        """Whether the robot stands with its rotors at rest and may be armed."""
        report = self.report
        standing = report is not None and report.phase is FlightPhase.IDLE and report.on_ground
        return standing and self.ready and not self.given_up

    def prepare(self, now_s: float, climb: Climb) -> bool:
        """Arm on the spot for a climb, which `climb` then allows or not. Returns whether it was ordered."""
        return self.idle and self._give(now_s, Order(now_s, Wish.TAKE_OFF, climb.height_m, climb.room_m))

    def stand_down(self, now_s: float) -> None:
        """Not wanted any more: disarm where the robot stands."""
        self._may_climb = False
        if self.report is not None and self.report.phase in BEFORE_CLIMB and not self.report.in_air:
            self._give(now_s, Order(now_s, Wish.DISARM))

    def climb(self, facts: TakeOffFacts) -> None:
        """Ask the gate, in every step of a take-off."""
        verdict = allow_take_off(facts)
        self._may_climb = verdict.ok
        if verdict.reason != self._refusal and not self.airborne:
            self._log("take_off", allowed=verdict.ok, reason=verdict.reason)
        self._refusal = verdict.reason

    def land(self, now_s: float) -> None:
        """Come down where the robot is."""
        landing = self.report is not None and self.report.phase is FlightPhase.LANDING
        if self.airborne and not landing:
            self._give(now_s, Order(now_s, Wish.LAND))

    def orders(self) -> FlightOrders:
        """For the autopilot."""
        return FlightOrders(self._order, self._may_climb)

    def _give(self, now_s: float, order: Order) -> bool:
        last = self._order
        if last is not None and last.wish is order.wish and now_s - last.issued_s < AGAIN_S:
            return False
        self._order = order
        return True
