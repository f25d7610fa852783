"""The keyframe store: idempotence, digests, and a log that survives being killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.errors import InputError
from onboard.sharing.keyframe_store import KeyframeStore
from onboard.sharing.messages import MAX_RANGES, Digest, KeyframeMessage, SourceRanges


def keyframe(source: int, sequence: int, payload: bytes = b"payload") -> KeyframeMessage:
    return KeyframeMessage(source, sequence, 0.5 * sequence, payload + bytes([sequence % 256]))


def filled(path: Path, count: int) -> KeyframeStore:
    store = KeyframeStore(path)
    for sequence in range(count):
        store.insert(keyframe(sequence % 3, sequence))
    return store


def test_inserting_twice_keeps_the_first() -> None:
    store = KeyframeStore()
    assert store.insert(keyframe(1, 4))
    assert not store.insert(keyframe(1, 4, b"other"))
    assert len(store) == 1
    assert (1, 4) in store
    assert store[1, 4].payload.startswith(b"payload")


@given(st.lists(st.integers(0, 30), unique=True), st.integers(0, 255))
def test_digest_describes_exactly_what_is_held(sequences: list[int], source: int) -> None:
    store = KeyframeStore()
    for sequence in sequences:
        store.insert(keyframe(source, sequence))
    ranges = [r for entry in store.digest().sources for r in entry.ranges]
    assert [s for first, count in ranges for s in range(first, first + count)] == sorted(sequences)
    assert all(a + n < b for (a, n), (b, _) in pairwise(ranges))
    assert store.next_sequence(source) == max(sequences, default=-1) + 1


@given(
    st.sets(st.tuples(st.integers(0, 3), st.integers(0, 20))),
    st.sets(st.tuples(st.integers(0, 3), st.integers(0, 20))),
)
def test_missing_is_the_difference(ours: set[tuple[int, int]], theirs: set[tuple[int, int]]) -> None:
    mine, other = KeyframeStore(), KeyframeStore()
    for key in sorted(ours):
        mine.insert(keyframe(*key))
    for key in sorted(theirs):
        other.insert(keyframe(*key))
    assert set(mine.missing(other.digest())) == ours - theirs


def test_missing_keeps_the_order_of_arrival() -> None:
    store = KeyframeStore()
    for sequence in (5, 2, 9):
        store.insert(keyframe(0, sequence))
    assert store.missing(Digest(0.0, (SourceRanges(0, ((2, 1),)),))) == [(0, 5), (0, 9)]


def test_a_digest_of_very_many_gaps_is_bounded_and_lists_the_oldest() -> None:
    store = KeyframeStore()
    for sequence in range(0, 200, 2):
        store.insert(keyframe(0, sequence))
    ranges = store.digest().sources[0].ranges
    assert ranges == tuple((s, 1) for s in range(0, 2 * MAX_RANGES, 2))


def test_log_is_read_back_in_order(tmp_path: Path) -> None:
    path = tmp_path / "keyframes.log"
    first = filled(path, 10)
    first.close()
    again = KeyframeStore(path)
    assert list(again) == list(first)
    again.insert(keyframe(7, 70))
    again.close()
    assert len(KeyframeStore(path)) == 11


def test_every_torn_tail_is_cut_and_writing_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "keyframes.log"
    filled(path, 3).close()
    whole = path.read_bytes()
    record = (len(whole) - 8) // 3
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        store = KeyframeStore(path)
        assert len(store) == max(size - 8, 0) // record
        store.insert(keyframe(9, 99))
        store.close()
        again = KeyframeStore(path)
        assert (9, 99) in again
        assert len(again) == len(store)
        again.close()


def test_garbage_behind_the_last_record_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "keyframes.log"
    filled(path, 3).close()
    size = path.stat().st_size
    for garbage in (bytes(100), b"\xff" * 100):
        with path.open("ab") as file:
            file.write(garbage)
        store = KeyframeStore(path)
        assert len(store) == 3
        store.close()
        assert path.stat().st_size == size


def test_a_flipped_bit_costs_one_keyframe(tmp_path: Path) -> None:
    path = tmp_path / "keyframes.log"
    filled(path, 5).close()
    data = bytearray(path.read_bytes())
    record = (len(data) - 8) // 5
    data[8 + record + 20] ^= 1
    path.write_bytes(bytes(data))
    assert [k.sequence for k in KeyframeStore(path)] == [0, 2, 3, 4]


def test_a_foreign_file_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(b"something precious")
    with pytest.raises(InputError, match=r"notes\.txt"):
        KeyframeStore(path)
    assert path.read_bytes() == b"something precious"


def test_kill_minus_nine_loses_nothing_that_was_inserted(tmp_path: Path) -> None:
    path = tmp_path / "keyframes.log"
    script = (
        "import sys; from pathlib import Path\n"
        "from onboard.sharing.keyframe_store import KeyframeStore\n"
        "from onboard.sharing.messages import KeyframeMessage\n"
        "store = KeyframeStore(Path(sys.argv[1]))\n"
        "for i in range(10**6):\n"
        "    store.insert(KeyframeMessage(1, i, 0.0, bytes(1000)))\n"
        "    sys.stdout.write(f'{i}\\n'); sys.stdout.flush()\n"
    )
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", script, str(path)]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=root) as process:
        assert process.stdout is not None
        confirmed = [int(process.stdout.readline()) for _ in range(50)][-1]
        process.send_signal(signal.SIGKILL)
    store = KeyframeStore(path)
    assert [k.sequence for k in store] == list(range(len(store)))
    assert len(store) > confirmed
