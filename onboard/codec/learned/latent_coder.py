"""Latents as bytes: quantised in fixed steps and range coded with one shipped table per latent.

Everything that steers decoding is an integer; floats only turn latents into symbols and back.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.range_bytes import (
    PROBABILITY_BITS,
    code_split,
    failed,
    finish,
    finished_cleanly,
    reader_state,
    writer_state,
)
from onboard.core.errors import CodecError, InputError

Symbols = NDArray[np.int32]
Floats = NDArray[np.float32]
_MAX_BYTES = 4096


class LatentCode(NamedTuple):
    """Quantiser and tables of N latents.

    Symbol s of latent n stands for `offsets[n] + (lowest[n] + s) * steps[n]`. Its probability is
    cumulative[first[n] + s + 1] - cumulative[first[n] + s], in units of the latent's last entry; no symbol
    has 0.
    """

    offsets: Floats
    steps: Floats
    lowest: Symbols
    first: Symbols
    cumulative: NDArray[np.int64]


class _ByteCoder(NamedTuple):
    state: NDArray[np.int64]
    buffer: NDArray[np.uint8]


def quantise(latents: Floats, code: LatentCode) -> Symbols:
    """(N,) symbols of (N,) latents; those beyond a table's ends become its ends."""
    steps = np.rint((latents.astype(np.float64) - code.offsets) / code.steps) - code.lowest
    return np.asarray(np.clip(steps, 0, _counts(code) - 1)).astype(np.int32)


def dequantise(symbols: Symbols, code: LatentCode) -> Floats:
    """(N,) latents that the symbols stand for."""
    return np.asarray(code.offsets + (symbols + code.lowest) * code.steps, dtype=np.float32)


def encode_symbols(symbols: Symbols, code: LatentCode) -> bytes:
    """Bytes of (N,) symbols."""
    coder = _ByteCoder(writer_state(), np.zeros(_MAX_BYTES, dtype=np.uint8))
    _code_all(coder.state, coder.buffer, code.first, code.cumulative, symbols.copy())
    if failed(coder):
        raise InputError(f"{len(symbols)} latents do not fit into {_MAX_BYTES} bytes")
    return finish(coder)


def decode_symbols(data: bytes, code: LatentCode) -> Symbols:
    """(N,) symbols from all of `data`. Raises CodecError where it is too short or too long."""
    coder = _ByteCoder(reader_state(data), np.frombuffer(data, dtype=np.uint8).copy())
    symbols = np.zeros(len(code.offsets), dtype=np.int32)
    _code_all(coder.state, coder.buffer, code.first, code.cumulative, symbols)
    if not finished_cleanly(coder):
        raise CodecError(f"latents do not end where their {len(data)} bytes do")
    return symbols


@njit(cache=True, nogil=True)
def _code_all(
    state: NDArray[np.int64],
    buffer: NDArray[np.uint8],
    first: Symbols,
    cumulative: NDArray[np.int64],
    symbols: Symbols,
) -> None:
    """Write the symbols, or read them into `symbols`: each by halving its table until one is left."""
    for n in range(len(symbols)):
        low = np.int64(first[n])
        high = np.int64(first[n + 1]) - 1
        symbol = low + symbols[n]
        while high - low > 1:
            middle = (low + high) // 2
            whole = cumulative[high] - cumulative[low]
            share = ((cumulative[middle] - cumulative[low]) << PROBABILITY_BITS) // whole
            share = min(max(share, 1), (1 << PROBABILITY_BITS) - 1)
            if code_split(state, buffer, share, 1 if symbol >= middle else 0):
                low = middle
            else:
                high = middle
        symbols[n] = low - first[n]


def _counts(code: LatentCode) -> Symbols:
    """(N,) numbers of symbols."""
    return np.asarray(np.diff(code.first) - 1, dtype=np.int32)


def save_latent_code(path: Path, code: LatentCode) -> None:
    """Write tables as npz, 4 bytes an entry."""
    np.savez_compressed(path, **code._replace(cumulative=code.cumulative.astype(np.uint32))._asdict())


def load_latent_code(path: Path) -> LatentCode:
    """What `save_latent_code` wrote. Raises InputError for a missing or unsound file."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in LatentCode._fields}
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a file of latent tables ({error}); export the model again") from error
    code = LatentCode(**arrays)._replace(cumulative=arrays["cumulative"].astype(np.int64))
    if not _is_sound(code):
        raise InputError(f"{path}: latent tables do not fit together; export the model again")
    return code


def _is_sound(code: LatentCode) -> bool:
    """Whether every table rises strictly, so that no symbol is impossible and no index leaves it."""
    count = len(code.offsets)
    if not (len(code.steps) == len(code.lowest) == count and len(code.first) == count + 1 and count):
        return False
    if code.first[0] != 0 or code.first[-1] != len(code.cumulative) or (np.diff(code.first) < 2).any():
        return False
    rises = np.diff(code.cumulative) > 0
    rises[code.first[1:-1] - 1] = True
    return bool(rises.all() and (code.steps > 0).all())
