"""The link core: store-and-forward of keyframes and small messages between robots; no sockets, no clock.

Keyframes are gossip: every robot tells which ones it holds (digest) and sends what the other lacks, also
those of third robots. A digest is acknowledgement and request in one, so loss, duplication, reordering,
corruption and restarts need no further care.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from onboard.core.errors import InputError, WireError
from onboard.sharing.frames import KINDS, Envelope, kind_name, pack, unpack
from onboard.sharing.keyframe_store import Key, KeyframeStore
from onboard.sharing.messages import Digest, KeyframeMessage, Message, Status
from onboard.sharing.peer import Peer

Outgoing = list[tuple[int, bytes]]
"""(target robot, frame)."""


class LinkCore:
    """One robot's end of the links to all `peers`; call `step` regularly with everything that was received.

    It is silent before the first `set_status`: the beacon is what opens a contact. With a `store` from a log,
    own sequences go on where they ended and nothing that was received is asked for again; rebuild the map
    from `store` then, since `take_keyframes` gives only what arrives from now on.
    """

    def __init__(
        self,
        robot_id: int,
        peers: Sequence[int],
        *,
        contact_timeout_s: float = 3.0,
        window: int = 12,
        resend_s: float = 1.5,
        status_period_s: float = 1.0,
        store: KeyframeStore | None = None,
    ) -> None:
        if robot_id in peers or len(set(peers)) < len(peers):
            raise InputError(f"peers of robot {robot_id} must be others and differ, got {list(peers)}")
        self.store = KeyframeStore() if store is None else store
        self.bytes_sent = dict.fromkeys(KINDS, 0)
        self.bytes_received = dict.fromkeys(KINDS, 0)
        self.frames_bad = 0
        self.frames_foreign = 0
        """Whole frames for another robot, or from one that is no peer."""
        self._id = robot_id
        self._peers = {peer: Peer(peer) for peer in peers}
        self._contact_timeout_s = contact_timeout_s
        self._window = window
        self._resend_s = resend_s
        self._status_period_s = status_period_s
        self._status: Status | None = None
        self._new_keyframes: list[tuple[int, int, bytes]] = []
        self._new_messages: list[tuple[int, Message]] = []
        for peer in self._peers.values():
            peer.refresh(self.store, self._id)

    def add_keyframe(self, stamp_s: float, payload: bytes) -> int:
        """Keep an own keyframe for sharing; returns its sequence number."""
        sequence = self.store.next_sequence(self._id)
        keyframe = KeyframeMessage(self._id, sequence, stamp_s, payload)
        pack(keyframe, self._id, self._id)  # refuse now what could never be sent
        self._insert(keyframe)
        return sequence

    def post(self, message: Message, to: int) -> None:
        """Send a small message at the next step in contact; an unsent one of the same kind is replaced."""
        pack(message, self._id, to)
        self._peer(to).post(message)

    def set_sharing(self, peer: int, enabled: bool, first_sequence: int = 0) -> None:
        """Switch keyframes to `peer` on or off; own ones before `first_sequence` are never sent."""
        state = self._peer(peer)
        state.enabled = enabled
        state.first_sequence = first_sequence
        state.refresh(self.store, self._id)

    def set_status(self, status: Status) -> None:
        """The beacon to send every `status_period_s` from now on."""
        pack(status, self._id, self._id)
        self._status = status

    def step(self, now_s: float, frames: Iterable[bytes]) -> Outgoing:
        """Take in received frames and return what to transmit: small messages first, then keyframes."""
        for frame in frames:
            self._receive(now_s, frame)
        return [
            (peer.robot_id, self._pack(message, peer))
            for peer in self._peers.values()
            for message in self._due(now_s, peer)
        ]

    def take_keyframes(self) -> list[tuple[int, int, bytes]]:
        """Received (source, sequence, payload) since the last call; each keyframe comes exactly once."""
        taken, self._new_keyframes = self._new_keyframes, []
        return taken

    def take_messages(self) -> list[tuple[int, Message]]:
        """Received (sender, small message) since the last call; may come twice or out of order."""
        taken, self._new_messages = self._new_messages, []
        return taken

    def in_contact(self, peer: int, now_s: float) -> bool:
        """Whether anything came from `peer` within the contact timeout."""
        return self._peer(peer).in_contact(now_s, self._contact_timeout_s)

    def peer_status(self, peer: int) -> Status | None:
        """The newest beacon of `peer`."""
        return self._peer(peer).status

    def unshared(self, peer: int) -> int:
        """Keyframes held here, own or relayed, that `peer` has not acknowledged and should get."""
        return len(self._peer(peer).pending)

    def _peer(self, robot_id: int) -> Peer:
        if robot_id not in self._peers:
            raise InputError(f"robot {robot_id} is no peer of robot {self._id}; known: {list(self._peers)}")
        return self._peers[robot_id]

    def _insert(self, keyframe: KeyframeMessage) -> bool:
        new = self.store.insert(keyframe)
        if new:
            for peer in self._peers.values():
                peer.add_pending((keyframe.source, keyframe.sequence), self._id)
        return new

    def _receive(self, now_s: float, frame: bytes) -> None:
        try:
            envelope = unpack(frame)
        except WireError:
            self.frames_bad += 1
            return
        if envelope.target != self._id or envelope.sender not in self._peers:
            self.frames_foreign += 1
            return
        self.bytes_received[kind_name(envelope.message)] += len(frame)
        self._peers[envelope.sender].heard(now_s, self._contact_timeout_s)
        self._dispatch(envelope)

    def _dispatch(self, envelope: Envelope) -> None:
        peer = self._peers[envelope.sender]
        match envelope.message:
            case KeyframeMessage() as keyframe:
                self._receive_keyframe(peer, keyframe)
            case Digest() as digest:
                peer.take_digest(digest, self.store, self._id)
            case Status() as status:
                peer.take_status(status)
            case message:
                self._new_messages.append((envelope.sender, message))

    def _receive_keyframe(self, peer: Peer, keyframe: KeyframeMessage) -> None:
        if self._insert(keyframe):
            self._new_keyframes.append((keyframe.source, keyframe.sequence, keyframe.payload))
        peer.holds((keyframe.source, keyframe.sequence))
        peer.owe_digest()

    def _due(self, now_s: float, peer: Peer) -> Iterator[Message]:
        if self._status is not None and peer.take_status_turn(now_s, self._status_period_s):
            yield self._status
        if not peer.in_contact(now_s, self._contact_timeout_s):
            return
        yield from peer.take_outbox()
        if peer.take_digest_turn(now_s):
            yield self.store.digest(now_s)
        keys: Iterable[Key] = peer.take_keyframe_turns(now_s, self._window, self._resend_s)
        yield from (self.store[key] for key in keys)

    def _pack(self, message: Message, peer: Peer) -> bytes:
        frame = pack(message, self._id, peer.robot_id)
        self.bytes_sent[kind_name(message)] += len(frame)
        return frame
