"""Tables in Markdown and the rate-distortion plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import tables
from benchmarks.codec.summary import ALL, Comparison, Point, curve

Results = Mapping[tuple[str, str], Sequence[Point]]
"""Points by (sensor, split)."""

_COLUMNS = (
    "codec",
    "bytes (median)",
    *("F1", "occ IoU", "knn6", "free IoU", "unsafe", "unsafe26", "ghost"),
    *("enc ms (p99)", "dec ms (p99)"),
)
_WORLD_COLUMNS = ("codec", "world", "scans", "bytes", "F1", "unsafe26")
_EQUAL_COLUMNS = ("world", "F1", "ours B", "peer B", "ours / peer", "ours unsafe26", "peer unsafe26")


def main_table(found: Sequence[Point]) -> str:
    """One row for each setting, means over all scans."""
    return tables.markdown(_COLUMNS, [_row(point) for point in found if point.world == ALL])


def _row(point: Point) -> list[str]:
    s = point.similarity
    return [
        f"{point.series} {point.setting}",
        f"{point.size_bytes:.0f} ({point.median_bytes:.0f})",
        f"{s.f1:.4f}",
        *(f"{value:.3f}" for value in (s.occ_iou, s.knn6, s.free_iou, s.unsafe)),
        *(f"{value:.4f}" for value in (s.unsafe26, s.ghost)),
        *(f"{median:.1f} ({late:.1f})" for median, late in (point.encode_ms, point.decode_ms)),
    ]


def world_table(found: Sequence[Point]) -> str:
    """One row for each setting and kind of world."""
    rows = [
        [
            f"{point.series} {point.setting}",
            point.world,
            str(point.scans),
            f"{point.size_bytes:.0f}",
            f"{point.similarity.f1:.4f}",
            f"{point.similarity.unsafe26:.4f}",
        ]
        for point in found
        if point.world != ALL
    ]
    return tables.markdown(_WORLD_COLUMNS, rows)


def equal_table(found: Sequence[Comparison]) -> str:
    """Both series at equal F1; a dash where a curve does not get there."""
    rows = [
        [
            item.world,
            f"{item.f1:.2f}",
            *(_number(value, "{:.0f}") for value in (item.ours_bytes, item.peer_bytes)),
            _number(item.ratio, "{:.2f}"),
            *(_number(value, "{:.4f}") for value in (item.ours_unsafe26, item.peer_unsafe26)),
        ]
        for item in found
    ]
    return tables.markdown(_EQUAL_COLUMNS, rows)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def draw(results: Results, sensor: str, path: Path) -> None:
    """F1 and unsafe26 over bytes (log): every series, each split in its own line style. Writes a PNG."""
    from matplotlib.figure import Figure  # noqa: PLC0415  (costs a second)

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    axes = figure.subplots(1, 2)
    splits = [split for found, split in results if found == sensor]
    for split, style in zip(splits, ("-", "--", ":", "-."), strict=False):
        found = results[sensor, split]
        for k, series in enumerate(dict.fromkeys(point.series for point in found)):
            line = curve(found, series)
            sizes = [point.size_bytes for point in line]
            look = {"color": f"C{k}", "linestyle": style, "marker": ".", "label": f"{series}, {split}"}
            axes[0].plot(sizes, [point.similarity.f1 for point in line], **look)
            axes[1].plot(sizes, [max(point.similarity.unsafe26, 1e-5) for point in line], **look)
    for axis, name in zip(axes, ("F1 of occupied voxels", "unsafe26 (1e-5: none)"), strict=True):
        axis.set(xscale="log", xlabel="bytes per keyframe", ylabel=name, title=sensor)
        axis.grid(visible=True, which="both", alpha=0.3)
    axes[1].set_yscale("log")
    axes[0].legend()
    figure.savefig(path, dpi=110)
