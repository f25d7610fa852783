"""What carried robots have told of where they are: without it the bracket stays shut."""

from __future__ import annotations

from dataclasses import dataclass

from onboard.localization.verdict import Reason, words_of
from onboard.sharing.messages import Located

NAMES = 1 << 16


@dataclass(frozen=True)
class Veto:
    """Why a robot must not be released; `final` where waiting changes nothing."""

    words: str
    final: bool


class Localised:
    """The carrier's book of co-localisations. Every deployment has a name: word of others does not count."""

    def __init__(self, *, required: bool) -> None:
        self._required = required
        self._told: dict[int, int] = {}
        self.name = 0
        """Of this deployment, which the cloud that is offered and the answer to it carry."""

    def begin(self) -> None:
        """A deployment begins: whoever is released must say again where it is."""
        self.name = (self.name + 1) % NAMES
        self._told.clear()

    def told(self, robot: int, message: Located) -> None:
        """A robot says what came of its co-localisation."""
        if message.name == self.name:
            self._told[robot] = message.code

    def veto(self, robot: int) -> Veto | None:
        """What speaks against releasing a robot, None where nothing does."""
        if not self._required:
            return None
        code = self._told.get(robot)
        if code is None:
            return Veto("the aerial robot has not found itself in the map yet", final=False)
        if code == Reason.ACCEPTED:
            return None
        return Veto(f"the aerial robot cannot find itself in the map: {words_of(code)}", final=True)
