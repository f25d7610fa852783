"""What robots say to each other: one frozen struct per frame kind (bytes: docs/wire.md)."""

from __future__ import annotations

import msgspec

Vector = tuple[float, float, float]
"""Position in the map frame, metres; 1 cm on the air."""

MAX_PAYLOAD_BYTES = 60_000
MAX_ALTERNATIVES = 3
MAX_TIMES = 3000
MAX_SOURCES = 255
MAX_RANGES = 32
MAX_BUNDLES = 16
MAX_BIDS = 4
CHUNK_BYTES = 1200
"""Payload of a chunk: with its frame it fits one Ethernet packet."""
MAX_CHUNKS = 1024
MAX_MISSING = 64
MAX_KNOTS = 1000


class KeyframeMessage(msgspec.Struct, frozen=True):
    """One keyframe of robot `source`; `payload` is what onboard.codec wrote."""

    source: int
    sequence: int
    stamp_s: float
    payload: bytes


class SourceRanges(msgspec.Struct, frozen=True):
    """Sequences of one source that a robot holds: ascending (first, count), gaps between them."""

    source: int
    ranges: tuple[tuple[int, int], ...]


class Digest(msgspec.Struct, frozen=True):
    """Everything that the sender holds at its time `stamp_s`: acknowledgement and request in one."""

    stamp_s: float
    sources: tuple[SourceRanges, ...]


class Status(msgspec.Struct, frozen=True):
    """The beacon: where a robot is, what it does and what it has left. `battery_ratio` lies in [0, 1]."""

    stamp_s: float
    phase: int
    position_m: Vector
    battery_ratio: float
    goal_m: Vector | None
    remaining_s: float
    keyframes: int


class Target(msgspec.Struct, frozen=True):
    """Where the aerial robot should go when deployed, and up to three alternatives."""

    position_m: Vector
    alternatives_m: tuple[Vector, ...] = ()


class TravelTime(msgspec.Struct, frozen=True):
    """Time in which the sender can be at its keyframe `sequence` (0.1 s on the air, at most 6553.5 s)."""

    sequence: int
    position_m: Vector
    time_s: float


class Times(msgspec.Struct, frozen=True):
    """Travel times to keyframes of the sender, from which the regrouping point is chosen."""

    times: tuple[TravelTime, ...]


class Propose(msgspec.Struct, frozen=True):
    """Proposal `epoch` to regroup at `position_m` by `deadline_s`."""

    epoch: int
    position_m: Vector
    deadline_s: float


class Ack(msgspec.Struct, frozen=True):
    """The sender agrees to proposal `epoch`."""

    epoch: int


class Commit(msgspec.Struct, frozen=True):
    """Proposal `epoch` holds from now on."""

    epoch: int
    position_m: Vector


class Release(msgspec.Struct, frozen=True):
    """The carrier lets the aerial robot go at `position_m`; its next status phase confirms."""

    position_m: Vector


class BidMessage(msgspec.Struct, frozen=True):
    """A claim to look at what is around `position_m`, worth `score` m^3/s (0.001 on the air)."""

    position_m: Vector
    score: float


class BundleMessage(msgspec.Struct, frozen=True):
    """The newest bids of a robot, `age_s` old (0.1 s on the air)."""

    robot: int
    age_s: float
    bids: tuple[BidMessage, ...]


class Bids(msgspec.Struct, frozen=True):
    """The bundles that the sender knows, its own among them, for the auction of what to explore."""

    bundles: tuple[BundleMessage, ...]


class Offer(msgspec.Struct, frozen=True):
    """The sender has data `name` of `length` bytes with this CRC32C and will send it in chunks."""

    name: int
    length: int
    checksum: int

    @property
    def chunks(self) -> int:
        """Number of chunks, all of CHUNK_BYTES but the last."""
        return -(-self.length // CHUNK_BYTES)


class Chunk(msgspec.Struct, frozen=True):
    """Bytes from `index` * CHUNK_BYTES on of the offered data that has this name and checksum."""

    name: int
    checksum: int
    index: int
    payload: bytes


class ChunkRange(msgspec.Struct, frozen=True):
    """Chunks `first` to `first + count - 1`."""

    first: int
    count: int


class Missing(msgspec.Struct, frozen=True):
    """The sender lacks these chunks of an offer, or none of them: acknowledgement and request in one."""

    name: int
    checksum: int
    spans: tuple[ChunkRange, ...]

    @property
    def complete(self) -> bool:
        """Whether everything has arrived and its checksum matches."""
        return not self.spans


class Located(msgspec.Struct, frozen=True):
    """What came of the sender's co-localisation in the map of `name`'s cloud: 0 accepted, else why not."""

    name: int
    code: int


class CorrectionKnot(msgspec.Struct, frozen=True):
    """Keyframe `sequence` is moved by `shift_m` (5 mm on the air, at most 163 m) and turned by the rotation
    vector `turn_rad` (0.1 mrad on the air, at most 3.27 rad), both in map axes."""

    sequence: int
    shift_m: Vector
    turn_rad: Vector


class Corrections(msgspec.Struct, frozen=True):
    """Revision of all poses of `source`'s keyframes against those that they carry, linear between the knots.

    Without knots: the sender holds this revision of `source`'s corrections.
    """

    source: int
    revision: int
    knots: tuple[CorrectionKnot, ...]


Message = (
    KeyframeMessage
    | Digest
    | Status
    | Target
    | Times
    | Propose
    | Ack
    | Commit
    | Release
    | Bids
    | Offer
    | Chunk
    | Missing
    | Located
    | Corrections
)
