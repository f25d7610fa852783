"""Link cores over a channel that loses, repeats, delays, reorders and corrupts frames, with partitions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.sharing import KeyframeStore, LinkCore
from onboard.sharing.frames import pack, unpack
from onboard.sharing.messages import (
    Ack,
    Chunk,
    Digest,
    KeyframeMessage,
    Message,
    Propose,
    Release,
    SourceRanges,
    Status,
    Target,
    Times,
)

STEP_S = 0.1


def status(stamp_s: float = 0.0) -> Status:
    return Status(stamp_s, 1, (1.0, 2.0, 3.0), 0.5, None, 100.0, 0)


@dataclass
class Channel:
    """A bad radio between cores; `connected(a, b, now)` tells when two hear each other."""

    cores: dict[int, LinkCore]
    seed: int = 0
    loss: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    delay_s: float = 0.0
    connected: Callable[[int, int, float], bool] = lambda a, b, now: True
    now_s: float = 0.0
    sent: list[tuple[float, int, int, bytes]] = field(default_factory=list)
    taken: dict[int, list[tuple[int, int, bytes]]] = field(default_factory=dict)
    messages: dict[int, list[tuple[int, Message]]] = field(default_factory=dict)
    _air: list[tuple[float, int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            for robot, core in self.cores.items():
                self._step(robot, core)

    def _step(self, robot: int, core: LinkCore) -> None:
        arrived = [frame for due, to, frame in self._air if to == robot and due <= self.now_s]
        self._air = [entry for entry in self._air if not (entry[1] == robot and entry[0] <= self.now_s)]
        core.set_status(status(self.now_s))
        for target, frame in core.step(self.now_s, arrived):
            self.sent.append((self.now_s, robot, target, frame))
            if self.connected(robot, target, self.now_s):
                self._transmit(target, frame)
        self.taken.setdefault(robot, []).extend(core.take_keyframes())
        self.messages.setdefault(robot, []).extend(core.take_messages())

    def _transmit(self, target: int, frame: bytes) -> None:
        for _ in range(2 if self._rng.random() < self.duplicate else 1):
            if self._rng.random() < self.loss:
                continue
            if self._rng.random() < self.corrupt:
                place = int(self._rng.integers(len(frame)))
                frame = frame[:place] + bytes([frame[place] ^ 0x10]) + frame[place + 1 :]
            self._air.append((self.now_s + self._rng.random() * self.delay_s, target, frame))
        if self.delay_s:
            self._rng.shuffle(self._air)  # type: ignore[arg-type]


def team(*robots: int, sharing: bool = True) -> dict[int, LinkCore]:
    cores = {robot: LinkCore(robot, [r for r in robots if r != robot]) for robot in robots}
    for robot, core in cores.items():
        for other in robots:
            if sharing and other != robot:
                core.set_sharing(other, True)
    return cores


def fill(core: LinkCore, robot: int, count: int) -> list[tuple[int, int, bytes]]:
    payloads = [bytes([robot, k % 256, k // 256]) * 20 for k in range(count)]
    return [(robot, core.add_keyframe(float(k), payload), payload) for k, payload in enumerate(payloads)]


def kinds(frames: list[tuple[float, int, int, bytes]]) -> list[type]:
    return [type(unpack(frame).message) for *_, frame in frames]


@pytest.mark.parametrize("seed", range(3))
def test_two_robots_over_a_terrible_channel_share_everything_exactly_once(seed: int) -> None:
    cores = team(3, 9)
    channel = Channel(cores, seed, loss=0.5, duplicate=0.3, corrupt=0.05, delay_s=1.0)
    expected = {9: fill(cores[3], 3, 40), 3: fill(cores[9], 9, 25)}
    channel.run(180)
    for robot in cores:
        assert sorted(channel.taken[robot]) == sorted(expected[robot])
    assert cores[3].unshared(9) == cores[9].unshared(3) == 0
    assert cores[3].frames_bad > 0


def test_three_robots_relay_when_two_never_meet() -> None:
    cores = team(1, 2, 3)
    channel = Channel(
        cores, loss=0.2, duplicate=0.2, delay_s=0.5, connected=lambda a, b, now: {a, b} != {1, 3}
    )
    keyframes = {robot: fill(core, robot, 15) for robot, core in cores.items()}
    channel.run(90)
    for robot in cores:
        others = [k for other in cores if other != robot for k in keyframes[other]]
        assert sorted(channel.taken[robot]) == sorted(others)
    assert cores[2].unshared(1) == cores[2].unshared(3) == 0
    assert cores[1].unshared(3) == 15 + 15  # never acknowledged: they have not met; what 3 made, 3 has


def test_a_carrier_pigeon_joins_two_partitions() -> None:
    """Robot 2 is with 1 first and with 3 afterwards; 1 and 3 never meet."""
    cores = team(1, 2, 3)
    meets = {frozenset({1, 2}): (0.0, 30.0), frozenset({2, 3}): (40.0, 80.0)}

    def connected(a: int, b: int, now: float) -> bool:
        start, end = meets.get(frozenset({a, b}), (0.0, 0.0))
        return start <= now < end

    channel = Channel(cores, loss=0.3, connected=connected)
    keyframes = fill(cores[1], 1, 30)
    channel.run(80)
    assert sorted(channel.taken[3]) == keyframes


def test_out_of_contact_only_beacons_are_sent() -> None:
    cores = team(0, 1)
    fill(cores[0], 0, 20)
    cores[0].post(Ack(3), 1)
    channel = Channel(cores, connected=lambda a, b, now: False)
    channel.run(20)
    assert set(kinds(channel.sent)) == {Status}
    assert len(channel.sent) == 2 * 20
    assert not cores[0].in_contact(1, channel.now_s)


def test_partition_stops_the_traffic_and_healing_resumes_it() -> None:
    cores = team(0, 1)
    channel = Channel(cores, connected=lambda a, b, now: not 10 < now < 60)
    early = fill(cores[0], 0, 5)
    channel.run(10)
    assert channel.taken[1] == early
    late = [(0, cores[0].add_keyframe(0.0, b"late"), b"late") for _ in range(30)]
    channel.run(5)
    mark = len(channel.sent)
    channel.run(40)
    assert set(kinds(channel.sent[mark:])) == {Status}
    assert cores[0].unshared(1) == 30
    assert not cores[1].in_contact(0, channel.now_s)
    channel.run(15)
    assert channel.taken[1] == early + late
    assert cores[0].unshared(1) == 0
    assert cores[1].in_contact(0, channel.now_s)


def test_sharing_is_off_until_switched_on_and_respects_the_first_sequence() -> None:
    cores = team(0, 1, sharing=False)
    keyframes = fill(cores[0], 0, 30)
    channel = Channel(cores)
    channel.run(10)
    assert KeyframeMessage not in kinds(channel.sent)
    assert cores[0].unshared(1) == 30
    cores[0].set_sharing(1, True, first_sequence=20)
    assert cores[0].unshared(1) == 10
    channel.run(10)
    assert channel.taken[1] == keyframes[20:]
    assert cores[0].unshared(1) == 0
    cores[0].set_sharing(1, False, first_sequence=20)
    cores[0].add_keyframe(0.0, b"kept back")
    channel.run(10)
    assert cores[0].unshared(1) == 1
    assert len(channel.taken[1]) == 10


def test_window_bounds_what_is_unacknowledged_and_order_is_oldest_first() -> None:
    core = LinkCore(0, [1], window=4, resend_s=1.5)
    peer = LinkCore(1, [0])
    for k in range(10):
        core.add_keyframe(float(k), b"x")
    core.set_sharing(1, True)
    core.set_status(status())
    peer.set_status(status())
    hello = [frame for _, frame in peer.step(0.0, [frame for _, frame in core.step(0.0, [])])]
    sent = [unpack(f).message for _, f in core.step(0.1, hello)]
    first = [m.sequence for m in sent if isinstance(m, KeyframeMessage)]
    assert first == [0, 1, 2, 3]
    quiet = [unpack(f).message for _, f in core.step(0.5, [])]
    assert not [m for m in quiet if isinstance(m, KeyframeMessage)]
    again = [unpack(f).message for _, f in core.step(1.7, [])]
    assert [m.sequence for m in again if isinstance(m, KeyframeMessage)] == [0, 1, 2, 3]


def test_nothing_is_resent_over_a_good_link_and_digests_are_paced() -> None:
    cores = team(0, 1)
    fill(cores[0], 0, 100)
    channel = Channel(cores)
    channel.run(30)
    frames = [(now, sender, unpack(frame).message) for now, sender, _, frame in channel.sent]
    assert sum(isinstance(m, KeyframeMessage) for *_, m in frames) == 100
    times = [now for now, sender, m in frames if sender == 1 and isinstance(m, Digest)]
    assert min(b - a for a, b in pairwise(times)) >= 0.5 - 1e-6
    assert max(b - a for a, b in pairwise(times)) <= 5.0 + STEP_S


def test_small_messages_go_before_keyframes_and_the_newest_of_a_kind_wins() -> None:
    cores = team(0, 1)
    channel = Channel(cores)
    channel.run(5)
    fill(cores[0], 0, 5)
    cores[0].post(Propose(1, (0.0, 0.0, 0.0), 9.0), 1)
    cores[0].post(Release((1.0, 0.0, 0.0)), 1)
    cores[0].post(Propose(2, (0.0, 0.0, 0.0), 9.0), 1)
    mark = len(channel.sent)
    channel.run(STEP_S)
    order = [
        k
        for (_, sender, _, _), k in zip(channel.sent[mark:], kinds(channel.sent[mark:]), strict=True)
        if sender == 0
    ]
    assert [k for k in order if k is not Status and k is not Digest] == [Release, Propose] + [
        KeyframeMessage
    ] * 5
    channel.run(1)
    assert channel.messages[1] == [(0, Release((1.0, 0.0, 0.0))), (0, Propose(2, (0.0, 0.0, 0.0), 9.0))]


def test_all_chunks_of_one_step_go_out_and_an_unsent_one_is_replaced_by_its_like() -> None:
    cores = team(0, 1)
    channel = Channel(cores)
    channel.run(5)
    for index, payload in ((0, b"a"), (1, b"b"), (0, b"c")):
        cores[0].post(Chunk(1, 2, index, payload), 1)
    channel.run(1)
    assert channel.messages[1] == [(0, Chunk(1, 2, 1, b"b")), (0, Chunk(1, 2, 0, b"c"))]


def test_messages_wait_for_contact() -> None:
    cores = team(0, 1)
    channel = Channel(cores, connected=lambda a, b, now: now > 10)
    cores[0].post(Target((4.0, 5.0, 6.0)), 1)
    cores[0].post(Times(()), 1)
    channel.run(9)
    assert channel.messages[1] == []
    channel.run(4)
    assert channel.messages[1] == [(0, Target((4.0, 5.0, 6.0))), (0, Times(()))]


def test_a_peer_that_restarts_empty_gets_everything_again_also_its_own_past() -> None:
    cores = team(0, 1)
    channel = Channel(cores)
    mine, theirs = fill(cores[0], 0, 12), fill(cores[1], 1, 8)
    channel.run(15)
    cores[1] = LinkCore(1, [0])
    cores[1].set_sharing(0, True)
    channel.taken.clear()
    channel.run(20)
    assert sorted(channel.taken[1]) == sorted(mine + theirs)
    assert channel.taken[0] == []
    assert cores[1].add_keyframe(99.0, b"new") == 8
    channel.run(5)
    assert channel.taken[0] == [(1, 8, b"new")]


def test_a_restart_from_the_log_repeats_nothing(tmp_path: object) -> None:
    path = tmp_path / "log"  # type: ignore[operator]
    cores = team(0, 1)
    cores[1] = LinkCore(1, [0], store=KeyframeStore(path))
    fill(cores[0], 0, 12)
    channel = Channel(cores)
    channel.run(10)
    assert cores[1].add_keyframe(0.0, b"own") == 0
    cores[1].store.close()
    cores[1] = LinkCore(1, [0], store=KeyframeStore(path))
    channel.taken.clear()
    mark = len(channel.sent)
    channel.run(10)
    assert channel.taken[1] == []
    assert KeyframeMessage not in kinds(channel.sent[mark:])
    assert cores[1].add_keyframe(0.0, b"next") == 1


def test_an_overtaken_digest_does_not_undo_a_newer_one() -> None:
    core = LinkCore(0, [1])
    core.add_keyframe(0.0, b"x")
    held = (SourceRanges(0, ((0, 1),)),)

    core.step(1.0, [pack(Digest(100.0, held), 1, 0)])
    core.step(2.0, [pack(Digest(99.0, ()), 1, 0)])
    assert core.unshared(1) == 0
    core.step(3.0, [pack(Digest(5.0, ()), 1, 0)])  # a clock that far back: the peer restarted
    assert core.unshared(1) == 1


def test_foreign_frames_are_counted_and_never_acted_on() -> None:
    sender = LinkCore(1, [0, 2])
    sender.set_status(status())
    frames = dict(sender.step(0.0, []))
    receiver = LinkCore(0, [1])
    receiver.step(0.0, [frames[2]])
    assert receiver.frames_foreign == 1
    assert not receiver.in_contact(1, 0.0)
    LinkCore(0, [5]).step(0.0, [frames[0]])
    receiver.step(0.0, [frames[0], b"", b"rubbish" * 9])
    assert receiver.frames_bad == 2
    assert receiver.in_contact(1, 0.0)
    assert receiver.peer_status(1) == status()
    assert not receiver.in_contact(1, 3.1)


def test_byte_counters_agree_with_the_air() -> None:
    cores = team(0, 1)
    fill(cores[0], 0, 10)
    channel = Channel(cores)
    channel.run(10)
    total = sum(len(frame) for _, sender, _, frame in channel.sent if sender == 0)
    assert sum(cores[0].bytes_sent.values()) == total
    assert cores[0].bytes_sent["keyframe"] == cores[1].bytes_received["keyframe"] == 10 * (60 + 21)


def test_runs_are_deterministic() -> None:
    def record() -> list[tuple[float, int, int, bytes]]:
        cores = team(0, 1, 2)
        channel = Channel(cores, 7, loss=0.3, duplicate=0.2, delay_s=0.5)
        for robot, core in cores.items():
            fill(core, robot, 10)
        channel.run(20)
        return channel.sent

    assert record() == record()


def test_misuse_is_refused() -> None:
    with pytest.raises(InputError, match="peers"):
        LinkCore(1, [1, 2])
    with pytest.raises(InputError, match="peers"):
        LinkCore(1, [2, 2])
    core = LinkCore(0, [1])
    with pytest.raises(InputError, match="no peer"):
        core.post(Ack(1), 2)
    with pytest.raises(InputError, match="cannot be sent"):
        core.post(Ack(-1), 1)
    with pytest.raises(InputError, match="cannot be sent"):
        core.add_keyframe(0.0, bytes(70_000))
    assert core.unshared(1) == 0
