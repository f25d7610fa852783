"""Damaged keyframes against the decoder: `python -m benchmarks.codec.fuzz --count 100000`.

Stream n follows from seed and n alone: `--start` goes on where a run ended, or shares the streams out. Every
stream must be refused with CodecError or decode to ranges that a map may use, within the time and the memory
that are asked for. A stream that hangs ends the program with a traceback.
"""

from __future__ import annotations

import argparse
import faulthandler
import resource
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.status import Status

from onboard.codec import Keyframe, decode, encode
from onboard.core.crc import crc32c
from onboard.core.errors import CodecError
from onboard.core.geometry import Pose
from onboard.core.lidar import MODELS, LidarModel, Scan

HANG_S = 60.0
CODECS = ("quadtree", "exact")
_BUDGETS = (90, 300, 900)
_REFUSAL_SHARE = 0.2
REPORT_S = 30.0
"""Between two lines of progress where the output is no terminal."""
_REDRAW_S = 0.5
console = Console(stderr=True)


@dataclass
class Outcome:
    """What became of the streams; memory is that beyond what sound keyframes took."""

    refused: int = 0
    decoded: int = 0
    slowest_ms: float = 0.0
    memory_mb: float = 0.0

    def __str__(self) -> str:
        return (
            f"{self.refused} refused, {self.decoded} decoded, slowest {self.slowest_ms:.0f} ms, "
            f"{self.memory_mb:.0f} MB more than sound keyframes take"
        )


class Fuzzer:
    """Sound keyframes of both LiDARs and the classical codecs, and streams made from them."""

    def __init__(self, seed: int, codecs: Sequence[str] = CODECS) -> None:
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self._codecs = codecs
        self._held: dict[int, Keyframe] = {}
        self._bodies = [body for model in MODELS.values() for body in self._sound(model)]

    def _sound(self, model: LidarModel) -> list[bytes]:
        scans = [made_up_scan(model, number) for number in range(2)] + [blind_scan(model, 2)]
        pose = Pose.from_rpy(np.array([12.345, -6.789, 1.5]), 0.1, -0.2, 2.5)
        frames = [encode(scan, pose, codec="quadtree", budget_bytes=b) for scan in scans for b in _BUDGETS]
        if "exact" in self._codecs:
            exact = [encode(scan, pose, codec="exact") for scan in scans]
            self._held[model.code] = decode(exact[0])
            known = [(model.code, self._held[model.code])]
            frames += exact + [encode(scan, pose, codec="exact", references=known) for scan in scans]
        return [frame[:-4] for frame in frames]

    def stream(self, number: int) -> bytes:
        """Damaged keyframe `number`; in four of five cases with a checksum that fits."""
        self._rng = np.random.default_rng([self._seed, number])
        body = self._damaged()
        if self._rng.random() < _REFUSAL_SHARE:
            return body + self._rng.bytes(4)
        return body + struct.pack("<I", crc32c(body))

    def survives(self, data: bytes) -> bool:
        """Whether `data` decodes; raises AssertionError where it decodes to what no map may use."""
        try:
            keyframe = decode(data, self._held.get)
        except CodecError:
            return False
        finite = keyframe.ranges[np.isfinite(keyframe.ranges)]
        sound = (keyframe.ranges >= 0).all() and (finite.size == 0 or float(finite.max()) <= 20.5)
        if not sound:
            raise AssertionError(f"decodes to ranges beyond reason: {data.hex()}")
        return True

    def _damaged(self) -> bytes:
        """One of the sound bodies with one to four blows."""
        rng = self._rng
        data = bytearray(self._any_body())
        for _ in range(rng.integers(1, 5)):
            place = int(rng.integers(len(data))) if data else 0
            length = int(rng.integers(1, 20))
            match int(rng.integers(4)):
                case 0 if data:
                    data[place] = int(rng.integers(256))
                case 1:
                    del data[place : place + length]
                case 2:
                    data[place:place] = rng.bytes(length)
                case _:
                    other = self._any_body()
                    data[place:] = other[int(rng.integers(len(other))) :]
        return bytes(data)

    def _any_body(self) -> bytes:
        return self._bodies[int(self._rng.integers(len(self._bodies)))]


def made_up_scan(model: LidarModel, seed: int) -> Scan:
    """A box around the sensor with noise, dropouts and an open end."""
    rng = np.random.default_rng(seed)
    half_m = rng.uniform((2.0, 4.0, 1.0), (8.0, 40.0, 3.0))
    with np.errstate(divide="ignore"):
        ranges = (half_m / np.abs(model.directions.astype(np.float64))).min(axis=-1)
    ranges = np.where(ranges > 20, np.inf, ranges + rng.normal(0, 0.02, ranges.shape))
    ranges[rng.random(ranges.shape) < 0.02] = 0
    return Scan(0.0, ranges.astype(np.float32), model)


def blind_scan(model: LidarModel, seed: int) -> Scan:
    """`made_up_scan` of which a sector and every third row are not seen."""
    ranges = made_up_scan(model, seed).ranges.copy()
    ranges[:, model.columns // 4 : model.columns // 2] = 0
    ranges[::3] = 0
    return Scan(0.0, ranges, model)


def attack(
    count: int,
    seed: int,
    codecs: Sequence[str] = CODECS,
    start: int = 0,
    report: Callable[[int, Outcome], None] = lambda _number, _outcome: None,
) -> Outcome:
    """Decode the damaged streams start .. start + count - 1; `report` is told the next one after each."""
    fuzzer, outcome = Fuzzer(seed, codecs), Outcome()
    before_mb = peak_memory_mb()
    for number in range(start, start + count):
        data = fuzzer.stream(number)
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        begun = time.perf_counter()
        survived = fuzzer.survives(data)
        outcome.slowest_ms = max(outcome.slowest_ms, 1e3 * (time.perf_counter() - begun))
        outcome.decoded += survived
        outcome.refused += not survived
        outcome.memory_mb = peak_memory_mb() - before_mb
        report(number + 1, outcome)
    faulthandler.cancel_dump_traceback_later()
    return outcome


class Reporter:
    """Tells how far the attack is: in place on a terminal, else in lines."""

    def __init__(self, end: int, status: Status) -> None:
        self._end = end
        self._status = status
        self._told = time.monotonic()

    def __call__(self, number: int, outcome: Outcome) -> None:
        now = time.monotonic()
        if now - self._told < (_REDRAW_S if console.is_terminal else REPORT_S):
            return
        self._told = now
        text = f"stream {number} of {self._end}: {outcome}"
        if console.is_terminal:
            self._status.update(text)
        else:
            console.print(text, highlight=False, soft_wrap=True)


def peak_memory_mb() -> float:
    """The most that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(arguments: Sequence[str] | None = None) -> int:
    """0 where every stream kept the limits."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.codec.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=100_000, help="damaged streams")
    parser.add_argument("--start", type=int, default=0, help="number of the first stream")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-ms", type=float, default=2000.0, help="time that one stream may take")
    parser.add_argument("--limit-mb", type=float, default=16.0, help="memory beyond that of sound keyframes")
    options = parser.parse_args(arguments)
    with console.status("encoding sound keyframes") as status:
        reporter = Reporter(options.start + options.count, status)
        outcome = attack(options.count, options.seed, start=options.start, report=reporter)
    console.print(str(outcome), highlight=False, soft_wrap=True)
    return int(outcome.slowest_ms > options.limit_ms or outcome.memory_mb > options.limit_mb)


if __name__ == "__main__":
    sys.exit(main())
