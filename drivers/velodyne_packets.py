"""Velodyne data packets: what they look like, and the beams of every model as velodyne-decoder knows them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError

PACKET_BYTES = 1206
POSITION_BYTES = 512
BLOCKS, BLOCK_BYTES = 12, 100
BLOCK_HEADER = b"\xff\xee"
HOUR_S = 3600.0
TIME_END_US = 3_600_500_000
"""Stamps begin anew every hour; a little later is a sensor whose hour is set by its own clock."""
TURN = 36000
"""A revolution in the packet's unit of azimuth, hundredths of a degree clockwise."""
BLOCK_STEP_MAX, PACKET_STEP_MAX = 500, 2000
"""No sensor turns faster than this from block to block and within a packet."""
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
RETURN_MODES = (STRONGEST, LAST, DUAL)
PRODUCTS = {0x21: "HDL-32E", 0x22: "VLP-16", 0x24: "Puck Hi-Res", 0x28: "VLP-32C"}
"""Factory byte at the end of a data packet (Velodyne user manuals, 'factory bytes')."""
VLP_16_PRODUCT = 0x22
UNREADABLE = {0x23: "VLP-32A or B", 0x31: "Velarray", 0xA1: "VLS-128"}
"""Products whose packets have another layout."""

_BLOCK_HEADS = struct.Struct("<" + "HH96x" * BLOCKS)
_BLOCK_FLAGS = (0xEEFF,) * BLOCKS
_TAIL = struct.Struct("<IBB")
_PROBE_UNITS = 60_000


@dataclass(frozen=True, slots=True)
class PacketHead:
    """A data packet without its returns: block azimuths (12,) in 0.01 deg, microseconds since the hour.

    `sound`: whether block headers, return mode and time can be.
    """

    azimuths: tuple[int, ...]
    time_us: int
    dual: bool
    product: int
    sound: bool


def read_head(payload: bytes) -> PacketHead:
    """The head of a packet of the right length."""
    time_us, mode, product = _TAIL.unpack_from(payload, PACKET_BYTES - _TAIL.size)
    heads = _BLOCK_HEADS.unpack_from(payload)
    sound = heads[::2] == _BLOCK_FLAGS and mode in RETURN_MODES and time_us < TIME_END_US
    return PacketHead(heads[1::2], time_us, mode == DUAL, product, sound)


def is_data_packet(payload: bytes) -> bool:
    """Whether these are the bytes of one Velodyne data packet: length, block headers, factory bytes."""
    return len(payload) == PACKET_BYTES and payload[-1] in PRODUCTS and read_head(payload).sound


class Segment(NamedTuple):
    """Blocks `first` up to `end` of a packet whose azimuths run on evenly; the other blocks are empty.

    `gap_deg`: how much farther the sensor had turned at its blocks than the packet's times tell.
    """

    payload: bytes
    azimuths: tuple[int, ...]
    first: int
    end: int
    gap_deg: float


def segments(payload: bytes, azimuths: tuple[int, ...]) -> list[Segment]:
    """The packet, or the two halves of one with a gap; empty when no turning sensor has such azimuths.

    A sensor that is set to a field of view skips the rest of the turn between two blocks of one packet and
    does not tell the time of the gap. The blocks on the other side of it get the azimuths that they would
    have without.
    """
    steps = [(b - a) % TURN for a, b in pairwise(azimuths)]
    wide = [index for index, step in enumerate(steps) if step > BLOCK_STEP_MAX]
    even = sum(step for step in steps if step <= BLOCK_STEP_MAX)
    if max(azimuths) >= TURN or len(wide) > 1 or even > PACKET_STEP_MAX:
        return []
    if not wide:
        return [Segment(payload, azimuths, 0, BLOCKS, 0.0)]
    gap = wide[0] + 1
    step = round(even / (len(steps) - 1))
    ahead = tuple((azimuths[gap - 1] + (k - gap + 1) * step) % TURN for k in range(gap, BLOCKS))
    behind = tuple((azimuths[gap] - (gap - k) * step) % TURN for k in range(gap))
    before = payload[: gap * BLOCK_BYTES] + _empty_blocks(ahead) + payload[BLOCKS * BLOCK_BYTES :]
    after = _empty_blocks(behind) + payload[gap * BLOCK_BYTES :]
    return [
        Segment(before, azimuths[:gap] + ahead, 0, gap, 0.0),
        Segment(after, behind + azimuths[gap:], gap, BLOCKS, (steps[gap - 1] - step) * 0.01),
    ]


def _empty_blocks(azimuths: tuple[int, ...]) -> bytes:
    return b"".join(BLOCK_HEADER + struct.pack("<H", azimuth) + b"\0\0\0" * 32 for azimuth in azimuths)


def refusal(payload: bytes, expected: int | None) -> str | None:
    """Why a payload is not from the expected sensor (None: any known product): what came, what to set."""
    wanted = PRODUCTS[expected] if expected is not None else "Velodyne"
    if len(payload) != PACKET_BYTES:
        return (
            f"a packet of {len(payload)} bytes, {wanted} data packets have {PACKET_BYTES}: another device "
            "sends to this port; set its port, or sensor_host to the LiDAR's address"
        )
    product = payload[-1]
    name = PRODUCTS.get(product) or UNREADABLE.get(product) or "no known Velodyne"
    if product not in PRODUCTS:
        known = ", ".join(PRODUCTS.values())
        return f"product id {product:#04x} ({name}) is not supported; supported: {known}"
    if expected is not None and product != expected:
        came = f"packets of a {name} ({product:#04x})"
        return f"{came}, expected a {wanted} ({expected:#04x}): set the LiDAR's model"
    return None


@dataclass(frozen=True, eq=False)
class Beams:
    """Where and when the beams of a model fire, rings from the lowest up.

    `elevations_rad` (L,), `azimuths_rad` (L,) counter-clockwise from the azimuth of the block; `times_s` (F,
    L) of every firing since the packet's stamp; `groups`: azimuths that a packet holds, each for F / groups
    firings.
    """

    elevations_rad: NDArray[np.float64]
    azimuths_rad: NDArray[np.float64]
    times_s: NDArray[np.float64]
    groups: int

    @property
    def dual(self) -> bool:
        """Whether every firing may tell two returns."""
        return self.groups < BLOCKS

    @property
    def cycle_s(self) -> float:
        """From one firing of a beam to its next."""
        return float(self.times_s[1, 0] - self.times_s[0, 0])

    @property
    def packet_s(self) -> float:
        """From one packet to the next."""
        return len(self.times_s) * self.cycle_s

    def rate_deg_s(self, azimuths: tuple[int, ...]) -> float:
        """How fast the sensor turns (clockwise), from the first and last azimuth of a packet."""
        last = (self.groups - 1) * len(self.times_s) // self.groups
        elapsed_s = float(self.times_s[last, 0] - self.times_s[0, 0])
        return (azimuths[-1] - azimuths[0]) % TURN * 0.01 / elapsed_s


def decoder_of(calibration: Path | None) -> Any:
    """A decoder of single packets that keeps every return; with nominal angles unless there is a calibration.

    Raises InputError for a file that is none.
    """
    import velodyne_decoder as library  # noqa: PLC0415  # an extra: the station may do without

    options: dict[str, Any] = {"min_range": 0.0, "max_range": 1000.0}
    if calibration is not None:
        try:
            options["calibration"] = library.Calibration.read(str(calibration))
        except (RuntimeError, ValueError) as error:
            raise InputError(f"{calibration}: not a calibration of a Velodyne ({error})") from error
    return library.ScanDecoder(library.Config(**options))


def decoded(decoder: Any, payload: bytes) -> NDArray[np.float32]:
    """(N, 8) x, y, z, intensity, seconds since the packet's stamp, firing, ring, kind of return."""
    import velodyne_decoder as library  # noqa: PLC0415

    return np.asarray(decoder.decode([library.VelodynePacket(0.0, payload)])[1])


@lru_cache(maxsize=16)
def beams_of(product: int, dual: bool, calibration: Path | None = None) -> Beams:
    """The beams of a product: what velodyne-decoder makes of a packet whose every pulse met something."""
    block = BLOCK_HEADER + struct.pack("<H", 0) + struct.pack("<HB", _PROBE_UNITS, 0) * 32
    payload = block * BLOCKS + _TAIL.pack(0, DUAL if dual else STRONGEST, product)
    cloud = decoded(decoder_of(calibration), payload).astype(np.float64)
    firing, ring = cloud[:, 5].astype(np.int64), cloud[:, 6].astype(np.int64)
    count = int(ring.max()) + 1
    times_s = np.zeros((int(firing.max()) + 1, count))
    times_s[firing, ring] = cloud[:, 4]
    first = cloud[:count][np.argsort(ring[:count])]
    elevations = np.arctan2(first[:, 2], np.hypot(first[:, 0], first[:, 1]))
    return Beams(elevations, np.arctan2(first[:, 1], first[:, 0]), times_s, BLOCKS // 2 if dual else BLOCKS)
