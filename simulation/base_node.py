"""The simulated base on the wire: the keys and bytes that a real one would use, and a thin zenoh shell."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import NamedTuple

import zenoh

from drivers.ros_messages import (
    ODOMETRY,
    TRIGGER,
    TriggerReply,
    decode_command,
    encode_odometry,
    encode_trigger_reply,
    message_type,
)
from drivers.ros_wire import Endpoint, EntityKind, Wire, gid_of, wire_of
from drivers.zenoh_session import close_session, open_session
from onboard.core.base import Posture
from onboard.core.config import BaseLink
from onboard.core.errors import WireError
from simulation.legged_base import LeggedBase

NODE = "legged_base"
ODOMETRY_HZ = 50.0


class Keys(NamedTuple):
    """Key expressions of the topics that a base takes and gives."""

    command: str
    odometry: str


@dataclass(slots=True)
class NodeCounters:
    """What has passed so far."""

    commands: int = 0
    damaged: int = 0
    unattached: int = 0
    """Commands that rmw_zenoh would drop: without its attachment."""


class BaseNode:
    """Bytes in, bytes out, in lock-step: no sockets, no clock."""

    def __init__(self, base: LeggedBase, settings: BaseLink) -> None:
        self.base = base
        self.settings = settings
        self.counters = NodeCounters()
        self.wire: Wire = wire_of(settings)
        self.command = Endpoint(settings.command_topic, message_type(settings.command_type))
        self.odometry = Endpoint(settings.odometry_topic, ODOMETRY)
        self.services: dict[Posture, Endpoint] = {
            "sit": Endpoint(settings.sit_service, TRIGGER),
            "stand": Endpoint(settings.stand_service, TRIGGER),
        }
        self.keys = Keys(self.wire.key(self.command), self.wire.key(self.odometry))
        self._due_s = 0.0

    def receive(self, payload: bytes, attachment: bytes | None) -> None:
        """A sample on the command's key."""
        if self.settings.bridge == "rmw_zenoh" and attachment is None:
            self.counters.unattached += 1
            return
        try:
            command = decode_command(self.settings.command_type, payload)
        except WireError:
            self.counters.damaged += 1
            return
        self.counters.commands += 1
        self.base.command(command.velocity)

    def serve(self, posture: Posture) -> bytes:
        """A query on one of the services' keys: the reply."""
        return encode_trigger_reply(TriggerReply(*self.base.ask(posture)))

    def step(self, dt_s: float) -> bytes | None:
        """Let time pass; the odometry message when one is due."""
        self.base.step(dt_s)
        if self.base.faults.mute or self.base.clock_s < self._due_s - 1e-9:
            return None
        self._due_s += 1.0 / ODOMETRY_HZ
        self._due_s = max(self._due_s, self.base.clock_s)
        return encode_odometry(self.base.odometry(), "odom", self.settings.frame)


class ZenohBase:
    """A `BaseNode` on a zenoh session; `step` belongs to the caller, zenoh's threads only hand in and ask."""

    def __init__(self, node: BaseNode) -> None:
        self.node = node
        settings = node.settings
        self._lock = threading.Lock()
        self._session = open_session(settings.mode, settings.connect, settings.listen)
        self._sent = 0
        zid = str(self._session.zid())
        self._gid = gid_of(f"{zid}/{NODE}")
        self._publisher = self._session.declare_publisher(node.keys.odometry)
        self._subscriber = self._session.declare_subscriber(node.keys.command, self._receive)
        # rmw_zenoh asks complete queryables only
        self._queryables = [
            self._session.declare_queryable(
                node.wire.key(service), self._server(posture, node.wire.key(service)), complete=True
            )
            for posture, service in node.services.items()
        ]
        servers: list[tuple[EntityKind, Endpoint]] = [("SS", service) for service in node.services.values()]
        tokens = node.wire.tokens(zid, NODE, [("MS", node.command), ("MP", node.odometry), *servers])
        self._tokens = [self._session.liveliness().declare_token(token) for token in tokens]

    def step(self, dt_s: float) -> None:
        """Let time pass and publish what is due."""
        with self._lock:
            payload = self.node.step(dt_s)
        if payload is not None:
            self._sent += 1
            self._publisher.put(payload, attachment=self._attachment())

    def close(self) -> None:
        close_session(self._session)

    def _attachment(self) -> bytes | None:
        return self.node.wire.attachment(self._sent, time.time_ns(), self._gid)

    def _receive(self, sample: zenoh.Sample) -> None:
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        with self._lock:
            self.node.receive(sample.payload.to_bytes(), attachment)

    def _server(self, posture: Posture, key: str) -> zenoh.handlers.Callback[zenoh.Query]:
        return zenoh.handlers.Callback(lambda query: self._serve(posture, key, query))

    def _serve(self, posture: Posture, key: str, query: zenoh.Query) -> None:
        with self._lock, query:
            query.reply(key, self.node.serve(posture), attachment=self._attachment())
