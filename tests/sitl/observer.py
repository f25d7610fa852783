"""The independent witness: what mavsdk hears of a vehicle, as lines of JSON. Shares no code with the driver.

Usage: python observer.py PORT
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync


def tell(kind: str, value: Any) -> None:
    """One line."""
    sys.stdout.write(json.dumps({"t": time.monotonic(), "kind": kind, "value": value}) + "\n")
    sys.stdout.flush()


async def follow(kind: str, stream: AsyncIterator[Any], read: Any) -> None:
    """Every change of a stream."""
    before = None
    async for item in stream:
        value = read(item)
        if value != before:
            before = value
            tell(kind, value)


def place(item: Any) -> list[float]:
    """North, east, down in metres."""
    position = item.position
    return [round(float(v), 3) for v in (position.north_m, position.east_m, position.down_m)]


async def observe(port: int) -> None:
    """Until killed."""
    role = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
    async with Mavsdk(role) as witness:
        await witness.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await witness.first_autopilot(timeout_s=20)
        if system is None:
            tell("error", "no autopilot heard")
            return
        tell("system", 1)
        telemetry = TelemetryAsync(system)
        await asyncio.gather(
            follow("armed", telemetry.subscribe_armed(), bool),
            follow("landed", telemetry.subscribe_landed_state(), int),
            follow("mode", telemetry.subscribe_flight_mode(), int),
            follow("place", telemetry.subscribe_position_velocity_ned(), place),
        )


if __name__ == "__main__":
    asyncio.run(observe(int(sys.argv[1])))
