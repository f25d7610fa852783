"""When a robot tells its peers where its keyframes are by now, and what it answers."""

from __future__ import annotations

from onboard.sharing.messages import Corrections

REPEAT_S = 10.0


class CorrectionTalk:
    """Own corrections and what every peer has acknowledged of them; times are the caller's clock."""

    def __init__(self, robot: int) -> None:
        self._robot = robot
        self._own: Corrections | None = None
        self._acknowledged: dict[int, int] = {}
        self._told_s: dict[int, float] = {}

    def tell(self, own: Corrections) -> None:
        """The newest own corrections, for all peers."""
        self._own = own
        self._told_s.clear()

    def due(self, now_s: float, peer: int) -> Corrections | None:
        """What to send to a peer in contact now: at once when new, then again until it is acknowledged."""
        own = self._own
        if own is None or self._acknowledged.get(peer, 0) >= own.revision:
            return None
        if now_s - self._told_s.get(peer, -REPEAT_S) < REPEAT_S:
            return None
        self._told_s[peer] = now_s
        return own

    def came(self, peer: int, message: Corrections) -> Corrections | None:
        """What a peer has sent: corrections are answered, acknowledgements noted."""
        if message.knots:
            return Corrections(message.source, message.revision, ())
        if message.source == self._robot:
            self._acknowledged[peer] = max(message.revision, self._acknowledged.get(peer, 0))
        return None
