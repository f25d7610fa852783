"""The mixing coder: exact tables, round trips, size against the ideal, truncated streams, priors."""

from __future__ import annotations

import math
from decimal import Decimal, getcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.codec.logistic import SQUASH, STRETCH, STRETCH_LIMIT, STRETCH_UNIT
from onboard.codec.mixing_coder import (
    MixingCoder,
    bytes_beyond_end,
    certain,
    code_direct,
    code_even,
    code_mixed,
    code_mixed_by_two,
    failed,
    finish,
    finished_cleanly,
    new_reader,
    new_writer,
)
from onboard.codec.priors import Priors, fresh_priors, load_priors, save_priors, trained_priors
from onboard.core.errors import InputError

PRIORS = fresh_priors((8, 8, 16), 4, 4)
Event = tuple[int, int, int]
"""Kind of coding (0 mixed, 1 by two sets, 2 direct, 3 even), context, bit."""


def code(coder: MixingCoder, event: Event, bit: int) -> int:
    kind, context, _ = event
    coder.slots[:] = (context, context ^ 3, context * 2)
    if kind == 0:
        return int(code_mixed(coder, context & 3, bit))
    if kind == 1:
        return int(code_mixed_by_two(coder, context & 1, 2 + (context >> 2), bit))
    return int(code_direct(coder, context & 3, bit) if kind == 2 else code_even(coder, bit))


def write(events: list[Event], priors: Priors = PRIORS, max_bytes: int = 100_000) -> bytes:
    coder = new_writer(max_bytes, priors)
    for event in events:
        assert code(coder, event, event[2]) == event[2]
    data = finish(coder)
    assert not failed(coder)
    return data


def read(data: bytes, events: list[Event], priors: Priors = PRIORS) -> tuple[list[int], MixingCoder]:
    coder = new_reader(data, priors)
    return [code(coder, event, 0) for event in events], coder


def random_events(count: int, rate: float, seed: int) -> list[Event]:
    rng = np.random.default_rng(seed)
    bits = rng.random(count) < rate
    kinds, contexts = rng.integers(0, 4, count), rng.integers(0, 8, count)
    return [(int(k), int(c), int(b)) for k, c, b in zip(kinds, contexts, bits, strict=True)]


def test_squash_is_the_rounded_logistic_function() -> None:
    getcontext().prec = 40
    for x in (*range(-STRETCH_LIMIT, STRETCH_LIMIT + 1, 37), 0, 1, STRETCH_LIMIT):
        exact = 65536 / (1 + (Decimal(-x) / STRETCH_UNIT).exp())
        assert abs(exact - int(SQUASH[x + STRETCH_LIMIT])) <= Decimal("0.5"), x


def test_squash_leaves_both_bits_possible_and_a_certain_one_cheap() -> None:
    assert SQUASH.min() >= 1
    assert SQUASH.max() <= 65535
    assert -math.log2(SQUASH.max() / 65536) < 0.001


def test_stretch_is_the_rounded_inverse() -> None:
    getcontext().prec = 40
    for i in (*range(0, 65536, 331), 32767, 32768, 65535):
        exact = STRETCH_UNIT * (Decimal(2 * i + 1) / Decimal(131071 - 2 * i)).ln()
        clipped = min(max(exact, Decimal(-STRETCH_LIMIT)), Decimal(STRETCH_LIMIT))
        assert abs(clipped - int(STRETCH[i])) <= Decimal("0.5"), i


@settings(max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 7), st.integers(0, 1)), max_size=200))
def test_round_trip(events: list[Event]) -> None:
    bits, coder = read(write(events), events)
    assert bits == [event[2] for event in events]
    assert finished_cleanly(coder)


def test_long_runs_and_their_breaks_carry_correctly() -> None:
    for rate in (0.001, 0.05, 0.5, 0.98, 0.9995):
        events = random_events(10_000, rate, 3)
        bits, coder = read(write(events), events)
        assert bits == [event[2] for event in events]
        assert finished_cleanly(coder)


def mixture(count: int) -> tuple[list[Event], float]:
    """Bits whose log-odds are sums over contexts, and their entropy in bytes."""
    rng = np.random.default_rng(5)
    contexts = rng.integers(0, 8, count)
    chances = 1 / (1 + np.exp(-(contexts - 5.5)))
    bits = rng.random(count) < chances
    entropy = -np.where(bits, np.log2(chances), np.log2(1 - chances)).sum() / 8
    return [(0, int(c), int(b)) for c, b in zip(contexts, bits, strict=True)], float(entropy)


def test_size_is_near_the_entropy() -> None:
    events, entropy = mixture(40_000)
    assert len(write(events)) < 1.03 * entropy


def test_training_helps_and_survives_the_file(tmp_path: Path) -> None:
    events, _ = mixture(2_000)
    coder = new_writer(100_000, PRIORS)
    for event in mixture(40_000)[0]:
        code(coder, event, event[2])
    learned = trained_priors(PRIORS, coder, 60)
    save_priors(tmp_path / "priors.npz", learned)
    loaded = load_priors(tmp_path / "priors.npz")
    fresh, trained, from_file = (len(write(events, priors)) for priors in (PRIORS, learned, loaded))
    assert trained < 0.98 * fresh
    assert abs(from_file - trained) <= 2
    bits, _ = read(write(events, loaded), events, loaded)
    assert bits == [event[2] for event in events]


def test_counts_are_capped() -> None:
    coder = new_writer(100_000, PRIORS)
    for event in random_events(3_000, 0.5, 6):
        code(coder, event, event[2])
    learned = trained_priors(PRIORS, coder, 20)
    assert int((coder.models & np.uint32(1023)).max()) > 20
    assert int((learned.models & np.uint32(1023)).max()) == 20


def test_bad_prior_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "priors.npz"
    with pytest.raises(InputError, match="priors"):
        load_priors(path)
    np.savez(path, sizes=np.array([1]))
    with pytest.raises(InputError, match="priors"):
        load_priors(path)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match="priors"):
        load_priors(path)


def test_priors_are_not_changed_by_coding() -> None:
    before = [array.copy() for array in (PRIORS.models, PRIORS.direct, PRIORS.weights)]
    write(random_events(500, 0.3, 7))
    for old, new in zip(before, (PRIORS.models, PRIORS.direct, PRIORS.weights), strict=True):
        assert np.array_equal(old, new)


@pytest.mark.parametrize("rate", [0.02, 0.3])
def test_every_prefix_decodes_up_to_its_first_uncertain_bit(rate: float) -> None:
    events = random_events(1_500, rate, 8)
    data = write(events)
    covered = []
    for size in range(0, len(data) + 1, 7):
        coder = new_reader(data[:size], PRIORS)
        count = 0
        for event in events:
            bit = code(coder, event, 0)
            if not certain(coder):
                break
            assert bit == event[2]
            count += 1
        covered.append(count)
    assert covered == sorted(covered)
    assert covered[0] < 40
    assert covered[-1] > 0.9 * len(events)


def test_certain_bits_do_not_depend_on_what_follows() -> None:
    events = random_events(400, 0.4, 9)
    data = write(events)[:20]
    rng = np.random.default_rng(10)
    coder = new_reader(data, PRIORS)
    count = 0
    while code(coder, events[count], 0) >= 0 and certain(coder):
        count += 1
    assert count > 50
    for _ in range(20):
        bits, _ = read(data + rng.bytes(8), events[:count])
        assert bits == [event[2] for event in events[:count]]


def test_reading_past_the_end_is_counted() -> None:
    events = random_events(3_000, 0.5, 11)
    bits, coder = read(b"\x12\x34", events)
    assert len(bits) == 3_000
    assert not certain(coder)
    assert bytes_beyond_end(coder) > 100
    assert not finished_cleanly(coder)


def test_a_full_buffer_is_reported_not_overrun() -> None:
    coder = new_writer(16, PRIORS)
    for event in random_events(1_000, 0.5, 12):
        code(coder, event, event[2])
    finish(coder)
    assert failed(coder)
    assert coder.buffer.size == 16
