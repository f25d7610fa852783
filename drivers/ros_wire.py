"""How ROS 2 topics and services are named on zenoh: by zenoh-plugin-ros2dds, and by rmw_zenoh_cpp.

The layouts and their sources are in docs/base.md.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.ros_messages import TRIGGER, type_hash
from onboard.core.config import BaseLink

GID_BYTES = 16
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Of std_srvs/srv/Trigger, as `ros2 service info` and the type description in its package give it."""
NO_HASH = "TypeHashNotSupported"
"""What ROS 2 Humble, which knows no hashes, has in their place."""
DEFAULT_QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last 10 kept; a field is empty where it is the middleware's default."""

EntityKind = Literal["NN", "MP", "MS", "SS", "SC"]
"""Node, publisher, subscription, service server, service client."""

_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A topic or a service: name without leading slash, and full ROS type."""

    name: str
    type: str


class Wire(Protocol):
    """Keys and attachments of one of the two."""

    def key(self, endpoint: Endpoint) -> str:
        """Key expression of a topic's samples or of a service's queries."""

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> bytes | None:
        """What goes with every sample, request and reply."""

    def tokens(self, zid: str, node: str, entities: list[tuple[EntityKind, Endpoint]]) -> list[str]:
        """Liveliness tokens that make a node and its entities part of the ROS graph."""


@dataclass(frozen=True, slots=True)
class Ros2ddsWire:
    """Behind zenoh-bridge-ros2dds: the name is the key, and nothing but the CDR bytes travels.

    The bridge makes its routes when it finds the base's own endpoints: strangers need no token.
    """

    namespace: str = ""

    def key(self, endpoint: Endpoint) -> str:
        return _full_name(self.namespace, endpoint.name)

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> None:
        return None

    def tokens(self, zid: str, node: str, entities: list[tuple[EntityKind, Endpoint]]) -> list[str]:
        return []


@dataclass(frozen=True, slots=True)
class RmwZenohWire:
    """ROS 2 on rmw_zenoh_cpp: domain, type and type hash are part of the key."""

    namespace: str = ""
    domain: int = 0
    type_hashes: bool = True

    def key(self, endpoint: Endpoint) -> str:
        name = _full_name(self.namespace, endpoint.name)
        return f"{self.domain}/{name}/{self._type(endpoint)}"

    def attachment(self, sequence: int, stamp_ns: int, gid: bytes) -> bytes:
        return _ATTACHMENT.pack(sequence, stamp_ns, GID_BYTES, gid)

    def tokens(self, zid: str, node: str, entities: list[tuple[EntityKind, Endpoint]]) -> list[str]:
        return [
            self._token(zid, 0, "NN", node),
            *(
                self._token(zid, number, kind, node)
                + f"/{_mangled(self.namespace, endpoint.name)}/{self._type(endpoint)}/{DEFAULT_QOS}"
                for number, (kind, endpoint) in enumerate(entities, start=1)
            ),
        ]

    def _type(self, endpoint: Endpoint) -> str:
        return f"{dds_type(endpoint.type)}/{_hash(endpoint.type) if self.type_hashes else NO_HASH}"

    def _token(self, zid: str, number: int, kind: EntityKind, node: str) -> str:
        """A node in the root namespace and without an enclave; all entities belong to node 0."""
        return f"@ros2_lv/{self.domain}/{zid}/0/{number}/{kind}/%/%/{node}"


def wire_of(settings: BaseLink) -> Wire:
    """The wire that the configuration names."""
    if settings.bridge == "ros2dds":
        return Ros2ddsWire(settings.namespace)
    return RmwZenohWire(settings.namespace, settings.domain, settings.type_hashes)


def unpack_attachment(attachment: bytes) -> tuple[int, int, bytes] | None:
    """(sequence number, nanoseconds since the epoch, gid) of rmw_zenoh's attachment; None for other bytes."""
    if len(attachment) != _ATTACHMENT.size:
        return None
    sequence, stamp_ns, length, gid = _ATTACHMENT.unpack(attachment)
    return (sequence, stamp_ns, gid) if length == GID_BYTES else None


def gid_of(text: str) -> bytes:
    """Identifier (16 bytes) of an endpoint: receivers only compare it, so any hash will do."""
    return hashlib.sha256(text.encode()).digest()[:GID_BYTES]


def dds_type(name: str) -> str:
    """`geometry_msgs/msg/Twist` as DDS and rmw_zenoh write it: `geometry_msgs::msg::dds_::Twist_`."""
    package, group, message = name.split("/")
    return f"{package}::{group}::dds_::{message}_"


def _hash(name: str) -> str:
    return TRIGGER_HASH if name == TRIGGER else type_hash(name)


def _full_name(namespace: str, name: str) -> str:
    return f"{namespace}/{name}" if namespace else name


def _mangled(namespace: str, name: str) -> str:
    return "%" + _full_name(namespace, name).replace("/", "%")
