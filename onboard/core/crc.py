"""CRC32C (Castagnoli), the checksum of keyframes, of every frame on the air and of stored maps.

A table kernel here rather than one more package: numba is a dependency anyway, the polynomial is fixed for
ever, and a frame of a few kilobytes takes microseconds.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_POLYNOMIAL_REFLECTED = 0x82F63B78


def _make_table() -> NDArray[np.uint32]:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_POLYNOMIAL_REFLECTED), table >> 1)
    return table.astype(np.uint32)


_TABLE = _make_table()


@njit(cache=True, nogil=True)
def _crc_kernel(data: NDArray[np.uint8], table: NDArray[np.uint32]) -> np.uint32:
    crc = np.uint32(0xFFFFFFFF)
    for byte in data:
        crc = np.uint32(table[(crc ^ byte) & np.uint32(0xFF)] ^ (crc >> np.uint32(8)))
    return np.uint32(crc ^ np.uint32(0xFFFFFFFF))


def crc32c(data: bytes) -> int:
    """CRC32C of `data` (RFC 3720, appendix B.4)."""
    return int(_crc_kernel(np.frombuffer(data, dtype=np.uint8), _TABLE))
