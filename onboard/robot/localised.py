"""What carried robots have told of where they are: without it the bracket stays shut."""

from __future__ import annotations

from dataclasses import dataclass

from onboard.localization.verdict import Reason, words_of
from onboard.sharing.messages import Located

NAMES = 1 << 16
FRESH_S = 4.0
"""A robot repeats that it knows where it is; one that was restarted does not, and does not know either."""


@dataclass(frozen=True)
class Veto:
    """Why a robot must not be released; `final` where waiting changes nothing."""

    words: str
    final: bool


class Localised:
    """The carrier's book of co-localisations. Every deployment has a name: word of others does not count."""

    def __init__(self, *, required: bool) -> None:
        self._required = required
        self._told: dict[int, tuple[float, int]] = {}
        self.name = 0
        """Of this deployment, which the cloud that is offered and the answer to it carry."""

    def begin(self) -> None:
        """A deployment begins: whoever is released must say again where it is."""
        self.name = (self.name + 1) % NAMES
        self._told.clear()

    def told(self, now_s: float, robot: int, message: Located) -> None:
        """A robot says what came of its co-localisation."""
        if message.name == self.name:
            self._told[robot] = (now_s, message.code)

    def veto(self, robot: int, now_s: float) -> Veto | None:
        """What speaks against releasing a robot, None where nothing does."""
        if not self._required:
            return None
        told_s, code = self._told.get(robot, (-FRESH_S, None))
        if code is not None and code != Reason.ACCEPTED:
            return self._refused(code)
        if code is None or now_s - told_s > FRESH_S:
            return Veto("the aerial robot has not found itself in the map yet", final=False)
        return None

    @staticmethod
    def _refused(code: int) -> Veto:
        return Veto(f"the aerial robot cannot find itself in the map: {words_of(code)}", final=True)
