"""A CiA-402 motor controller on CANopen as a bracket: configuration by SDO, operation by PDO and heartbeats.

network = canopen.Network().connect(interface="socketcan", channel="can0")
port = Cia402Port(network, Cia402Settings(node=5))
port.configure()
report = port.step(now_s, permitted)      # 10 Hz or faster
"""

from __future__ import annotations

from dataclasses import dataclass

import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

from drivers.bracket_cia402 import Cia402Bracket, Order, Reading, drive_state
from drivers.bracket_types import Report, Sensors
from drivers.can_protection import LOST_S
from onboard.core.errors import InputError

HOST_HEARTBEAT_S = 0.1
EARLY_S = 1e-3
DRIVE_HEARTBEAT_MS = 100
STATUS_MS = 20
PROFILE_POSITION = 1
DISABLE_ON_LOSS = 2
"""Abort connection option code: disable voltage."""
OPERATIONAL = 0x05
VARIABLES = {
    0x1017: ("Producer heartbeat time", UNSIGNED16),
    0x6007: ("Abort connection option code", INTEGER16),
    0x6040: ("Controlword", UNSIGNED16),
    0x6041: ("Statusword", UNSIGNED16),
    0x6060: ("Modes of operation", INTEGER8),
    0x6075: ("Motor rated current", UNSIGNED32),
    0x6078: ("Current actual value", INTEGER16),
    0x607A: ("Target position", INTEGER32),
    0x60FD: ("Digital inputs", UNSIGNED32),
}
STATUS = (0x6041, 0x6078, 0x60FD)
ORDER = (0x6040, 0x607A)


@dataclass(frozen=True, slots=True)
class Cia402Settings:
    """Where the drive is and what its positions and inputs mean."""

    node: int
    host: int = 127
    """The host's own CANopen identifier."""
    closed_position: int = 0
    open_position: int = 10_000
    closed_input: int = 0x1
    """Bit of the digital inputs: the negative limit switch."""
    open_input: int = 0x2
    """The positive limit switch."""


def drive_dictionary() -> ObjectDictionary:
    """The objects of CiA 301 and 402 that a bracket needs."""
    dictionary = ObjectDictionary()
    for index, (name, kind) in VARIABLES.items():
        dictionary.add_object(_variable(name, index, 0, kind))
    _add_record(dictionary, "Consumer heartbeat time", 0x1016, [UNSIGNED32])
    for receive in (True, False):
        base, name = (0x1400, "RPDO") if receive else (0x1800, "TPDO")
        kinds = [UNSIGNED32, UNSIGNED8, UNSIGNED16, UNSIGNED8, UNSIGNED16]
        _add_record(dictionary, f"{name} communication parameter", base, kinds)
        _add_record(dictionary, f"{name} mapping parameter", base + 0x200, [UNSIGNED32] * 4)
    return dictionary


def _variable(name: str, index: int, subindex: int, kind: int) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type, variable.access_type, variable.default = kind, "rw", 0
    return variable


def _add_record(dictionary: ObjectDictionary, name: str, index: int, kinds: list[int]) -> None:
    record = ODRecord(name, index)
    record.add_member(_variable(f"{name} count", index, 0, UNSIGNED8))
    for subindex, kind in enumerate(kinds, start=1):
        record.add_member(_variable(f"{name} {subindex}", index, subindex, kind))
    dictionary.add_object(record)


class Cia402Port:
    """One drive on a connected canopen network."""

    def __init__(
        self,
        network: canopen.Network,
        settings: Cia402Settings,
        dictionary: ObjectDictionary | str | None = None,
    ) -> None:
        """`dictionary`: the drive's own EDS file, where the built-in objects do not fit."""
        self._network = network
        self._settings = settings
        self._node = network.add_node(settings.node, dictionary or drive_dictionary())
        self._bracket = Cia402Bracket()
        self._rated_ma = 0.0
        self._beats = self._beats_seen = 0
        self._heartbeat_s: float | None = None
        self._statuses = self._statuses_seen = 0
        self._sensors: Sensors | None = None
        self._sent_s: float | None = None
        self._node.nmt.add_heartbeat_callback(self._heard)

    def configure(self) -> None:
        """Set up the drive. Raises InputError when it does not answer or refuses an object."""
        settings, sdo = self._settings, self._node.sdo
        try:
            self._node.nmt.state = "PRE-OPERATIONAL"
            sdo[0x1017].raw = DRIVE_HEARTBEAT_MS
            sdo[0x1016][1].raw = settings.host << 16 | round(LOST_S * 1000)
            sdo[0x6007].raw = DISABLE_ON_LOSS
            sdo[0x6060].raw = PROFILE_POSITION
            sdo[0x607A].raw = settings.closed_position
            self._rated_ma = float(sdo[0x6075].raw)
            self._map()
            self._node.nmt.state = "OPERATIONAL"
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
            raise InputError(f"CANopen node {settings.node}: {error}; is it a CiA 402 drive?") from error

    def _map(self) -> None:
        receive, transmit = self._node.rpdo[1], self._node.tpdo[1]
        for pdo, objects, cob_id in ((receive, ORDER, 0x200), (transmit, STATUS, 0x180)):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.cob_id, pdo.enabled, pdo.trans_type = cob_id + self._settings.node, True, 255
        transmit.event_timer = STATUS_MS
        receive.save()
        transmit.save()
        transmit.add_callback(self._reported)

    def _heard(self, state: int) -> None:
        self._beats += state == OPERATIONAL

    def _reported(self, _: object) -> None:
        self._statuses += 1

    def step(self, now_s: float, permitted: bool = False, lock: bool = False) -> Report:
        """One step: what came since the last one, what to do, how it stands."""
        order = self._bracket.step(now_s, self._reading(now_s), self._heartbeat_s, permitted, lock)
        self._send(now_s, order)
        return self._bracket.report()

    def _reading(self, now_s: float) -> Reading | None:
        """The last status, from a drive whose heartbeat is there."""
        beats, statuses = self._beats, self._statuses
        if beats != self._beats_seen:
            self._beats_seen, self._heartbeat_s = beats, now_s
        if statuses != self._statuses_seen:
            self._statuses_seen, self._sensors = statuses, self._measured(now_s)
        there = self._heartbeat_s is not None and 0.0 <= now_s - self._heartbeat_s < LOST_S
        if not there or self._sensors is None:
            return None
        return Reading(drive_state(int(self._node.tpdo[1][0x6041].raw)), self._sensors)

    def _measured(self, now_s: float) -> Sensors:
        status, settings = self._node.tpdo[1], self._settings
        inputs = int(status[0x60FD].raw)
        current_a = float(status[0x6078].raw) * self._rated_ma * 1e-6
        closed, opened = inputs & settings.closed_input != 0, inputs & settings.open_input != 0
        return Sensors(now_s, current_a, float("nan"), closed, opened)

    def _send(self, now_s: float, order: Order) -> None:
        settings, pdo = self._settings, self._node.rpdo[1]
        pdo[0x6040].raw = order.controlword
        pdo[0x607A].raw = settings.open_position if order.open else settings.closed_position
        pdo.transmit()
        if self._sent_s is None or now_s - self._sent_s >= HOST_HEARTBEAT_S - EARLY_S:
            self._sent_s = now_s
            self._network.send_message(0x700 + settings.host, bytes([OPERATIONAL]))
