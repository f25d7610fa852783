"""Times and fidelity of gains on one scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gain.best_first import BestFirst
from benchmarks.gain.exact import distinct_volumes
from benchmarks.gain.original import MarchingGain, TsdfLayer
from benchmarks.gain.scenes import Scanned
from onboard.planning.gain import GainModel
from onboard.planning.gain_path import PathGain
from onboard.planning.gain_window import GainWindow
from onboard.planning.ray_template import Fan

Floats = NDArray[np.float64]

RANGE_M, VOXEL_M = 20.0, 0.2
VIEW_RAD = float(np.deg2rad(47.5))
"""19 bands of 5 deg with their middles from -45 to 45 deg, and 72 columns."""
DENSE_RAD = float(np.deg2rad(0.8))
"""Rays of the exact volume: 0.28 m apart at 20 m."""
RATE_PER_M = 0.4
PATHS, PATH_VIEWS = 10, 6
SEARCHED, SPEED_M_S, START_UP_S = 150, 1.0, 3.0


@dataclass(frozen=True)
class Result:
    """Milliseconds of CPU time per vertex, correlations with exact volumes, and what else is measured.

    corr_*: Pearson, with the distinct volume that the same rays (same) or dense ones (dense) meet. union,
    sum: our gain of a path, and the sum of the gains of its views, over the distinct volume (means).
    """

    place: str
    sensor: str
    blocks: int
    original_ms: float
    original_steps: float
    ours_ms: float
    window_ms: float
    corr_same: float
    corr_dense: float
    corr_original: float
    union: float
    sum: float
    paths_ms: float
    search_ms: float
    search_evaluated: int
    exhaustive_ms: float

    @property
    def ratio(self) -> float:
        return self.ours_ms / self.original_ms


def model(rate_per_m: float, close_gaps: bool) -> GainModel:
    """Our gain with 72 x 19 rays."""
    step = float(np.deg2rad(5.0))
    return GainModel(-VIEW_RAD, VIEW_RAD, RANGE_M, VOXEL_M, rate_per_m, step, close_gaps)


def measure(scene: Scanned, rounds: int) -> Result:
    """Times in interleaved rounds (medians), our table of blocks built anew in each."""
    product, count = model(RATE_PER_M, True), len(scene.vertices)
    layer, original = TsdfLayer(scene.voxel_map), MarchingGain(product.fan.directions, RANGE_M, VOXEL_M)
    jobs: dict[str, Callable[[], Any]] = {
        "original": lambda: original.evaluate(layer, scene.vertices),
        "ours": lambda: _anew(product).evaluate(scene.voxel_map, scene.vertices),
        "window": lambda: _anew(product).evaluate(scene.voxel_map, scene.vertices[:1]),
        "one": lambda: product.evaluate(scene.voxel_map, scene.vertices[:1]),
    } | _further_jobs(scene, product)
    times, answers = timed(jobs, rounds)
    counts, steps = answers["original"]
    return Result(
        scene.name,
        scene.sensor.name,
        scene.voxel_map.store.count,
        times["original"] / count,
        steps / count,
        times["ours"] / count,
        times["window"] - times["one"],
        *_fidelity(scene, counts),
        times["paths"],
        times["search"],
        answers["search"].evaluated,
        times["exhaustive"],
    )


def timed(jobs: dict[str, Callable[[], Any]], rounds: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Median CPU milliseconds and last answer of each job; the jobs take turns, after one round for free."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    answers = {name: job() for name, job in jobs.items()}
    for _ in range(rounds):
        for name, job in jobs.items():
            start = time.process_time()
            answers[name] = job()
            times[name].append((time.process_time() - start) * 1e3)
    return {name: float(np.median(values)) for name, values in times.items()}, answers


def _further_jobs(scene: Scanned, product: GainModel) -> dict[str, Callable[[], Any]]:
    union, search, paths = PathGain(product), BestFirst(product), _paths(scene.vertices)
    views = scene.vertices[:SEARCHED]
    factors = 1 / (np.linalg.norm(views - views[0], axis=1) / SPEED_M_S + START_UP_S)
    return {
        "paths": lambda: union.evaluate(scene.voxel_map, paths),
        "search": lambda: search.search(scene.voxel_map, views, factors),
        "exhaustive": lambda: int(np.argmax(product.evaluate(scene.voxel_map, views) * factors)),
    }


def _anew(product: GainModel) -> GainModel:
    product.window = GainWindow(product.reach_blocks, close_gaps=True)
    return product


def _paths(vertices: Floats) -> list[Floats]:
    """Paths of six views, each about 2 m from the last and not near an earlier one."""
    rng, paths = np.random.default_rng(0), []
    for _ in range(PATHS):
        path = vertices[rng.integers(len(vertices))][None]
        while len(path) < PATH_VIEWS:
            distances = np.linalg.norm(vertices[:, None] - path[None], axis=2)
            off = np.abs(distances[:, -1] - 2.0) + 1e3 * (distances.min(axis=1) < 1.5)
            path = np.concatenate([path, vertices[np.argmin(off)][None]])
        paths.append(path)
    return paths


def _fidelity(scene: Scanned, counts: Floats) -> tuple[float, float, float, float, float]:
    """`corr_same`, `corr_dense`, `corr_original`, `union` and `sum`, all without attenuation."""
    plain, rays = model(0.0, False), Fan.between(-VIEW_RAD, VIEW_RAD, DENSE_RAD).directions
    views, paths = list(scene.vertices), _paths(scene.vertices)
    gains, hits = plain.evaluate_with_ray_count(scene.voxel_map, scene.vertices)
    same = distinct_volumes(scene.voxel_map, views, plain.fan.directions, RANGE_M)
    exact = distinct_volumes(scene.voxel_map, views, rays, RANGE_M)
    pairs = (hits, same), (gains, exact), (counts, exact)
    first, second, third = (float(np.corrcoef(*pair)[0, 1]) for pair in pairs)
    together = distinct_volumes(scene.voxel_map, paths, rays, RANGE_M)
    union = PathGain(plain).evaluate(scene.voxel_map, paths)
    total = np.array([plain.evaluate(scene.voxel_map, path).sum() for path in paths])
    return first, second, third, float(np.mean(union / together)), float(np.mean(total / together))
