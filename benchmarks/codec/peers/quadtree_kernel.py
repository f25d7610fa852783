"""The prototype's quadtree over a range image: one kernel that encodes or decodes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.codec.peers.float_coder import (
    STATE_WORDS,
    Bytes,
    Floats,
    Words,
    code_bit,
    finish_encoding,
    start_decoding,
    start_encoding,
)

FAMILIES, CONTEXTS, MIXERS = 4, 6000, 13
FAR_M = 20.0
_UNARY_MAX = 101


@njit(cache=True, nogil=True)
def interpolate(a: float, b: float, c: float, d: float, down: float, right: float) -> float:
    """Between corners a b / c d: linear in 1/r on one surface, else along the smoother axis or nearest."""
    least, most = min(a, b, c, d), max(a, b, c, d)
    if most - least < 0.6 * least + 0.3:
        top, bottom = (1 - right) / a + right / b, (1 - right) / c + right / d
        return 1 / ((1 - down) * top + down * bottom)
    along, across = max(abs(a - b), abs(c - d)), max(abs(a - c), abs(b - d))
    if along < 0.25 * least + 0.3:
        if down < 0.5:
            return 1 / ((1 - right) / a + right / b)
        return 1 / ((1 - right) / c + right / d)
    if across < 0.25 * least + 0.3:
        if right < 0.5:
            return 1 / ((1 - down) / a + down / c)
        return 1 / ((1 - down) / b + down / d)
    nearest_top, nearest_bottom = (a, c) if right < 0.5 else (b, d)
    return nearest_top if down < 0.5 else nearest_bottom


@njit(cache=True, nogil=True)
def _spread(a: float, b: float, c: float, d: float) -> int:
    """Class 0 to 5 of the relative difference of four ranges."""
    least, most = min(a, b, c, d), max(a, b, c, d)
    share = (most - least) / (least + 0.5)
    if share < 0.05:
        return 0
    if share < 0.12:
        return 1
    if share < 0.25:
        return 2
    if share < 0.5:
        return 3
    return 4 if share < 1 else 5


@njit(cache=True, nogil=True)
def _code_integer(
    state: Words,
    stream: Bytes,
    decoding: bool,
    value: int,
    probabilities: Floats,
    counts: Floats,
    weights: Floats,
    mixer: int,
    first: int,
    second: int,
    third: int,
    limit: float,
    rate: float,
    contexts: Words,
) -> int:
    """A signed integer: zero flag, sign, unary size."""
    contexts[0], contexts[1] = first * 50, 1500 + second * 50
    contexts[2], contexts[3] = 3000 + third * 50, 4500 + mixer * 50
    model = (probabilities, counts, weights)
    if code_bit(state, stream, decoding, int(value == 0), *model, mixer, contexts, limit, rate):
        return 0
    contexts += 1
    sign = code_bit(state, stream, decoding, int(value < 0), *model, mixer + 1, contexts, limit, rate)
    contexts += 1
    size, wanted = 1, abs(value)
    while size < _UNARY_MAX:
        if not code_bit(
            state, stream, decoding, int(wanted > size), *model, mixer + 2, contexts, limit, rate
        ):
            break
        size += 1
        if size <= 24 or size % 8 == 0:
            contexts += 1
    return -size if sign else size


@njit(cache=True, nogil=True)
def run(
    ranges: Floats,
    weight: Floats,
    lattice: tuple[int, int],
    splits: NDArray[np.int64],
    step_m: float,
    tolerance_m: float,
    threshold: float,
    stream: Bytes,
    decoding: bool,
    probabilities: Floats,
    counts: Floats,
    weights: Floats,
    limit: float,
    rate: float,
) -> tuple[int, Floats]:
    """Length of the stream (0 when decoding) and the image (H, W) that the decoder sees.

    `ranges` (H, W) without holes and the `weight` (H, W) of each pixel's error only matter when encoding.
    A coarse lattice of samples first; then level by level (`splits` (L, 2)) a block is split where pixels of
    more than `threshold` weight would be off by more than `tolerance_m`.
    """
    state = np.zeros(STATE_WORDS, dtype=np.int64)
    if decoding:
        start_decoding(state, stream)
    else:
        start_encoding(state)
    height, width = ranges.shape
    samples = np.zeros((height + 1, width))
    known = np.zeros((height + 1, width), dtype=np.uint8)
    image = np.zeros((height, width))
    contexts = np.zeros(FAMILIES, dtype=np.int64)
    tall, wide = lattice
    for v in range(0, height + 1, tall):
        for u in range(0, width, wide):
            left = samples[v, u - wide] if u > 0 else (samples[v - tall, u] if v > 0 else 4.0)
            top = samples[v - tall, u] if v > 0 else left
            corner = samples[v - tall, u - wide] if u > 0 and v > 0 else top
            guess = min(max(left + top - corner, min(left, top)), max(left, top))
            expected, residual = int(np.round(guess / step_m)), 0
            if not decoding:
                residual = int(np.round(ranges[min(v, height - 1), u] / step_m)) - expected
            residual = _code_integer(
                state,
                stream,
                decoding,
                residual,
                probabilities,
                counts,
                weights,
                0,
                _spread(left, top, corner, guess),
                6 + min(9, expected // 5),
                min(9, v // tall),
                limit,
                rate,
                contexts,
            )
            samples[v, u] = min(max((expected + residual) * step_m, 0.5 * step_m), FAR_M)
            known[v, u] = 1
    blocks_v, blocks_u = height // tall, width // wide
    active = np.ones((blocks_v, blocks_u), dtype=np.uint8)
    for level in range(len(splits) + 1):
        last = level == len(splits)
        parts_v = 1 if last else splits[level, 0]
        parts_u = 1 if last else splits[level, 1]
        small_v, small_u = tall // parts_v, wide // parts_u
        finer = np.zeros((blocks_v * parts_v, blocks_u * parts_u), dtype=np.uint8)
        flags = np.zeros((blocks_v, blocks_u), dtype=np.uint8)
        for bv in range(blocks_v):
            for bu in range(blocks_u):
                if not active[bv, bu]:
                    continue
                v, u = bv * tall, bu * wide
                v2, u2 = v + tall, (u + wide) % width
                a, b, c, d = samples[v, u], samples[v, u2], samples[v2, u], samples[v2, u2]
                missed = 0.0
                for y in range(v, min(v2, height)):
                    for x in range(u, u + wide):
                        value = interpolate(a, b, c, d, (y - v) / tall, (x - u) / wide)
                        if known[y, x]:
                            value = samples[y, x]
                        image[y, x] = value
                        if not decoding and abs(value - ranges[y, x]) > tolerance_m:
                            missed += weight[y, x]
                if last:
                    continue
                spread = _spread(a, b, c, d)
                beside = (flags[bv, bu - 1] if bu > 0 else 0) * 3 + (flags[bv - 1, bu] if bv > 0 else 0)
                contexts[0] = (level * 6 + spread) * 9 + beside
                contexts[1] = 1500 + (level * 16 + min(15, int(min(a, d)))) * 6 + spread
                contexts[2] = 3000 + level * 64 + bv
                contexts[3] = 4500 + level
                split = code_bit(
                    state,
                    stream,
                    decoding,
                    int(missed > threshold),
                    probabilities,
                    counts,
                    weights,
                    4 + level,
                    contexts,
                    limit,
                    rate,
                )
                flags[bv, bu] = 1 + split
                if not split:
                    continue
                finer[bv * parts_v : (bv + 1) * parts_v, bu * parts_u : (bu + 1) * parts_u] = 1
                for i in range(parts_v + 1):
                    for j in range(parts_u + 1):
                        y, x = v + i * small_v, (u + j * small_u) % width
                        if known[y, x]:
                            continue
                        guess = interpolate(a, b, c, d, i / parts_v, j / parts_u)
                        expected, residual = int(np.round(guess / step_m)), 0
                        if not decoding:
                            residual = int(np.round(ranges[min(y, height - 1), x] / step_m)) - expected
                        first = level * 6 + spread
                        residual = _code_integer(
                            state,
                            stream,
                            decoding,
                            residual,
                            probabilities,
                            counts,
                            weights,
                            10,
                            6 + first if first < 23 else 29,
                            min(29, 10 + level * 4 + min(3, spread)),
                            min(29, y * 29 // height),
                            limit,
                            rate,
                            contexts,
                        )
                        samples[y, x] = min(max((expected + residual) * step_m, 0.5 * step_m), FAR_M)
                        known[y, x] = 1
        active = finer
        tall, wide = small_v, small_u
        blocks_v, blocks_u = blocks_v * parts_v, blocks_u * parts_u
    length = 0 if decoding else finish_encoding(state, stream)
    return length, image
