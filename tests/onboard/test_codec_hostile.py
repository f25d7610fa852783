"""Bytes that no encoder wrote: refused with CodecError or decoded to a sane image, never anything else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keyframe_scenes import POSE, room, with_crc

from onboard.codec import Keyframe, decode, encode
from onboard.codec.pose_bits import pack_pose
from onboard.core.errors import CodecError
from onboard.core.lidar import MODELS, VLP_16, LidarModel

CODECS = ("quadtree", "exact")
HEADS = [bytes([2 << 5 | codec << 2 | sensor]) for codec in range(1, 7) for sensor in (1, 2)]


def sane(data: bytes) -> bool:
    """Whether it decodes; if it does, to ranges that a map may use."""
    try:
        keyframe = decode(data)
    except CodecError:
        return False
    check(keyframe)
    return True


def check(keyframe: Keyframe) -> None:
    assert (keyframe.ranges >= 0).all()
    finite = keyframe.ranges[np.isfinite(keyframe.ranges)]
    assert finite.size == 0 or finite.max() <= 20.5


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
def test_every_single_bit_flip_and_every_truncation_is_refused(model: LidarModel, codec: str) -> None:
    data = encode(room(model), POSE, codec=codec)  # type: ignore[arg-type]
    for bit in range(8 * len(data)):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CodecError):
            decode(bytes(broken))
    for size in range(len(data)):
        with pytest.raises(CodecError):
            decode(data[:size])


@pytest.mark.parametrize("codec", CODECS)
def test_streams_that_end_early_or_late_are_refused_even_with_a_good_checksum(codec: str) -> None:
    body = encode(room(VLP_16), POSE, codec=codec)[:-4]  # type: ignore[arg-type]
    for broken in (body[:-4], body[:-20], body[:40], body[:13], body + b"\0\0\0\0", body + b"\1\2\3\4\5"):
        with pytest.raises(CodecError):
            decode(with_crc(broken))


@pytest.mark.parametrize("settings_byte", [3, 7, 35, 64, 128, 255])
def test_quadtree_settings_that_nobody_writes_are_refused(settings_byte: int) -> None:
    with pytest.raises(CodecError):
        decode(with_crc(HEADS[1] + pack_pose(POSE) + bytes([settings_byte]) + bytes(20)))


@settings(max_examples=200)
@given(st.binary(max_size=200), st.sampled_from(HEADS))
def test_any_payload_with_a_good_frame(payload: bytes, head: bytes) -> None:
    sane(with_crc(head + pack_pose(POSE) + payload))


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_any_bytes_at_all(data: bytes) -> None:
    assert not sane(data)
