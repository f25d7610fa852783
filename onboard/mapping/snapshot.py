"""A voxel map in one file: written whole or not at all, refused when damaged.

Layout, little-endian: header (`_HEADER`), zlib-compressed arrays (`_layout`), CRC32C of all before it.
"""

from __future__ import annotations

import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.core.crc import crc32c
from onboard.core.errors import InputError
from onboard.mapping.blocks import BLOCK_EDGE, BLOCK_VOXELS
from onboard.mapping.details import KINDS
from onboard.mapping.store import BlockStore
from onboard.mapping.voxel_map import VoxelMap

FORMAT_VERSION = 1
_MAGIC = b"MARSUMAP"
_HEADER = struct.Struct("<8sHHddqII")
"""Magic, format version, threads, voxel edge and range in metres, map version, blocks, rows of details."""
_CRC = struct.Struct("<I")
_MAX_BLOCKS = 1 << 24


class _Header(NamedTuple):
    magic: bytes
    format_version: int
    threads: int
    voxel_m: float
    max_range_m: float
    version: int
    blocks: int
    details: int


def save(voxel_map: VoxelMap, path: Path) -> None:
    """Replace the file at `path` by this map; a kill at any moment leaves the old file or the new one.

    Raises InputError where it cannot be written.
    """
    scratch = path.with_name(f".{path.name}.tmp")
    try:
        with scratch.open("wb") as file:
            file.write(to_bytes(voxel_map))
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
        _sync_directory(path.parent)
    except OSError as error:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot write the map: {error.strerror}") from error


def _sync_directory(directory: Path) -> None:
    """The renaming itself must reach the disk too."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def load(path: Path) -> VoxelMap:
    """The map in a file. Raises InputError, naming the file, if it is missing, damaged or of another kind."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read the map: {error.strerror}") from error
    try:
        return from_bytes(data)
    except InputError as error:
        raise InputError(f"{path}: {error}; remove the file to start with an empty map") from error


def to_bytes(voxel_map: VoxelMap) -> bytes:
    """The map with everything that later scans and queries depend on."""
    store = voxel_map.store
    count, details = store.count, store.details.count
    header = _HEADER.pack(
        _MAGIC,
        FORMAT_VERSION,
        voxel_map.workers.threads,
        voxel_map.voxel_m,
        voxel_map.max_range_m,
        voxel_map.version,
        count,
        details,
    )
    rows = (store.block_keys, store.log_odds, store.planning_occupied, store.planning_known, store.changed)
    arrays = [*(array[:count] for array in rows), store.details.row_of[:count], store.details.masks[:details]]
    compressor = zlib.compressobj(level=1)
    parts = [compressor.compress(np.ascontiguousarray(array).tobytes()) for array in arrays]
    body = b"".join((header, *parts, compressor.flush()))
    return body + _CRC.pack(crc32c(body))


def from_bytes(data: bytes) -> VoxelMap:
    """The map that `to_bytes` wrote. Raises InputError for anything else."""
    header = _checked_header(data)
    voxel_map = VoxelMap(header.voxel_m, header.max_range_m, header.threads)
    voxel_map.version = header.version
    voxel_map.store = _restored(_arrays(data[_HEADER.size : -_CRC.size], header), header)
    return voxel_map


def _checked_header(data: bytes) -> _Header:
    if len(data) < _HEADER.size + _CRC.size or not data.startswith(_MAGIC):
        raise InputError("not a stored map")
    header = _Header(*_HEADER.unpack_from(data))
    if header.format_version != FORMAT_VERSION:
        raise InputError(f"a map of format {header.format_version}, this program reads {FORMAT_VERSION}")
    if crc32c(data[: -_CRC.size]) != _CRC.unpack(data[-_CRC.size :])[0]:
        raise InputError("a damaged map: its checksum is wrong")
    if max(header.blocks, header.details) > _MAX_BLOCKS:
        raise InputError(f"a damaged map: {header.blocks} blocks")
    return header


def _layout(header: _Header) -> list[tuple[str, tuple[int, ...]]]:
    """Type and shape of the arrays in the order of the file."""
    blocks, masks = header.blocks, (header.blocks, BLOCK_EDGE)
    return [
        ("<i8", (blocks,)),
        ("<i1", (blocks, BLOCK_VOXELS)),
        ("<i8", masks),
        ("<i8", masks),
        ("<i8", (blocks,)),
        ("<i4", (blocks,)),
        ("<i8", (header.details, KINDS, BLOCK_EDGE)),
    ]


def _arrays(compressed: bytes, header: _Header) -> list[NDArray[np.signedinteger]]:
    """The stored arrays, never more of them than the header announces."""
    layout = _layout(header)
    sizes = [int(np.prod(shape)) * np.dtype(kind).itemsize for kind, shape in layout]
    try:
        raw = zlib.decompressobj().decompress(compressed, sum(sizes) + 1)
    except zlib.error as error:
        raise InputError(f"a damaged map: {error}") from error
    if len(raw) != sum(sizes):
        raise InputError("a damaged map: its arrays have another length than announced")
    starts = np.cumsum([0, *sizes[:-1]])
    return [
        np.frombuffer(raw, kind, int(np.prod(shape)), int(start)).reshape(shape)
        for (kind, shape), start in zip(layout, starts, strict=True)
    ]


def _restored(arrays: list[NDArray[np.signedinteger]], header: _Header) -> BlockStore:
    block_keys, log_odds, occupied, known, changed, detail_of, masks = arrays
    if len(np.unique(block_keys)) != header.blocks or (detail_of >= header.details).any():
        raise InputError("a damaged map: its blocks contradict each other")
    store = BlockStore(1 << max(10, (header.blocks - 1).bit_length()))
    count = header.blocks
    store.log_odds[:count], store.changed[:count] = log_odds, changed
    store.planning_occupied[:count], store.planning_known[:count] = occupied, known
    store.details.restore(detail_of, masks)
    store.restore_keys(block_keys)
    return store
