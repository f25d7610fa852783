"""Test vectors of keyframes: `python -m benchmarks.codec.vectors --write` puts them into docs/codec.md."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.matrix import ROOT
from onboard.codec import Keyframe, decode, encode, truncate
from onboard.core.crc import crc32c
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel, Scan

DOCUMENT = ROOT / "docs" / "codec.md"
BEGIN, END = "<!-- vectors: python -m benchmarks.codec.vectors --write -->\n", "<!-- end of vectors -->\n"
SEQUENCE = 258
POSE = Pose(np.array([12.34, -5.67, 1.5]), np.array([0.0, 0.0, 0.6, 0.8]))
_NO_RETURN_MM = 65535
_HEX_BYTES = 32


def vector_scan(model: LidarModel) -> Scan:
    """3000 + 400 * (column // (W / 8) % 3) + 15 * row mm; no return at column % 64 < 4; a corner unknown."""
    row, column = np.indices((model.rows, model.columns))
    ranges = (3000 + 400 * (column // (model.columns // 8) % 3) + 15 * row) / 1000
    ranges[column % 64 < 4] = np.inf
    ranges[(row < 2) & (column < 10)] = 0
    return Scan(0.0, ranges.astype(np.float32), model)


def blind_scan(model: LidarModel) -> Scan:
    """`vector_scan` of which the second quarter of the columns and every fourth row are unknown."""
    ranges = vector_scan(model).ranges.copy()
    ranges[:, model.columns // 4 : model.columns // 2] = 0
    ranges[3::4] = 0
    return Scan(0.0, ranges, model)


def vectors() -> list[bytes]:
    """Keyframes of `vector_scan`: quadtree of both LiDARs, one cut short, exact, exact with it known.

    Then of `blind_scan`: quadtree, cut short, exact, exact with the other exact one known.
    """
    quadtree = [
        encode(vector_scan(model), POSE, codec="quadtree", budget_bytes=budget)
        for model, budget in ((OS0_64, 120), (VLP_16, 100))
    ]
    exact = encode(vector_scan(VLP_16), POSE, codec="exact")
    known = [(SEQUENCE, decode(exact))]
    blind = encode(blind_scan(OS0_64), POSE, codec="quadtree", budget_bytes=160)
    return [
        *quadtree,
        truncate(quadtree[0], 60),
        exact,
        encode(vector_scan(VLP_16), POSE, codec="exact", references=known),
        blind,
        truncate(blind, 110),
        encode(blind_scan(VLP_16), POSE, codec="exact"),
        encode(blind_scan(VLP_16), POSE, codec="exact", references=known),
    ]


def references(frames: Sequence[bytes]) -> Callable[[int], Keyframe | None]:
    """What the receiver of the vectors holds: the exact one, as keyframe SEQUENCE."""
    return {SEQUENCE: decode(frames[3])}.get


def facts(keyframe: Keyframe) -> dict[str, Any]:
    """What a decoder must get: CRC32C of ranges in mm (u16, 65535: no return) or voxels (3 x i32, sorted)."""
    found: dict[str, Any] = {
        "codec": keyframe.codec,
        "sensor": keyframe.model.name,
        "position_m": keyframe.pose.position.tolist(),
        "quaternion": [round(float(value), 6) for value in keyframe.pose.quaternion],
    }
    if keyframe.cells is None:
        known = np.where(np.isinf(keyframe.ranges), _NO_RETURN_MM / 1000, keyframe.ranges)
        return found | {"ranges_crc32c": f"{crc32c(np.rint(known * 1000).astype('<u2').tobytes()):08x}"}
    for name, cells in zip(("occupied", "free"), keyframe.voxels(), strict=True):
        ordered = cells[np.lexsort(cells.T[::-1])].astype("<i4")
        found |= {name: len(cells), f"{name}_crc32c": f"{crc32c(ordered.tobytes()):08x}"}
    return found


def markdown() -> str:
    """The section of the document."""
    frames = vectors()
    held = references(frames)
    blocks = []
    for frame in frames:
        lines = [frame[i : i + _HEX_BYTES].hex(" ") for i in range(0, len(frame), _HEX_BYTES)]
        blocks.append(f"```json\n{json.dumps(facts(decode(frame, held)))}\n```\n```hex\n" + "\n".join(lines))
    return "".join(f"{block}\n```\n\n" for block in blocks)


def documented(text: str) -> list[tuple[dict[str, Any], bytes]]:
    """Facts and bytes of the vectors in a document."""
    section = text.partition(BEGIN)[2].partition(END)[0]
    found = re.findall(r"```json\n(.*?)\n```\n```hex\n(.*?)\n```", section, flags=re.DOTALL)
    return [(json.loads(fact), bytes.fromhex(dump)) for fact, dump in found]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the vectors, or replace those of the document."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.codec.vectors", description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"replace those in {DOCUMENT.name}")
    if not parser.parse_args(arguments).write:
        Console().print(markdown(), highlight=False, markup=False, soft_wrap=True)
        return 0
    head, _, rest = DOCUMENT.read_text().partition(BEGIN)
    DOCUMENT.write_text(head + BEGIN + "\n" + markdown() + END + rest.partition(END)[2])
    return 0


if __name__ == "__main__":
    sys.exit(main())
