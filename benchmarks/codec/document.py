"""The page of the results for the documentation: tables of the test worlds, equal quality on all, plots."""

from __future__ import annotations

from pathlib import Path

from benchmarks.codec import report, summary
from benchmarks.codec.ours import SERIES
from benchmarks.codec.peers.quadtree import PrototypeQuadtree

PAGE = "codec_results.md"
_INTRODUCTION = """# Results of the keyframe codecs

Written by `python -m benchmarks.codec --out DIR --docs docs`; metric and codecs:
[codec.md](codec.md). Bytes are those of whole keyframes with pose, codec number and checksum. Test
scans: 60 each of generated buildings and caves (seeds 1000 to 1002) and of `pittsburgh_mine_plan`
with a rough roof, per LiDAR; *other* worlds are meshes that nothing was tuned or trained on.
Simulated scans, 2 cm range noise, 2 % lost pulses.

- `marsupial`: the quadtree at fixed quality; `marsupial_budget`: at a fixed budget for every scan;
  `marsupial_exact`: the exact codec.
- `prototype_quadtree`: a quadtree with the same idea and no rate-distortion search, its settings as
  published with it, its contexts trained on the same scans.
- `paper_vae`: the paper's network as we could train it ([codec_learned.md](codec_learned.md));
  `_coded`: with our coded latents.

Times are milliseconds of one thread on the machine that ran this, median (99th percentile), beside
other work.
"""


def write_page(results: report.Results, docs: Path) -> None:
    """docs/codec_results.md and its pictures."""
    parts = [_INTRODUCTION]
    for sensor in dict.fromkeys(sensor for sensor, _ in results):
        picture = docs / "images" / f"codec-{sensor}.png"
        report.draw(results, sensor, picture)
        parts.append(f"## {sensor}\n\n![F1 and unsafe26 over bytes](images/{picture.name})")
        parts += [_section(results, sensor, split) for found, split in results if found == sensor]
    (docs / PAGE).write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _section(results: report.Results, sensor: str, split: str) -> str:
    found = results[sensor, split]
    equal = summary.comparisons(found, SERIES, PrototypeQuadtree.series)
    tables = report.main_table(found), "At equal F1:", report.equal_table(equal)
    return "\n\n".join((f"### {sensor}, {split} worlds", *tables))
