"""Damaged packets through the LiDAR drivers' decoders: none may crash, hang or fill the memory.

Usage: python -m benchmarks.lidar_fuzz --count 100000 [--sensor velodyne|ouster] [--seed N]
"""

from __future__ import annotations

import argparse
import faulthandler
import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console

from drivers.ouster import OusterDecoder
from drivers.types import Decoder, LidarScan
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import VLP_16_PRODUCT
from onboard.core.imu import ImuSample
from onboard.core.lidar import OS0_64, VLP_16, LidarModel, Scan
from simulation.ouster_packets import Profile, SimulatedOuster
from simulation.velodyne_packets import TimedPacket, velodyne_packets

PROFILES: dict[str, Profile] = {"ouster": "RNG15_RFL8_NIR8", "ouster-19": "RNG19_RFL8_SIG16_NIR16"}
SENSORS = ("velodyne", *PROFILES)
console = Console()
HANG_S = 30.0
REPORT_S = 10.0
SCANS = 4
SWEEP_S = 0.1
DAMAGES = ("flip", "burst", "cut", "long", "noise", "again", "swap", "lose", "foreign", "sound")
DAMAGE_SHARES = (0.15, 0.1, 0.1, 0.05, 0.1, 0.05, 0.1, 0.05, 0.05, 0.25)
FOREIGN_BYTES = (0, 1, 48, 512, 1206, 1248, 4352, 12_544, 60_000)
HOST_BEGIN_S, DEVICE_BEGIN_S = 10_000.0, 3599.5


@dataclass
class Outcome:
    """What came of the packets."""

    packets: int = 0
    scans: int = 0
    imu_samples: int = 0
    events: int = 0
    slowest_ms: float = 0.0
    memory_mb: float = 0.0
    wrong: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return (
            f"{self.scans} scans, {self.imu_samples} inertial samples, {self.events} events, slowest packet "
            f"{self.slowest_ms:.1f} ms, memory +{self.memory_mb:.1f} MB, {len(self.wrong)} wrong outputs"
        )


class Fuzzer:
    """An endless stream of one sensor's packets, most of them damaged; the same for the same seed."""

    def __init__(self, sensor: str, seed: int) -> None:
        self._rng = np.random.default_rng([seed, SENSORS.index(sensor)])
        model = VLP_16 if sensor == "velodyne" else OS0_64
        self._scans = [_scan(model, self._rng) for _ in range(SCANS)]
        self._ouster = None if sensor == "velodyne" else SimulatedOuster(PROFILES[sensor])
        self.decoder: Decoder = (
            VelodyneDecoder(VLP_16_PRODUCT) if self._ouster is None else OusterDecoder(self._ouster.info)
        )
        self._held: bytes | None = None

    def packets(self) -> Iterator[tuple[bytes, float]]:
        """Payloads and arrivals; now and then the sensor is restarted, or nothing arrives for seconds."""
        clock_s, host_s = DEVICE_BEGIN_S, HOST_BEGIN_S
        last = b""
        while True:
            if self._rng.random() < 0.02:
                clock_s = float(self._rng.uniform(0, 3600))
                host_s += float(self._rng.uniform(0, 5))
            for packet in self._turn(clock_s):
                for payload in self._damaged(packet.payload, last):
                    yield payload, host_s + packet.device_s - clock_s
                last = packet.payload
            clock_s, host_s = clock_s + SWEEP_S, host_s + SWEEP_S

    def _turn(self, begin_s: float) -> list[TimedPacket]:
        scan = self._scans[int(self._rng.integers(SCANS))]
        if self._ouster is None:
            return velodyne_packets(scan, begin_s)
        imu = [self._ouster.imu_packet(begin_s + k * 0.01, (0, 0, 9.8), (0, 0, 0.1)) for k in range(10)]
        return sorted([*self._ouster.packets(scan, begin_s), *imu], key=lambda packet: packet.device_s)

    def _damaged(self, payload: bytes, last: bytes) -> list[bytes]:
        rng = self._rng
        kind = DAMAGES[int(np.searchsorted(np.cumsum(DAMAGE_SHARES), rng.random()))]
        if kind == "swap":
            held, self._held = self._held, payload
            return [held] if held is not None else []
        start = int(rng.integers(len(payload)))
        noise = rng.bytes(int(rng.integers(1, 200)))
        made: dict[str, Callable[[], list[bytes]]] = {
            "flip": lambda: [_flipped(payload, rng, int(rng.integers(1, 9)))],
            "burst": lambda: [(payload[:start] + noise + payload[start + len(noise) :])[: len(payload)]],
            "cut": lambda: [payload[:start]],
            "long": lambda: [payload + noise],
            "noise": lambda: [rng.bytes(len(payload))],
            "again": lambda: [payload, last or payload],
            "lose": list,
            "foreign": lambda: [rng.bytes(int(rng.choice(FOREIGN_BYTES)))],
            "sound": lambda: [payload],
        }
        return made[kind]()


def _flipped(payload: bytes, rng: np.random.Generator, count: int) -> bytes:
    """`count` bits turned over, half of the time in the headers, where they hurt."""
    data = bytearray(payload)
    reach = len(data) if rng.random() < 0.5 else min(64, len(data))
    for _ in range(count):
        data[int(rng.integers(reach))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _scan(model: LidarModel, rng: np.random.Generator) -> Scan:
    ranges = rng.uniform(0.5, 40.0, (model.rows, model.columns)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.2] = np.inf
    return Scan(0.0, ranges, model)


def attack(
    sensor: str,
    count: int,
    seed: int,
    report: Callable[[Outcome], None] = lambda _outcome: None,
) -> Outcome:
    """Feed `count` packets; `report` is told the outcome after each."""
    fuzzer, outcome = Fuzzer(sensor, seed), Outcome()
    before_mb = peak_memory_mb()
    for number, (payload, arrival_s) in enumerate(fuzzer.packets()):
        if number == count:
            break
        if number % 1000 == 0:
            faulthandler.dump_traceback_later(HANG_S, exit=True)
        begun = time.process_time()
        found = fuzzer.decoder.feed(payload, arrival_s)
        outcome.slowest_ms = max(outcome.slowest_ms, 1e3 * (time.process_time() - begun))
        outcome.packets += 1
        outcome.memory_mb = peak_memory_mb() - before_mb
        for output in found:
            _judge(output, outcome)
        report(outcome)
    faulthandler.cancel_dump_traceback_later()
    return outcome


def _judge(output: object, outcome: Outcome) -> None:
    """Count an output, and note what no caller should ever get."""
    if isinstance(output, ImuSample):
        outcome.imu_samples += 1
        if not np.isfinite([*output.acceleration_m_s2, *output.angular_rate_rad_s, output.stamp_s]).all():
            outcome.wrong.append("inertial sample that is not finite")
    elif isinstance(output, LidarScan):
        outcome.scans += 1
        image = output.image
        sound = np.isfinite(output.points).all() and np.isfinite(output.stamp_s)
        if image is None or not sound or np.isnan(image.ranges).any() or (image.ranges < 0).any():
            outcome.wrong.append("scan with impossible ranges")
        if output.offsets_s is not None and len(output.offsets_s) and np.abs(output.offsets_s).max() > 1.0:
            outcome.wrong.append("point more than a second off its scan")
    else:
        outcome.events += 1


def peak_memory_mb() -> float:
    """The most that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(arguments: Sequence[str] | None = None) -> int:
    """0 where every packet kept the limits."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lidar_fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=100_000, help="packets per sensor")
    parser.add_argument("--sensor", choices=SENSORS, action="append", help="default: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-mb", type=float, default=32.0, help="memory beyond that at the start")
    options = parser.parse_args(arguments)
    failed = False
    for sensor in options.sensor or SENSORS:
        told = [time.monotonic()]

        def report(outcome: Outcome, sensor: str = sensor, told: list[float] = told) -> None:
            if time.monotonic() - told[0] >= REPORT_S:
                told[0] = time.monotonic()
                console.print(f"{sensor}: {outcome.packets} of {options.count}: {outcome}", soft_wrap=True)

        outcome = attack(sensor, options.count, options.seed, report)
        console.print(f"{sensor}: {outcome.packets} packets: {outcome}", highlight=False, soft_wrap=True)
        for text in outcome.wrong[:5]:
            console.print(f"  {text}", style="red")
        failed |= bool(outcome.wrong) or outcome.memory_mb > options.limit_mb
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
