"""A large piece of data in chunks over a link that loses, repeats and reorders: selective repeat, resumable.

The sender offers (name, length, checksum) until it hears of the receiver; the receiver answers with the
chunks it lacks; the sender sends those, a window at a time. An offer and its answers carry everything that
either side must know, so that both may begin anew at any time and go on with the chunks that are there.
"""

from __future__ import annotations

from onboard.core.crc import crc32c
from onboard.core.errors import InputError
from onboard.sharing.messages import (
    CHUNK_BYTES,
    MAX_CHUNKS,
    MAX_MISSING,
    Chunk,
    ChunkRange,
    Missing,
    Offer,
)

_OFFER_PERIOD_S = 0.5


class DataSender:
    """One side of a transfer. `step` returns what to send now, at most `window` chunks at a time.

    Raises InputError for data that is empty or longer than the format carries.
    """

    def __init__(self, name: int, data: bytes, *, window: int = 16, resend_s: float = 0.5) -> None:
        count = -(-len(data) // CHUNK_BYTES)
        if not 0 < count <= MAX_CHUNKS:
            raise InputError(f"data of {len(data)} bytes cannot be sent in 1 to {MAX_CHUNKS} chunks")
        self.offer = Offer(name, len(data), crc32c(data))
        self.done = False
        self._data = data
        self._window = window
        self._resend_s = resend_s
        self._wanted: list[int] = []
        self._sent_s: dict[int, float] = {}
        self._offered_s: float | None = None

    def handle(self, now_s: float, message: Missing) -> None:
        """The receiver's answer: what it lacks; answers to other offers are ignored."""
        if (message.name, message.checksum) != (self.offer.name, self.offer.checksum):
            return
        count = -(-len(self._data) // CHUNK_BYTES)
        wanted = [k for span in message.spans for k in range(span.first, min(span.first + span.count, count))]
        self.done = message.complete
        self._wanted = [] if self.done else wanted
        self._sent_s = {k: sent_s for k, sent_s in self._sent_s.items() if k in set(wanted)}

    def step(self, now_s: float, most: int = MAX_CHUNKS) -> list[Offer | Chunk]:
        """At most `most` lacking chunks, each again after `resend_s`, and now and then the offer."""
        if self.done:
            return []
        flying = sum(now_s - sent_s < self._resend_s for sent_s in self._sent_s.values())
        due = [k for k in self._wanted if now_s - self._sent_s.get(k, -1e9) >= self._resend_s]
        chosen = due[: max(0, min(most, self._window - flying))]
        self._sent_s.update(dict.fromkeys(chosen, now_s))
        messages: list[Offer | Chunk] = [self._chunk(k) for k in chosen]
        if self._offered_s is None or now_s - self._offered_s >= _OFFER_PERIOD_S:
            self._offered_s = now_s
            messages.insert(0, self.offer)
        return messages

    def _chunk(self, index: int) -> Chunk:
        start = index * CHUNK_BYTES
        return Chunk(self.offer.name, self.offer.checksum, index, self._data[start : start + CHUNK_BYTES])


class DataReceiver:
    """The other side: keeps the chunks of the newest offer; `data` is the whole once its checksum matches.

    A chunk is kept only while it fits the offer; should the whole not match, all of it is asked for again.
    """

    def __init__(self) -> None:
        self.data: bytes | None = None
        self._offer: Offer | None = None
        self._chunks: dict[int, bytes] = {}
        self._answer_due = False

    @property
    def offer(self) -> Offer | None:
        """What is being received."""
        return self._offer

    def handle(self, message: Offer | Chunk) -> None:
        """Take in what came, in any order and any number of times."""
        if isinstance(message, Offer):
            self._take_offer(message)
        else:
            self._take_chunk(message)

    def answer(self) -> Missing | None:
        """What to tell the sender, None where nothing has come since the last answer."""
        if self._offer is None or not self._answer_due:
            return None
        self._answer_due = False
        spans = () if self.data is not None else tuple(_spans(self._lacking())[:MAX_MISSING])
        return Missing(self._offer.name, self._offer.checksum, spans)

    def _take_offer(self, offer: Offer) -> None:
        if offer != self._offer:
            self._offer, self._chunks, self.data = offer, {}, None
        self._answer_due = True

    def _take_chunk(self, chunk: Chunk) -> None:
        offer = self._offer
        if offer is None or (chunk.name, chunk.checksum) != (offer.name, offer.checksum):
            return
        self._answer_due = True
        if self.data is not None or len(chunk.payload) != self._length(offer, chunk.index):
            return
        self._chunks[chunk.index] = chunk.payload
        if not self._lacking():
            self._join(offer)

    def _join(self, offer: Offer) -> None:
        whole = b"".join(self._chunks[k] for k in sorted(self._chunks))
        if crc32c(whole) == offer.checksum:
            self.data = whole
        self._chunks = {}

    def _lacking(self) -> list[int]:
        assert self._offer is not None
        return [k for k in range(self._offer.chunks) if k not in self._chunks]

    def _length(self, offer: Offer, index: int) -> int:
        """Bytes of a chunk of the offer, 0 (which no chunk has) beyond its end."""
        return max(0, min(CHUNK_BYTES, offer.length - index * CHUNK_BYTES))


def _spans(indices: list[int]) -> list[ChunkRange]:
    """Ascending runs of consecutive indices."""
    spans: list[ChunkRange] = []
    for index in indices:
        if spans and index == spans[-1].first + spans[-1].count:
            spans[-1] = ChunkRange(spans[-1].first, spans[-1].count + 1)
        else:
            spans.append(ChunkRange(index, 1))
    return spans
