"""Bodies of the frames that carry a large piece of data, and of what becomes of it (docs/wire.md)."""

from __future__ import annotations

import struct

from onboard.core.errors import WireError
from onboard.sharing.messages import (
    CHUNK_BYTES,
    MAX_CHUNKS,
    MAX_MISSING,
    Chunk,
    ChunkRange,
    Located,
    Missing,
    Offer,
)
from onboard.sharing.packing import Reader, checked_count


def pack_offer(message: Offer) -> bytes:
    checked_count(message.length, MAX_CHUNKS * CHUNK_BYTES)
    return struct.pack("<HII", message.name, message.length, message.checksum)


def unpack_offer(reader: Reader) -> Offer:
    name = reader.integer("H")
    length = reader.count("I", MAX_CHUNKS * CHUNK_BYTES)
    return Offer(name, length, reader.integer("I"))


def pack_chunk(message: Chunk) -> bytes:
    checked_count(len(message.payload), CHUNK_BYTES)
    checked_count(message.index, MAX_CHUNKS - 1)
    return struct.pack("<HIH", message.name, message.checksum, message.index) + message.payload


def unpack_chunk(reader: Reader) -> Chunk:
    name, checksum = reader.take("HI")
    return Chunk(name, checksum, reader.count("H", MAX_CHUNKS - 1), reader.rest(CHUNK_BYTES))


def pack_missing(message: Missing) -> bytes:
    count = checked_count(len(message.spans), MAX_MISSING)
    spans = (struct.pack("<HH", span.first, span.count) for span in message.spans)
    return struct.pack("<HIB", message.name, message.checksum, count) + b"".join(spans)


def unpack_missing(reader: Reader) -> Missing:
    name, checksum = reader.take("HI")
    spans = tuple(ChunkRange(*reader.take("HH")) for _ in range(reader.count("B", MAX_MISSING)))
    free = 0
    for span in spans:
        if span.first < free or span.count == 0 or span.first + span.count > MAX_CHUNKS:
            raise WireError("ranges of missing chunks are empty, overlap or overflow")
        free = span.first + span.count + 1
    return Missing(name, checksum, spans)


def pack_located(message: Located) -> bytes:
    return struct.pack("<HB", message.name, message.code)


def unpack_located(reader: Reader) -> Located:
    name, code = reader.take("HB")
    return Located(name, code)
