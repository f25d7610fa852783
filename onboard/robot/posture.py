"""Sitting and standing of a legged base: what to ask for, and what may be believed of the answers."""

from __future__ import annotations

from onboard.core.base import Posture

STILL_M_S = 0.05
STILL_S = 0.5
"""A base that moved within this time is not asked to sit down."""
RETRY_S = 2.0


class PostureKeeper:
    """Brings the base into the wanted posture. It knows none until the base has agreed and had time to obey.

    `settle_s` is that time. A refusal, or no answer, is asked again after RETRY_S.
    """

    def __init__(self, settle_s: float) -> None:
        self._settle_s = settle_s
        self._wanted: Posture | None = None
        self._agreed: Posture | None = None
        self._agreed_s = 0.0
        self._asked: Posture | None = None
        self._retry_s = -float("inf")
        self._moved_s = -float("inf")
        self.trouble = ""
        """What the base said when it refused last."""

    def want(self, posture: Posture) -> None:
        """The posture to be in from now on."""
        if posture != self._wanted:
            self._wanted = posture
            self._retry_s = -float("inf")

    def step(self, now_s: float, speed_m_s: float | None) -> Posture | None:
        """What to ask of the base now, if anything; `speed_m_s` is its own odometry's, None where unknown."""
        if speed_m_s is None or not abs(speed_m_s) < STILL_M_S:
            self._moved_s = now_s
        if self._wanted is None or self._wanted == self._agreed or self._asked is not None:
            return None
        if now_s < self._retry_s:
            return None
        if self._wanted == "sit" and now_s - self._moved_s < STILL_S:
            return None
        self._asked = self._wanted
        # between the postures it has none
        self._agreed = None
        return self._asked

    def answered(self, now_s: float, posture: Posture, ok: bool, text: str = "") -> None:
        """What the base answered to the request for `posture`."""
        if posture != self._asked:
            return
        self._asked = None
        self.trouble = "" if ok else text
        if ok:
            self._agreed, self._agreed_s = posture, now_s
        else:
            self._retry_s = now_s + RETRY_S

    def is_in(self, now_s: float, posture: Posture) -> bool:
        """Whether the base agreed to this posture long enough ago, and no other is wanted."""
        return (
            self._agreed == posture
            and self._wanted == posture
            and self._asked is None
            and now_s - self._agreed_s >= self._settle_s
        )
