"""Who may speak: signatures, replays, the key's file."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from drivers.mavlink.signing import UNITS_PER_S, Signer, load_signer, stamp_of, store_key
from onboard.core.errors import InputError

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
NOW = stamp_of(1_800_000_000.0)


def beat(mode: int = 0) -> object:
    return message["HEARTBEAT"](2, 12, 81, mode, 4, 3)


def test_signed_frames_pass_and_all_others_are_counted() -> None:
    sender, receiver = Channel(1, 1, Signer(KEY, NOW)), Channel(2, 2, Signer(KEY, NOW))
    first = sender.pack(beat())
    assert len(receiver.receive(first)) == 1
    assert receiver.receive(first) == []
    assert receiver.receive(Channel(1, 1).pack(beat())) == []
    assert receiver.receive(Channel(1, 1, Signer(OTHER, NOW)).pack(beat())) == []
    late = Channel(1, 9, Signer(KEY, NOW - 61 * UNITS_PER_S))
    assert receiver.receive(late.pack(beat())) == []
    counts = receiver.counts
    assert (counts.received, counts.unsigned, counts.wrong_signature, counts.replayed) == (1, 1, 1, 2)
    assert counts.refused == 4
    assert len(receiver.receive(sender.pack(beat()))) == 1


def test_forged_stamp_of_the_future_locks_nobody_out() -> None:
    receiver, sender = Channel(2, 2, Signer(KEY, NOW)), Channel(1, 1, Signer(KEY, NOW))
    forged = Channel(1, 1, Signer(OTHER, NOW + 10**9))
    receiver.receive(forged.pack(beat()))
    assert len(receiver.receive(sender.pack(beat()))) == 1


def test_without_the_duty_everything_passes() -> None:
    receiver = Channel(2, 2, Signer(bytes(32), NOW, required=False))
    assert len(receiver.receive(Channel(1, 1).pack(beat()))) == 1
    assert len(receiver.receive(Channel(1, 1, Signer(OTHER)).pack(beat()))) == 1


@given(st.integers(0, 40), st.integers(1, 255))
def test_no_flipped_byte_passes(place: int, flip: int) -> None:
    sender, receiver = Channel(1, 1, Signer(KEY, NOW)), Channel(2, 2, Signer(KEY, NOW))
    frame = bytearray(sender.pack(beat(7)))
    frame[place % len(frame)] ^= flip
    assert receiver.receive(bytes(frame)) == []


def test_key_file_is_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "key"
    store_key(path, KEY, 5)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert load_signer(path, 0.0).key == KEY
    path.chmod(0o640)
    with pytest.raises(InputError, match="chmod 0600"):
        load_signer(path, 0.0)


@pytest.mark.parametrize("size", [0, 31, 33, 41])
def test_key_file_of_another_size_is_refused(tmp_path: Path, size: int) -> None:
    path = tmp_path / "key"
    path.write_bytes(bytes(size))
    path.chmod(0o600)
    with pytest.raises(InputError, match="bytes"):
        load_signer(path, 0.0)
    with pytest.raises(InputError):
        load_signer(tmp_path / "none", 0.0)


def test_stamps_never_repeat_even_when_the_clock_runs_back(tmp_path: Path) -> None:
    path = tmp_path / "key"
    store_key(path, KEY, 0)
    newest = 0
    for unix_s in (1_800_000_000.0, 1_700_000_000.0, 1_800_000_001.0):
        signer = load_signer(path, unix_s)
        channel = Channel(1, 1, signer)
        for _ in range(50):
            stamp = int.from_bytes(channel.pack(beat())[-12:-6], "little")
            assert stamp > newest
            newest = stamp


def test_stamp_follows_the_clock() -> None:
    signer = Signer(KEY, NOW)
    signer.advance(1_800_000_010.0)
    assert signer.timestamp == NOW + 10 * UNITS_PER_S
    signer.advance(1_700_000_000.0)
    assert signer.timestamp == NOW + 10 * UNITS_PER_S
