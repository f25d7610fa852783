"""The measurements as tables, with the bounds that they are held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.mapping.measure import BOXES_M, Result
from benchmarks.mapping.published import MACHINE, PEERS, SOURCE

Select = Callable[[Result], bool]


@dataclass(frozen=True)
class Check:
    """One bound: `value` of a result must be at most (`most`) or at least that."""

    name: str
    bound: float
    most: bool
    value: Callable[[Result], float]
    applies: Select

    def met(self, result: Result) -> bool:
        """Whether this result keeps the bound."""
        value = self.value(result)
        return value <= self.bound if self.most else value >= self.bound


def median(values: Sequence[float]) -> float:
    return float(np.median(values))


def octomap_ratio(result: Result) -> float:
    """How many times longer OctoMap takes on the same scans."""
    return median(result.octomap_s) / median(result.ours_beside_s)


def thread_gain(result: Result) -> float:
    """What a second thread gains where both have a core: from CPU times, so that other work does not count.

    The serial part stays; the rest, as dear as it is with two threads, is halved, for chunks are small.
    """
    serial = sum(result.serial_s)
    return sum(result.one_thread_s) / (serial + (sum(result.two_threads_s) - serial) / 2)


def wall_gain(result: Result) -> float:
    """Wall time of one thread over that of two beside whatever else the machine does."""
    return sum(result.one_thread_wall_s) / sum(result.two_threads_wall_s)


def window_ratio(result: Result) -> float:
    return median(result.window_s) / median(result.edt_s)


def free_iou(result: Result) -> float:
    return result.score.free_iou if result.score else float("nan")


def occupied_iou(result: Result) -> float:
    return result.score.occ_iou if result.score else float("nan")


def bytes_per_m3(result: Result) -> float:
    return result.used_bytes / result.known_m3


def box_ratio(result: Result) -> float:
    """The largest box, ours over voxel by voxel."""
    return result.boxes_s[-1] / result.counted_boxes_s[-1]


def _at(*places: str) -> Select:
    return lambda result: result.place in places


def _of(sensor: str) -> Select:
    return lambda result: result.sensor == sensor


CHECKS = (
    Check("OctoMap's time over ours, mine", 28, False, octomap_ratio, _at("mine")),
    Check("OctoMap's time over ours, hall", 80, False, octomap_ratio, _at("hall")),
    Check("free IoU with brute force, OS0-64", 0.99, False, free_iou, _of("os0-64")),
    Check("free IoU with brute force, VLP-16", 0.98, False, free_iou, _of("vlp-16")),
    Check("occupied IoU with brute force", 0.995, False, occupied_iou, lambda _: True),
    Check("gain by a second thread (CPU), hall", 1.6, False, thread_gain, _at("hall")),
    Check("distance window over `edt`", 0.12, True, window_ratio, lambda _: True),
    Check("window's difference from `edt`, m", 1e-5, True, lambda r: r.window_difference_m, lambda _: True),
    Check("box of 1.4 x 1.4 x 1.0 m over voxel by voxel", 0.05, True, box_ratio, lambda _: True),
    Check("bytes per known m³", 300, True, bytes_per_m3, lambda _: True),
)


def tables(results: Sequence[Result]) -> str:
    """All tables as Markdown."""
    return "\n\n".join((_scans(results), _queries(results), _checks(results), _published()))


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _scans(results: Sequence[Result]) -> str:
    rows = [
        (
            result.place,
            result.sensor,
            f"{result.points:.0f}",
            f"{median(result.ours_s) * 1e3:.2f}",
            f"{median(result.octomap_s) * 1e3:.1f}",
            f"{octomap_ratio(result):.0f}",
            f"{free_iou(result):.4f}",
            f"{occupied_iou(result):.4f}",
            f"{thread_gain(result):.2f} ({wall_gain(result):.2f})",
            f"{bytes_per_m3(result):.0f}",
            f"{result.octomap_bytes / result.known_m3:.0f}",
        )
        for result in results
    ]
    header = ("place", "LiDAR", "returns", "ours, ms", "OctoMap, ms", "ratio", "free IoU", "occupied IoU")
    return _table((*header, "two threads, CPU (wall)", "B/m³", "OctoMap, B/m³"), rows)


def _queries(results: Sequence[Result]) -> str:
    sizes = [" x ".join(f"{side:g}" for side in size) + " m, ns" for size in BOXES_M]
    rows = []
    for result in results:
        pairs = zip(result.boxes_s, result.counted_boxes_s, strict=True)
        boxes = [f"{ours * 1e9:.0f} / {counted * 1e9:.0f}" for ours, counted in pairs]
        window = f"{median(result.window_s) * 1e3:.2f} / {median(result.edt_s) * 1e3:.1f}"
        rows.append((result.place, result.sensor, window, f"{window_ratio(result):.3f}", *boxes))
    return _table(("place", "LiDAR", "window ours / `edt`, ms", "ratio", *sizes), rows)


def _checks(results: Sequence[Result]) -> str:
    rows = []
    for check in CHECKS:
        held = [result for result in results if check.applies(result)]
        if held:
            bound = f"{'at most' if check.most else 'at least'} {check.bound:g}"
            values = ", ".join(f"{result.place} {result.sensor} {check.value(result):.4g}" for result in held)
            missed = [result for result in held if not check.met(result)]
            rows.append(
                (check.name, bound, values, "yes" if not missed else f"{len(missed)} of {len(held)} missed")
            )
    return _table(("bound", "", "measured", "kept"), rows)


def _published() -> str:
    rows = [
        (
            peer.program,
            f"{peer.mine_ms:g}",
            f"{peer.hall_ms:g}",
            f"{peer.mine_ratio:.2f}",
            f"{peer.hall_ratio:.2f}",
        )
        for peer in PEERS
    ]
    header = ("program", "mine, ms", "hall, ms", "ours / it, mine", "ours / it, hall")
    return f"{_table(header, rows)}\n\nSource: {SOURCE} ({MACHINE}), OS0-64, first visit."
