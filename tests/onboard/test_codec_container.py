"""The frame around payloads: layout, references, and every refusal that needs no payload coder."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from keyframe_scenes import with_crc

from onboard.codec.container import (
    EXACT,
    EXACT_MASKED,
    EXACT_REFERENCED,
    LEARNED,
    MAX_BYTES,
    MAX_REFERENCES,
    MIN_BYTES,
    OVERHEAD_BYTES,
    QUADTREE,
    REFERENCED,
    Container,
    pack,
    references_bytes,
    unpack,
)
from onboard.core.crc import crc32c
from onboard.core.errors import CodecError, InputError, WireError
from onboard.core.lidar import MODELS, OS0_64, VLP_16

POSE = bytes(range(12))
sequences = st.sets(st.integers(0, (1 << 32) - 1), min_size=1, max_size=MAX_REFERENCES)


def test_crc32c_check_value() -> None:
    assert crc32c(b"123456789") == 0xE3069283
    assert crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, appendix B.4
    assert crc32c(b"") == 0


def test_layout() -> None:
    data = pack(Container(QUADTREE, OS0_64, POSE, b"abc"))
    assert len(data) == OVERHEAD_BYTES + 3 == 20
    assert data[0] == 2 << 5 | 1 << 2 | 2
    assert data[1:13] == POSE
    assert data[13:16] == b"abc"
    assert int.from_bytes(data[16:], "little") == crc32c(data[:16])


@given(
    st.sampled_from([QUADTREE, EXACT, LEARNED, EXACT_MASKED]),
    st.sampled_from(list(MODELS.values())),
    st.binary(min_size=12, max_size=12),
    st.binary(min_size=1, max_size=60),
)
def test_round_trip(codec: int, model: object, pose: bytes, payload: bytes) -> None:
    container = Container(codec, model, pose, payload)  # type: ignore[arg-type]
    assert unpack(pack(container)) == container


@given(sequences, st.binary(min_size=1, max_size=60), st.sampled_from(REFERENCED))
def test_references_round_trip(numbers: set[int], payload: bytes, codec: int) -> None:
    container = Container(codec, VLP_16, POSE, payload, tuple(sorted(numbers)))
    data = pack(container)
    assert unpack(data) == container
    assert len(data) == OVERHEAD_BYTES + len(payload) + references_bytes(container.references)


@pytest.mark.parametrize("numbers", [(), (2, 1), (1, 1), (-1, 3), (1, 1 << 32), tuple(range(17))])
def test_unusable_references_are_refused(numbers: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="sequence numbers"):
        pack(Container(EXACT_REFERENCED, VLP_16, POSE, b"x", numbers))


@pytest.mark.parametrize(
    "listed",
    [b"\x00", b"\x11" + bytes(68), b"\x02\x01\0\0\0\x01\0\0\0xx", b"\x02\x01\0\0\0", b"\x01\x05\0\0\0"],
    ids=["none", "too many", "twice the same", "cut", "no payload"],
)
def test_bad_lists_of_references_are_refused(listed: bytes) -> None:
    head = bytes([2 << 5 | EXACT_REFERENCED << 2 | 1])
    with pytest.raises(CodecError, match=r"references|payload"):
        unpack(with_crc(head + POSE + listed))


@pytest.mark.parametrize(
    ("head", "why"),
    [
        (1 << 5 | 1 << 2 | 1, "version 1"),
        (3 << 5 | 1 << 2 | 1, "version 3"),
        (2 << 5 | 0 << 2 | 1, "unknown codec 0"),
        (2 << 5 | 7 << 2 | 1, "unknown codec 7"),
        (2 << 5 | 1 << 2 | 0, "LiDAR code 0"),
        (2 << 5 | 1 << 2 | 3, "LiDAR code 3"),
    ],
)
def test_bad_heads_with_a_good_checksum_are_refused(head: int, why: str) -> None:
    with pytest.raises(CodecError, match=why):
        unpack(with_crc(bytes([head]) + POSE + b"payload"))


def test_every_single_bit_flip_is_refused() -> None:
    data = pack(Container(QUADTREE, OS0_64, POSE, np.random.default_rng(1).bytes(100)))
    for bit in range(8 * len(data)):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CodecError):
            unpack(bytes(broken))


def test_sizes_are_checked_before_anything_else() -> None:
    for size in (0, 1, MIN_BYTES - 1, MAX_BYTES + 1):
        with pytest.raises(CodecError, match=f"{size} bytes"):
            unpack(bytes(size))
    with pytest.raises(InputError, match="more than 60000"):
        pack(Container(EXACT, VLP_16, POSE, bytes(MAX_BYTES)))


def test_bad_bytes_are_errors_of_the_link() -> None:
    assert issubclass(CodecError, WireError)
