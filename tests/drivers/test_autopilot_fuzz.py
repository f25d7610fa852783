"""Messages of any kind with any numbers, to both ends of the wire: nothing raises, nothing absurd is sent."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import pytest

from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import common, message
from drivers.mavlink.frames import Pose
from drivers.mavlink.link import VehicleLink
from simulation.px4.vehicle import Px4Vehicle

LEVEL = (0.0, 0.0, 0.0, 1.0)
HOSTILE = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e38, 1e-38)


def random_message(chance: random.Random, kind: Any) -> Any:
    """An instance with fields drawn from their whole range."""
    size = kind.unpacker.size
    values = kind.unpacker.unpack(bytes(chance.randrange(256) for _ in range(size)))
    layout = kind.unpacker.format.lstrip("<")
    if chance.random() < 0.7 and set(layout) <= set("fdBbHhIiQq"):
        codes = struct.Struct("<" + layout)
        values = tuple(
            chance.choice(HOSTILE) if isinstance(v, float) else v for v in codes.unpack(codes.pack(*values))
        )
    flat = list(values)
    fields: list[Any] = []
    for place in kind.orders:
        start, length = sum(kind.lengths[:place]), kind.lengths[place]
        fields.append(flat[start] if length == 1 else flat[start : start + length])
    return kind(*fields)


def kinds() -> list[Any]:
    return [kind for number, kind in sorted(common.mavlink_map.items()) if number != 0]


@pytest.mark.parametrize("seed", range(4))
def test_link_survives_anything(seed: int) -> None:
    chance, sender, link = random.Random(seed), Channel(1, 1), VehicleLink()
    receiver, now_s, sent = Channel(2, 2), 0.0, 0
    link.step(now_s, sender.pack(message["HEARTBEAT"](2, 12, 145, 6 << 16, 4, 3)))
    link.engage()
    for kind in kinds() * 3:
        now_s += 0.01
        link.set_pose(Pose(now_s, (1.0, 2.0, 3.0), LEVEL))
        data = b"".join(sender.pack(random_message(chance, kind)) for _ in range(3))
        link.receive(now_s, data)
        link.engage()
        link.send_setpoint((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
        for packet in receiver.receive(link.flush()):
            if packet.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                sent += 1
                assert all(map(math.isfinite, (packet.x, packet.y, packet.z, packet.vx, packet.yaw)))
    assert sent > 100
    link.notices()


@pytest.mark.parametrize("seed", range(4))
def test_simulated_vehicle_survives_anything(seed: int) -> None:
    chance, sender, vehicle = random.Random(seed), Channel(1, 191), Px4Vehicle(seed=seed)
    for tick, kind in enumerate(kinds() * 2, start=1):
        packet = random_message(chance, kind)
        if hasattr(packet, "target_system") and chance.random() < 0.8:
            packet.target_system, packet.target_component = 1, 1
        numbers = [chance.choice((*HOSTILE, 1.0, 6.0)) for _ in range(7)]
        command = chance.choice((20, 21, 22, 176, 185, 400, 511, 512))
        order = message["COMMAND_LONG"](1, 1, command, 0, *numbers)
        vehicle.step(tick / 50, sender.pack(packet) + sender.pack(order))
    assert all(map(math.isfinite, vehicle.autopilot.body.position))


def test_setpoint_that_is_no_number_is_not_sent() -> None:
    link = VehicleLink()
    link.step(0.0)
    link.engage()
    assert not link.send_setpoint((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
    assert link.send_setpoint((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
