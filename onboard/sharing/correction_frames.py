"""Body of the frame that tells where a robot's keyframes are by now (docs/wire.md)."""

from __future__ import annotations

import itertools
import struct

from onboard.core.errors import WireError
from onboard.sharing.messages import MAX_KNOTS, CorrectionKnot, Corrections, Vector
from onboard.sharing.packing import Reader, checked_count

_SHIFT_STEP_M = 0.005
_TURN_STEP_RAD = 1e-4


def pack_corrections(message: Corrections) -> bytes:
    count = checked_count(len(message.knots), MAX_KNOTS)
    head = struct.pack("<BIH", message.source, message.revision, count)
    return head + b"".join(_pack_knot(knot) for knot in message.knots)


def unpack_corrections(reader: Reader) -> Corrections:
    source, revision = reader.take("BI")
    knots = tuple(_unpack_knot(reader) for _ in range(reader.count("H", MAX_KNOTS)))
    numbers = [knot.sequence for knot in knots]
    if any(after <= before for before, after in itertools.pairwise(numbers)):
        raise WireError("knots of a correction do not ascend")
    return Corrections(source, revision, knots)


def _pack_knot(knot: CorrectionKnot) -> bytes:
    steps = [round(value / _SHIFT_STEP_M) for value in knot.shift_m]
    steps += [round(value / _TURN_STEP_RAD) for value in knot.turn_rad]
    return struct.pack("<I6h", knot.sequence, *steps)


def _unpack_knot(reader: Reader) -> CorrectionKnot:
    sequence, *steps = reader.take("I6h")
    return CorrectionKnot(sequence, _scaled(steps[:3], _SHIFT_STEP_M), _scaled(steps[3:], _TURN_STEP_RAD))


def _scaled(steps: list[int], step: float) -> Vector:
    x, y, z = (value * step for value in steps)
    return x, y, z
