"""CRC and counter of AUTOSAR E2E profile 5: the standard's example, and an independent implementation."""

from __future__ import annotations

import random

import pytest
from crccheck.crc import Crc16Ibm3740

from drivers.can_protection import Sequence, checksum, intact, protected


def test_it_gives_what_the_standard_gives_for_its_example():
    assert protected(bytes(8), 0x1234) == bytes.fromhex("1cca000000000000")
    assert checksum(bytes(8), 0x1234) == 0xCA1C


def test_it_is_ccitt_false_over_counter_payload_and_data_id():
    rng = random.Random(1)
    for length in range(3, 9):
        data, data_id = rng.randbytes(length), rng.randrange(0x800)
        expected = Crc16Ibm3740.calc(data[2:] + bytes([data_id & 0xFF, data_id >> 8]))
        assert protected(data, data_id) == expected.to_bytes(2, "little") + data[2:]
        assert intact(protected(data, data_id), data_id)
        assert not intact(protected(data, data_id), data_id ^ 1)


def test_a_frame_without_room_for_its_header_is_not_intact():
    assert not intact(b"", 0x110)
    assert not intact(protected(b"\0\0", 0x110), 0x110)
    assert intact(protected(b"\0\0\0", 0x110), 0x110)


def followed(*counters: int, start_s: float = 0.0, step_s: float = 0.1) -> tuple[Sequence, list[bool]]:
    sequence = Sequence()
    return sequence, [sequence.take(start_s + n * step_s, counter) for n, counter in enumerate(counters)]


def test_a_sender_is_trusted_from_its_third_frame_in_sequence():
    sequence, taken = followed(7, 8, 9, 10)
    assert taken == [False, False, True, True]
    assert sequence.refused == 0


@pytest.mark.parametrize(("step", "good"), [(0, False), (1, True), (15, True), (16, False), (255, False)])
def test_steps_of_the_counter(step, good):
    sequence, taken = followed(250, 251, 252, (252 + step) % 256)
    assert taken[-1] is good
    assert sequence.refused == (0 if good else 1)


def test_after_a_refused_frame_the_sender_goes_on_where_it_was():
    _, taken = followed(1, 2, 3, 3, 99, 4)
    assert taken == [False, False, True, False, False, True]


def test_a_silent_sender_is_lost_at_half_a_second_and_starts_anew():
    sequence, _ = followed(1, 2, 3)
    assert sequence.alive(0.2)
    assert sequence.alive(0.69)
    assert not sequence.alive(0.71)
    assert not sequence.alive(0.19)  # time went backwards
    assert [sequence.take(0.71 + n / 10, 4 + n) for n in range(3)] == [False, False, True]


def test_half_a_second_is_lost_exactly():
    sequence = Sequence()
    for counter in range(3):
        sequence.take(0.0, counter)
    assert sequence.alive(0.0)
    assert not sequence.alive(0.5)


def test_nobody_is_alive_before_the_first_frame():
    assert not Sequence().alive(0.0)


def test_a_stuck_counter_never_becomes_alive():
    sequence, taken = followed(*[5] * 40)
    assert not any(taken)
    assert not sequence.alive(3.9)
