"""Large data in chunks over a link that loses, repeats, reorders and corrupts."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.errors import InputError, WireError
from onboard.sharing.frames import pack, unpack
from onboard.sharing.messages import CHUNK_BYTES, MAX_CHUNKS, Chunk, ChunkRange, Missing, Offer
from onboard.sharing.transfer import DataReceiver, DataSender

TICK_S = 0.1


class Air:
    """Both directions of a link: frames are lost, doubled, delayed by up to a second, or broken."""

    def __init__(self, seed: int, loss: float, mess: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._loss, self._mess = loss, mess
        self._flying: list[tuple[float, int, bytes]] = []
        self.frames = 0

    def send(self, now_s: float, frame: bytes) -> None:
        for _ in range(2 if self._rng.random() < self._mess else 1):
            self.frames += 1
            if self._rng.random() < self._loss:
                continue
            broken = bytearray(frame)
            if self._rng.random() < self._mess:
                broken[self._rng.integers(len(frame))] ^= 1 << int(self._rng.integers(8))
            delay_s = self._rng.uniform(0, 1) if self._rng.random() < self._mess else 0.0
            heapq.heappush(self._flying, (now_s + delay_s, self.frames, bytes(broken)))

    def due(self, now_s: float) -> list[bytes]:
        frames = []
        while self._flying and self._flying[0][0] <= now_s:
            frames.append(heapq.heappop(self._flying)[2])
        return frames


def intact(frame: bytes) -> list:
    """What a link would hand on."""
    try:
        return [unpack(frame).message]
    except WireError:
        return []


def exchange(
    air: Air, back: Air, sender: DataSender, receiver: DataReceiver, start_s: float, end_s: float
) -> float:
    """Run both ends until the sender knows that all has arrived; the time at which it does."""
    for tick in range(round(start_s / TICK_S), round(end_s / TICK_S)):
        now_s = tick * TICK_S
        for message in sender.step(now_s):
            air.send(now_s, pack(message, 1, 2))
        for frame in air.due(now_s):
            for message in intact(frame):
                receiver.handle(message)
        answer = receiver.answer()
        if answer is not None:
            back.send(now_s, pack(answer, 2, 1))
        for frame in back.due(now_s):
            for message in intact(frame):
                sender.handle(now_s, message)
        if sender.done:
            return now_s
    return np.inf


def payload(seed: int, length: int) -> bytes:
    return np.random.default_rng(seed).bytes(length)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 30 * CHUNK_BYTES),
    st.sampled_from([0.0, 0.2, 0.5, 0.8]),
    st.sampled_from([0.0, 0.3]),
)
def test_everything_arrives_whole_whatever_the_link_does(seed, length, loss, mess):
    data = payload(seed, length)
    sender, receiver = DataSender(7, data), DataReceiver()
    exchange(Air(seed, loss, mess), Air(seed + 1, loss, mess), sender, receiver, 0.0, 900.0)
    assert sender.done
    assert receiver.data == data


def test_a_clean_link_carries_every_chunk_once():
    data = payload(1, 100 * CHUNK_BYTES - 5)
    air, back = Air(1, 0.0, 0.0), Air(2, 0.0, 0.0)
    took_s = exchange(air, back, DataSender(0, data), DataReceiver(), 0.0, 60.0)
    offers = took_s / 0.5 + 1
    assert air.frames <= 100 + offers
    assert took_s < 2.0


def test_loss_costs_what_was_lost_and_little_more():
    data = payload(3, 200 * CHUNK_BYTES)
    air = Air(3, 0.3, 0.0)
    took_s = exchange(air, Air(4, 0.3, 0.0), DataSender(0, data), DataReceiver(), 0.0, 600.0)
    assert took_s < 60.0
    assert air.frames < 1.5 * 200 / 0.7 + 2 * took_s


def test_either_side_may_begin_anew_and_the_chunks_that_are_there_stay():
    data = payload(5, 60 * CHUNK_BYTES)
    air, back = Air(5, 0.1, 0.0), Air(6, 0.1, 0.0)
    receiver = DataReceiver()
    assert exchange(air, back, DataSender(9, data), receiver, 0.0, 0.4) == np.inf
    before = air.frames
    assert before > 15
    exchange(air, back, DataSender(9, data), receiver, 0.4, 60.0)
    assert receiver.data == data
    assert air.frames - before < 60
    fresh = DataReceiver()
    sender = DataSender(9, data)
    exchange(air, back, sender, DataReceiver(), 60.0, 60.5)
    exchange(air, back, sender, fresh, 60.5, 120.0)
    assert fresh.data == data


def test_a_newer_offer_replaces_what_is_under_way():
    old, new = payload(7, 40 * CHUNK_BYTES), payload(8, 25 * CHUNK_BYTES)
    air, back, receiver = Air(7, 0.2, 0.3), Air(8, 0.2, 0.3), DataReceiver()
    exchange(air, back, DataSender(1, old), receiver, 0.0, 0.5)
    exchange(air, back, DataSender(2, new), receiver, 0.5, 120.0)
    assert receiver.data == new
    assert receiver.offer is not None
    assert receiver.offer.name == 2


def test_a_whole_that_does_not_match_its_checksum_is_asked_for_again():
    data = payload(9, 3 * CHUNK_BYTES)
    sender, receiver = DataSender(3, data), DataReceiver()
    receiver.handle(sender.offer)
    name, checksum = sender.offer.name, sender.offer.checksum
    for index in range(3):
        receiver.handle(Chunk(name, checksum, index, bytes(CHUNK_BYTES)))
    assert receiver.data is None
    assert receiver.answer() == Missing(name, checksum, (ChunkRange(0, 3),))


def test_chunks_that_do_not_belong_are_dropped():
    receiver = DataReceiver()
    receiver.handle(Chunk(1, 2, 0, b"early"))
    assert receiver.answer() is None
    receiver.handle(Offer(1, 2 * CHUNK_BYTES - 1, 2))
    for index, length in ((0, 5), (1, CHUNK_BYTES), (2, CHUNK_BYTES), (MAX_CHUNKS - 1, 0)):
        receiver.handle(Chunk(1, 2, index, bytes(length)))
    answer = receiver.answer()
    assert answer is not None
    assert answer.spans == (ChunkRange(0, 2),)


def test_answers_to_other_offers_do_not_end_a_transfer():
    sender = DataSender(4, b"abc")
    for name, checksum in ((5, sender.offer.checksum), (4, sender.offer.checksum ^ 1)):
        sender.handle(0.0, Missing(name, checksum, ()))
    assert not sender.done
    sender.handle(0.0, Missing(4, sender.offer.checksum, ()))
    assert sender.done
    assert sender.step(10.0) == []


@pytest.mark.parametrize("length", [0, MAX_CHUNKS * CHUNK_BYTES + 1])
def test_what_does_not_fit_is_refused_at_once(length):
    with pytest.raises(InputError):
        DataSender(0, bytes(length))
