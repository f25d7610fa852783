"""The binary range coder on its own: round trips for any bits, carries, end of stream."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.codec.range_coder import (
    code_bit,
    failed,
    finish,
    finished_cleanly,
    new_reader,
    new_writer,
)


def write(bits: list[int], slots: list[int], max_bytes: int = 100_000) -> bytes:
    coder = new_writer(max_bytes, 8)
    for bit, slot in zip(bits, slots, strict=True):
        assert code_bit(coder, slot, bit) == bit
    data = finish(coder)
    assert not failed(coder)
    return data


def read(data: bytes, slots: list[int]) -> tuple[list[int], bool]:
    coder = new_reader(data, 8)
    bits = [int(code_bit(coder, slot, 0)) for slot in slots]
    return bits, finished_cleanly(coder)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 7)), max_size=300))
def test_round_trip(pairs: list[tuple[int, int]]) -> None:
    bits, slots = [b for b, _ in pairs], [s for _, s in pairs]
    assert read(write(bits, slots), slots) == (bits, True)


def test_long_runs_and_their_breaks_carry_correctly() -> None:
    rng = np.random.default_rng(3)
    for rate in (0.001, 0.02, 0.5, 0.98, 0.999):
        bits = (rng.random(20_000) < rate).astype(int).tolist()
        slots = [0] * len(bits)
        assert read(write(bits, slots), slots) == (bits, True)


def test_size_is_near_the_entropy() -> None:
    rng = np.random.default_rng(4)
    bits = (rng.random(40_000) < 0.1).astype(int).tolist()
    entropy_bytes = 40_000 * -(0.1 * np.log2(0.1) + 0.9 * np.log2(0.9)) / 8
    assert len(write(bits, [0] * len(bits))) < 1.015 * entropy_bytes


def test_a_full_buffer_is_reported_not_overrun() -> None:
    coder = new_writer(16, 1)
    rng = np.random.default_rng(5)
    for bit in rng.integers(0, 2, 1000):
        code_bit(coder, 0, int(bit))
    finish(coder)
    assert failed(coder)
    assert coder.buffer.size == 16


def test_reading_far_past_the_end_is_detected() -> None:
    slots = [0] * 5000
    bits, clean = read(b"\x12\x34", slots)
    assert len(bits) == 5000
    assert not clean
    assert read(b"", slots)[1] is False


def test_left_over_bytes_are_detected() -> None:
    slots = [0] * 50
    data = write([1, 0] * 25, slots)
    for extra in (b"\0", b"x", b"xxxx"):
        assert read(data + extra, slots)[1] is False
