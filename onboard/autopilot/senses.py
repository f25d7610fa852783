"""For how long pose and planner have been silent: what the dead-man goes by."""

from __future__ import annotations

import math

from onboard.autopilot.inputs import Inputs
from onboard.autopilot.settings import FlightSettings


class Senses:
    """Who has just begun has not missed anything: silence counts from then, or from a change of phase."""

    def __init__(self, settings: FlightSettings) -> None:
        self._settings = settings
        self.begun_s = math.inf
        self.since_s = -math.inf

    def begin(self, now_s: float) -> None:
        """The first step."""
        self.begun_s = now_s

    def sees(self, inputs: Inputs) -> bool:
        """Whether there is a fresh pose."""
        pose = inputs.pose
        return pose is not None and inputs.now_s - pose.stamp_s < self._settings.hold_after_s

    def guided(self, inputs: Inputs) -> bool:
        """Whether the planner speaks."""
        return self.silence_s(inputs) < self._settings.hold_after_s

    def silence_s(self, inputs: Inputs) -> float:
        """For how long the planner has said nothing."""
        spoken_s = inputs.guidance.stamp_s if inputs.guidance is not None else -math.inf
        return inputs.now_s - max(spoken_s, self.since_s)

    def blindness_s(self, inputs: Inputs) -> float:
        """For how long there was no pose."""
        seen_s = inputs.pose.stamp_s if inputs.pose is not None else -math.inf
        return inputs.now_s - max(seen_s, self.begun_s)
