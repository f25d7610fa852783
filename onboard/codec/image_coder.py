"""Range-image coder: predict every pixel from coded neighbours, code the difference with adaptive contexts.

Symbols (H, W) int32: 0 = unknown, 1..far-1 = range in steps, far = no return within the image. Prediction is
in 1/16 steps: five predictors are averaged with weights from their errors at the neighbours (the idea of JPEG
XL's weighted predictor, ISO/IEC 18181-1), so that walls, floors and edges each get what suits them. What the
prediction has beyond whole steps tells which way the residual leans. Integers only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.range_coder import (
    Coder,
    code_bit,
    fail,
    failed,
    finish,
    finished_cleanly,
    new_reader,
    new_writer,
)
from onboard.core.errors import InputError, WireError

Symbols = NDArray[np.int32]

_FINE_BITS = 4
_FINE = 1 << _FINE_BITS
_PREDICTORS = 5
_RECIPROCAL = 1 << 40
_WEIGHT_SCALE = 1 << 32
_ERROR_FLOOR = 80

_LEVELS, _LEANS, _SPREADS, _SIGNS = 12, 5, 3, 9
_UNARY = 12
_ESCAPE_BITS = 16
_RANGE, _FAR, _UNKNOWN = 0, 1, 2

# Slots of the models, one block after the other.
_KIND = 0
_ZERO = _KIND + 2 * 27
_SIGN = _ZERO + _LEVELS * _LEANS * _SPREADS
_SIZE = _SIGN + _LEVELS * _LEANS * _SIGNS
_ESCAPE = _SIZE + _LEVELS * _SPREADS * _UNARY
_MODELS = _ESCAPE + 2 * _ESCAPE_BITS


# No divisor below can be zero, so kernels need not test for it: a fifth of their time.
_kernel = njit(cache=True, nogil=True, error_model="numpy")
_inlined = njit(cache=True, nogil=True, error_model="numpy", inline="always")


class _Image(NamedTuple):
    """Symbols, and of this row and the one above (index row & 1) what prediction needs, in 1/16 steps.

    Columns are shifted by two there, so that borders need no tests.
    """

    symbols: Symbols
    far: int
    values: NDArray[np.int64]
    residuals: NDArray[np.int64]
    misses: NDArray[np.int64]
    guesses: NDArray[np.int64]


def write_image(symbols: Symbols, far: int, max_bytes: int) -> bytes:
    """Code symbols (H, W). Raises InputError if they do not fit `max_bytes`."""
    coder = new_writer(max_bytes, _MODELS)
    _code_image(coder, _new_image(symbols.copy(), far))
    data = finish(coder)
    if failed(coder):
        raise InputError(f"the range image does not fit {max_bytes} bytes: use a coarser range step")
    return data


def read_image(data: bytes, shape: tuple[int, int], far: int) -> Symbols:
    """Inverse of `write_image`: symbols (H, W). Raises WireError for bytes that no encoder wrote."""
    coder = new_reader(data, _MODELS)
    symbols = np.zeros(shape, dtype=np.int32)
    _code_image(coder, _new_image(symbols, far))
    if failed(coder) or not finished_cleanly(coder):
        raise WireError("keyframe: the range image does not decode")
    return symbols


def _new_image(symbols: Symbols, far: int) -> _Image:
    """Before the first pixel everything looks a fifth of the full range away."""
    shape = (2, symbols.shape[1] + 3)
    return _Image(
        symbols,
        far,
        np.full(shape, (far << _FINE_BITS) // 5, dtype=np.int64),
        np.zeros(shape, dtype=np.int64),
        np.zeros((*shape, _PREDICTORS), dtype=np.int64),
        np.zeros(_PREDICTORS, dtype=np.int64),
    )


@_kernel
def _code_image(coder: Coder, image: _Image) -> None:
    """Write `image.symbols`, or fill them in when the coder reads."""
    symbols, far = image.symbols, image.far
    for row in range(symbols.shape[0]):
        _extend_borders(image, row)
        for column in range(symbols.shape[1]):
            prediction = _predict(image, row, column)
            kind = _code_kind(coder, image, row, column)
            if kind == _RANGE:
                symbol = _code_range(coder, image, row, column, prediction)
                if symbol < 1 or symbol >= far:
                    fail(coder)
                    return
                symbols[row, column] = symbol
            else:
                symbols[row, column] = far if kind == _FAR else 0
            _remember(image, row, column, prediction)


@_kernel
def _extend_borders(image: _Image, row: int) -> None:
    """Left of a row lies the first pixel of the row above, right of that row its last pixel again."""
    here, above = row & 1, (row & 1) ^ 1
    last = image.values.shape[1] - 1
    if row > 0:
        for plane in (image.values, image.residuals):
            plane[here, 0] = plane[here, 1] = plane[above, 2]
            plane[above, last] = plane[above, last - 1]
        image.misses[here, 0] = image.misses[above, 2]
        image.misses[here, 1] = image.misses[above, 2]
        image.misses[above, last] = image.misses[above, last - 1]


@_kernel
def _predict(image: _Image, row: int, column: int) -> int:
    """Weighted mean of the guesses in 1/16 steps; a guess counts by its misses at five neighbours."""
    here, above, at = row & 1, (row & 1) ^ 1, column + 2
    top = image.far << _FINE_BITS
    west, north = image.values[here, at - 1], image.values[above, at]
    north_west, north_east = image.values[above, at - 1], image.values[above, at + 1]
    if row == 0:
        north = north_west = north_east = west
    image.guesses[0] = west
    image.guesses[1] = north
    image.guesses[2] = _plane(west, north, north_west, top)
    image.guesses[3] = _plane(west, north_east, north, top)
    image.guesses[4] = _plane(west, west, image.values[here, at - 2], top)
    total, weighted = np.int64(0), np.int64(0)
    for k in range(_PREDICTORS):
        miss = 2 * image.misses[here, at - 1, k] + image.misses[here, at - 2, k] + _ERROR_FLOOR
        miss += (
            2 * image.misses[above, at, k] + image.misses[above, at - 1, k] + image.misses[above, at + 1, k]
        )
        weight = 1 + _WEIGHT_SCALE // (miss * miss)
        total += weight
        weighted += weight * image.guesses[k]
    return int((weighted + (total >> 1)) // total)


@_inlined
def _plane(a: int, b: int, opposite: int, top: int) -> int:
    """Continue the plane through three neighbours: on a plane 1/r is linear over a small patch."""
    inverse = _RECIPROCAL // a + _RECIPROCAL // b - _RECIPROCAL // opposite
    return min(_RECIPROCAL // inverse, top) if inverse > 0 else top


@_kernel
def _remember(image: _Image, row: int, column: int, prediction: int) -> None:
    """Keep what the next pixels need; an unknown pixel counts as predicted."""
    here, at = row & 1, column + 2
    symbol = image.symbols[row, column]
    value = np.int64(symbol) << _FINE_BITS if symbol else max(prediction, _FINE)
    image.values[here, at] = value
    image.residuals[here, at] = value - prediction if 0 < symbol < image.far else 0
    for k in range(_PREDICTORS):
        miss = abs(value - image.guesses[k])
        image.misses[here, at, k] = miss if symbol else image.misses[here, at - 1, k]


@_inlined
def _kind_of(symbol: int, far: int) -> int:
    if symbol == 0:
        return _UNKNOWN
    return _FAR if symbol == far else _RANGE


@_kernel
def _code_kind(coder: Coder, image: _Image, row: int, column: int) -> int:
    """Range, no return or unknown; the context is what W, N and NE are."""
    symbols, far = image.symbols, image.far
    west = _kind_of(symbols[row, column - 1], far) if column > 0 else _RANGE
    north = _kind_of(symbols[row - 1, column], far) if row > 0 else west
    inside = row > 0 and column + 1 < symbols.shape[1]
    north_east = _kind_of(symbols[row - 1, column + 1], far) if inside else north
    slot = _KIND + 2 * (west * 9 + north * 3 + north_east)
    kind = _kind_of(symbols[row, column], far)
    if code_bit(coder, slot, 1 if kind != _RANGE else 0) == 0:
        return _RANGE
    unknown = code_bit(coder, slot + 1, 1 if kind == _UNKNOWN else 0)
    return _UNKNOWN if unknown else _FAR


@_kernel
def _code_range(coder: Coder, image: _Image, row: int, column: int, prediction: int) -> int:
    """A range symbol as difference to the prediction, mirrored so that it leans upwards."""
    here, above, at = row & 1, (row & 1) ^ 1, column + 2
    residual_west, residual_north = image.residuals[here, at - 1], image.residuals[above, at]
    energy = 3 * abs(residual_west) + 3 * abs(residual_north) + abs(image.residuals[here, at - 2])
    energy += 2 * abs(image.residuals[above, at + 1]) + 2 * abs(image.residuals[above, at - 1])
    level = _level(energy)
    gap = abs(image.values[here, at - 1] - image.values[above, at])
    spread = 0 if gap < 12 else 1 if gap < 48 else 2

    centre = min(max((prediction + (_FINE >> 1)) >> _FINE_BITS, 1), image.far - 1)
    lean = min(max(prediction - (centre << _FINE_BITS), -_FINE >> 1), _FINE >> 1)
    mirror = -1 if lean < 0 else 1
    place = level * _LEANS + (abs(lean) >> 1)

    difference = (np.int64(image.symbols[row, column]) - centre) * mirror
    if code_bit(coder, _ZERO + place * _SPREADS + spread, 1 if difference != 0 else 0) == 0:
        return int(centre)
    signs = _trend(residual_west, mirror) * 3 + _trend(residual_north, mirror)
    negative = code_bit(coder, _SIGN + place * _SIGNS + signs, 1 if difference < 0 else 0)
    size = _code_size(coder, _SIZE + (level * _SPREADS + spread) * _UNARY, abs(difference), image.far)
    return int(centre + mirror * (-size if negative else size))


@_inlined
def _level(energy: int) -> int:
    """Logarithm of `energy` in levels of a factor 1.5."""
    level, threshold = 0, 24
    while level < _LEVELS - 1 and energy >= threshold:
        level += 1
        threshold += threshold >> 1
    return level


@_inlined
def _trend(residual: int, mirror: int) -> int:
    """0 = small, 1 = as the mirror, 2 = against it."""
    if abs(residual) < _FINE >> 1:
        return 0
    return 1 if (residual < 0) == (mirror < 0) else 2


@_kernel
def _code_size(coder: Coder, slot: int, size: int, limit: int) -> int:
    """A number >= 1: unary with a model per step, then Exp-Golomb; what is read stays below 4 `limit`."""
    for value in range(1, _UNARY + 1):
        if code_bit(coder, slot + value - 1, 1 if size > value else 0) == 0:
            return value
    rest = size - _UNARY
    width = 0
    while 1 << (width + 1) <= limit and code_bit(coder, _ESCAPE + width, 1 if rest >> (width + 1) else 0):
        width += 1
    number = 1
    for place in range(width - 1, -1, -1):
        number = 2 * number + code_bit(coder, _ESCAPE + _ESCAPE_BITS + place, (rest >> place) & 1)
    return _UNARY + number
