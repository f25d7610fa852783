"""CPU times, fidelity and memory on the scans of one place and LiDAR."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from benchmarks.mapping import peers
from benchmarks.mapping.reference import DenseMap
from benchmarks.mapping.scenes import Posed
from onboard.mapping.compare import MapScore, compare_cells
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.mapping.window import DistanceWindow
from onboard.mapping.workers import Workers

VOXEL_M, MAX_RANGE_M, MIN_RANGE_M = 0.2, 20.0, 0.5
WINDOW_VOXELS = (104, 104, 40)
"""20.8 x 20.8 x 8 m."""
BAND_M = 2.0
BOXES_M = ((0.6, 0.6, 0.3), (1.0, 1.0, 0.6), (1.4, 1.4, 1.0))
_QUERIES = 10_000
_REPETITIONS = 9
_WARM_UP = 3
_BOUND_M = np.full(3, 1e4)


@dataclass
class Result:
    """Seconds are CPU seconds of this process; one entry per scan or repetition."""

    place: str
    sensor: str
    points: float
    """Mean number of returns in a scan."""
    ours_s: list[float] = field(default_factory=list)
    octomap_s: list[float] = field(default_factory=list)
    ours_beside_s: list[float] = field(default_factory=list)
    """Ours on the scans that OctoMap got."""
    one_thread_s: list[float] = field(default_factory=list)
    two_threads_s: list[float] = field(default_factory=list)
    """CPU of both together."""
    serial_s: list[float] = field(default_factory=list)
    """What only one thread does."""
    one_thread_wall_s: list[float] = field(default_factory=list)
    two_threads_wall_s: list[float] = field(default_factory=list)
    score: MapScore | None = None
    known_m3: float = 0.0
    used_bytes: int = 0
    octomap_bytes: int = 0
    window_s: list[float] = field(default_factory=list)
    edt_s: list[float] = field(default_factory=list)
    window_difference_m: float = 0.0
    boxes_s: list[float] = field(default_factory=list)
    """Per box, in the order of BOXES_M; as below."""
    counted_boxes_s: list[float] = field(default_factory=list)


def measure(place: str, sensor: str, scans: Sequence[Posed], peer_every: int) -> Result:
    """Everything on the scans of one place. Raises InputError for a missing peer, AssertionError if an answer
    differs from the peer's."""
    result = Result(place, sensor, float(np.mean([len(scan.points) for scan in scans])))
    voxel_map = _integrate(scans, peer_every, result)
    _measure_threads(scans, result)
    _score(scans, voxel_map, result)
    _measure_window(scans, voxel_map, result)
    _measure_boxes(voxel_map, result)
    return result


def new_map(threads: int = 1) -> VoxelMap:
    """A map with the benchmark's voxels and range."""
    return VoxelMap(VOXEL_M, MAX_RANGE_M, threads)


def _integrate(scans: Sequence[Posed], peer_every: int, result: Result) -> VoxelMap:
    """First visit of all scans, ours and OctoMap's in turn."""
    for scan in scans[:_WARM_UP]:
        new_map().integrate(scan.points, scan.pose)
    voxel_map, octomap = new_map(), peers.Octomap(VOXEL_M, MAX_RANGE_M, MIN_RANGE_M)
    for number, scan in enumerate(scans):
        taken = _cpu(partial(_add, voxel_map, scan))
        result.ours_s.append(taken)
        if number % peer_every == 0:
            result.ours_beside_s.append(taken)
            result.octomap_s.append(octomap.insert(scan))
    result.known_m3 = voxel_map.known_count(-_BOUND_M, _BOUND_M) * VOXEL_M**3
    result.used_bytes, result.octomap_bytes = voxel_map.store.used_bytes(), octomap.bytes()
    return voxel_map


def _add(voxel_map: VoxelMap, scan: Posed) -> None:
    voxel_map.integrate(scan.points, scan.pose, min_range_m=MIN_RANGE_M)


class _Clocked(Workers):
    """Adds up the CPU time of the parts that threads share."""

    def __init__(self, threads: int) -> None:
        super().__init__(threads)
        self.shared_s = 0.0

    def share(self, count: int, kernel: Callable[[int, int], None]) -> None:
        started = time.process_time()
        super().share(count, kernel)
        self.shared_s += time.process_time() - started


def _measure_threads(scans: Sequence[Posed], result: Result) -> None:
    """One and two threads in turn, on maps that know the place already: the least of a few."""
    single, double = new_map(1), new_map(2)
    clocked = single.workers = _Clocked(1)
    for scan in scans[:: max(1, len(scans) // 10)]:
        rows = []
        for _ in range(_REPETITIONS):
            clocked.shared_s = 0.0
            one = _clocks(partial(_add, single, scan))
            rows.append((*one, one[0] - clocked.shared_s, *_clocks(partial(_add, double, scan))))
        cpu, wall, serial, cpu_two, wall_two = np.min(rows, axis=0).tolist()
        result.one_thread_s.append(cpu)
        result.serial_s.append(serial)
        result.two_threads_s.append(cpu_two)
        result.one_thread_wall_s.append(wall)
        result.two_threads_wall_s.append(wall_two)


def _score(scans: Sequence[Posed], voxel_map: VoxelMap, result: Result) -> None:
    reference = DenseMap(scans, VOXEL_M, MAX_RANGE_M, MIN_RANGE_M)
    ours = voxel_map.occupied_indices(), voxel_map.free_indices()
    result.score = compare_cells(reference.occupied(), reference.free(), *ours)


def _measure_window(scans: Sequence[Posed], voxel_map: VoxelMap, result: Result) -> None:
    """Our window, its extraction included, beside `edt` on the extracted one."""
    for scan in scans[:: max(1, len(scans) // _REPETITIONS)]:
        centre = np.floor(scan.pose[:3, 3] / VOXEL_M).astype(np.int64)
        lower = centre - np.array(WINDOW_VOXELS) // 2
        ours = partial(DistanceWindow, voxel_map, lower, WINDOW_VOXELS, BAND_M)
        window = ours()
        result.window_s.append(_cpu(ours))
        exact = peers.exact_distances(window.status, VOXEL_M)
        result.edt_s.append(_cpu(partial(peers.exact_distances, window.status, VOXEL_M)))
        difference = float(np.abs(window.distances_m - np.minimum(exact, BAND_M)).max())
        result.window_difference_m = max(result.window_difference_m, difference)


def _measure_boxes(voxel_map: VoxelMap, result: Result) -> None:
    """Boxes around random places in free space."""
    rng = np.random.default_rng(1)
    free = voxel_map.free_indices()
    centres = (free[rng.integers(len(free), size=_QUERIES)] + rng.random((_QUERIES, 3))) * VOXEL_M
    counts = np.empty((_QUERIES, 3), np.int64)
    tables = voxel_map.planning_tables()
    for size in BOXES_M:
        half = np.array(size) / 2
        ours, counted = [], []
        for _ in range(_REPETITIONS):
            ours.append(_cpu(partial(voxel_map.box_status, centres, half)))
            counting = partial(peers.count_boxes, tables, centres, half, 1 / VOXEL_M, counts)
            counted.append(_cpu(counting))
        worst = np.where(counts[:, OCCUPIED] > 0, OCCUPIED, np.where(counts[:, UNKNOWN] > 0, UNKNOWN, FREE))
        if not np.array_equal(worst, voxel_map.box_status(centres, half)):
            raise AssertionError(f"box queries of {size} m differ from counting voxel by voxel")
        result.boxes_s.append(min(ours[1:]) / _QUERIES)
        result.counted_boxes_s.append(min(counted[1:]) / _QUERIES)


def _cpu(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def _clocks(work: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall seconds."""
    started_cpu, started = time.process_time(), time.perf_counter()
    work()
    return time.process_time() - started_cpu, time.perf_counter() - started
