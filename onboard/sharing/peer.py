"""What one robot knows of one peer: contact, what the peer holds, what is under way to it."""

from __future__ import annotations

from collections.abc import Iterator

from onboard.sharing.keyframe_store import Key, KeyframeStore
from onboard.sharing.messages import Chunk, Digest, Message, Status

DIGEST_MIN_PERIOD_S = 0.5
DIGEST_PERIOD_S = 5.0
GREETING_S = 5.0
"""For so long after contact digests go out every second: the other side sends nothing before it has one."""
_GREETING_PERIOD_S = 1.0
_SLACK_S = 1e-6
"""Against rounding of clocks that step evenly, which would skip every other beacon turn."""
_REORDER_MAX_S = 10.0
"""A digest that is older than this against the last one comes from a restarted peer, not from a slow path."""


class Peer:
    """State of the link to one robot; times are the caller's clock."""

    def __init__(self, robot_id: int) -> None:
        self.robot_id = robot_id
        self.enabled = False
        self.first_sequence = 0
        self.status: Status | None = None
        self.pending: dict[Key, None] = {}
        """Keys that the peer is not known to hold, oldest first."""
        self._in_flight: dict[Key, float] = {}
        self._outbox: dict[tuple[type[Message], int], Message] = {}
        self._digest: Digest | None = None
        self._digest_is_fresh = False
        self._heard_s: float | None = None
        self._contact_since_s = 0.0
        self._status_sent_s: float | None = None
        self._digest_sent_s: float | None = None
        self._owes_digest = False

    def in_contact(self, now_s: float, timeout_s: float) -> bool:
        return self._heard_s is not None and now_s - self._heard_s <= timeout_s

    def heard(self, now_s: float, timeout_s: float) -> None:
        """Something came from the peer; after silence that starts a new contact."""
        if not self.in_contact(now_s, timeout_s):
            self._contact_since_s = now_s
            self._in_flight.clear()
            self._digest_is_fresh = False
            self._digest_sent_s = None
        self._heard_s = now_s

    def post(self, message: Message) -> None:
        """Queue a small message; a newer one of the same kind replaces an unsent one, which is stale then.

        Chunks of data are told apart by their index.
        """
        slot = type(message), message.index if isinstance(message, Chunk) else 0
        self._outbox.pop(slot, None)
        self._outbox[slot] = message

    def take_outbox(self) -> list[Message]:
        messages = list(self._outbox.values())
        self._outbox.clear()
        return messages

    def take_status_turn(self, now_s: float, period_s: float) -> bool:
        """Whether a beacon is due; if so it counts as sent."""
        due = self._status_sent_s is None or now_s - self._status_sent_s >= period_s - _SLACK_S
        if due:
            self._status_sent_s = now_s
        return due

    def take_digest_turn(self, now_s: float) -> bool:
        """Whether a digest is due; if so it counts as sent."""
        if self._digest_sent_s is not None and now_s - self._digest_sent_s < self._digest_wait_s(now_s):
            return False
        self._digest_sent_s = now_s
        self._owes_digest = False
        return True

    def owe_digest(self) -> None:
        """The peer sent a keyframe, new or not: it waits for our acknowledgement."""
        self._owes_digest = True

    def take_status(self, status: Status) -> None:
        """Keep the newest status; see `take_digest` for restarts."""
        if self.status is None or _supersedes(status.stamp_s, self.status.stamp_s):
            self.status = status

    def take_digest(self, digest: Digest, store: KeyframeStore, own_id: int) -> None:
        """What the peer says it holds replaces what we believed, unless a newer digest overtook this one."""
        if self._digest is not None and not _supersedes(digest.stamp_s, self._digest.stamp_s):
            return
        self._digest = digest
        self._digest_is_fresh = True
        self.refresh(store, own_id)

    def refresh(self, store: KeyframeStore, own_id: int) -> None:
        """Compute `pending` anew from the last digest and the sharing settings."""
        if self._digest is None:
            self.pending = {}
            for keyframe in store:
                self.add_pending((keyframe.source, keyframe.sequence), own_id)
        else:
            missing = store.missing(self._digest)
            self.pending = {key: None for key in missing if self._wants(key, own_id)}
        self._in_flight = {key: sent for key, sent in self._in_flight.items() if key in self.pending}

    def add_pending(self, key: Key, own_id: int) -> None:
        """A keyframe is new here; its source has it, unless a digest says that it forgot."""
        if key[0] != self.robot_id and self._wants(key, own_id):
            self.pending[key] = None

    def holds(self, key: Key) -> None:
        """The peer itself sent this keyframe."""
        self.pending.pop(key, None)
        self._in_flight.pop(key, None)

    def take_keyframe_turns(self, now_s: float, window: int, resend_s: float) -> Iterator[Key]:
        """Keys to send now, oldest first: at most `window` unacknowledged, each again after `resend_s`."""
        if not (self.enabled and self._digest_is_fresh):
            return
        for key in self.pending:
            sent_s = self._in_flight.get(key)
            if sent_s is None and len(self._in_flight) >= window:
                return
            if sent_s is None or now_s - sent_s >= resend_s:
                self._in_flight[key] = now_s
                yield key

    def _wants(self, key: Key, own_id: int) -> bool:
        return key[0] != own_id or key[1] >= self.first_sequence

    def _digest_wait_s(self, now_s: float) -> float:
        if self._owes_digest:
            return DIGEST_MIN_PERIOD_S
        greeting = now_s - self._contact_since_s <= GREETING_S
        return _GREETING_PERIOD_S if greeting else DIGEST_PERIOD_S


def _supersedes(stamp_s: float, last_s: float) -> bool:
    return stamp_s >= last_s or stamp_s < last_s - _REORDER_MAX_S
