"""The bracket of one carried robot in lock-step: driver, CAN frames, simulated node."""

from __future__ import annotations

from drivers.bracket import Bracket
from drivers.bracket_types import Report
from drivers.bracket_wire import BracketWire, CanFrame
from onboard.robot.interface import BracketState
from simulation.bracket import BracketNode, NodeFaults

STEP_S = 0.05


class ReleaseRig:
    """One bus with a host and a bracket; frames take one step from one to the other."""

    def __init__(self, wire: BracketWire, seed: int, faults: NodeFaults | None = None) -> None:
        self._host = Bracket(wire)
        self.node = BracketNode(wire, seed, faults)
        self._to_host: list[CanFrame] = []

    def step(self, now_s: float, dt_s: float, *, permitted: bool) -> None:
        """Live from `now_s` on for `dt_s`; `permitted` is the verdict of the gate in this step."""
        for k in range(max(1, round(dt_s / STEP_S))):
            at_s = now_s + k * STEP_S
            self._to_host = self.node.step(at_s, self._host.step(at_s, self._to_host, permitted))

    @property
    def report(self) -> Report:
        """What the host knows."""
        return self._host.report()

    @property
    def state(self) -> BracketState:
        """The same for the carrier's core."""
        report = self.report
        return BracketState(report.state.name, report.heartbeat_s, report.is_open, report.reason)

    @property
    def holds(self) -> bool:
        """Whether the latch really holds the robot."""
        return not self.node.latch.open
