"""Range, walls, latency, rate, loss and order of the simulated radio."""

import numpy as np
import pytest

from onboard.core.config import RadioSettings
from simulation.radio import Radio

A, B = np.zeros(3), np.array([10.0, 0.0, 0.0])
NEAR = {1: A, 2: B}
FAR = {1: A, 2: np.array([60.0, 0.0, 0.0])}


def radio(scene=None, seed=0, **changes):
    settings = RadioSettings.model_validate({"loss": 0.0, **changes})
    return Radio(settings, scene, np.random.default_rng(seed))


def test_a_frame_arrives_after_its_airtime_and_the_latency():
    link = radio(rate_bytes_s=1000.0, latency_s=0.02)
    link.send(1.0, 1, 2, b"x" * 100)
    assert link.deliver(1.05, NEAR) == []
    assert link.deliver(1.119, NEAR) == []
    assert link.deliver(1.121, NEAR) == [(1, 2, b"x" * 100)]
    assert link.deliver(2.0, NEAR) == []


def test_frames_of_one_direction_wait_for_each_other_and_keep_their_order():
    link = radio(rate_bytes_s=1000.0, latency_s=0.0)
    frames = [bytes([number]) * 100 for number in range(5)]
    for frame in frames:
        link.send(0.0, 1, 2, frame)
    arrivals = {}
    for tick in range(1, 61):
        for _, _, frame in link.deliver(0.01 * tick, NEAR):
            arrivals[frame] = 0.01 * tick
    assert list(arrivals) == frames
    assert list(arrivals.values()) == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5], abs=0.011)


def test_the_two_directions_do_not_share_airtime():
    link = radio(rate_bytes_s=1000.0, latency_s=0.0)
    link.send(0.0, 1, 2, b"a" * 100)
    link.send(0.0, 2, 1, b"b" * 100)
    assert link.deliver(0.11, NEAR) == [(1, 2, b"a" * 100), (2, 1, b"b" * 100)]


def test_throughput_is_the_rate():
    link = radio(rate_bytes_s=10_000.0, latency_s=0.02)
    received = 0
    for tick in range(1000):
        link.send(0.01 * tick, 1, 2, b"x" * 200)  # 20 kB/s offered
        received += sum(len(frame) for _, _, frame in link.deliver(0.01 * tick, NEAR))
    assert received == pytest.approx(100_000, rel=0.03)
    assert link.counters[1, 2].bytes_offered == 200_000
    assert link.counters[1, 2].bytes_delivered == received


def test_the_queue_holds_two_seconds_and_refuses_the_newest():
    link = radio(rate_bytes_s=1000.0, latency_s=0.0)
    frames = [bytes([number]) * 100 for number in range(30)]
    for frame in frames:
        link.send(0.0, 1, 2, frame)
    arrived = [frame for tick in range(60) for _, _, frame in link.deliver(0.1 * tick, NEAR)]
    assert arrived == frames[:21]
    assert link.counters[1, 2].frames_refused == 9
    assert link.counters[1, 2].frames_lost == 0


def test_out_of_range_frames_are_lost_when_they_are_sent():
    link = radio()
    link.send(0.0, 1, 2, b"gone")
    assert link.deliver(0.1, FAR) == []
    assert link.deliver(0.2, NEAR) == []
    assert link.counters[1, 2].frames_lost == 1
    link.send(0.3, 1, 2, b"here")
    assert link.deliver(0.4, NEAR) == [(1, 2, b"here")]


def test_a_frame_to_an_unknown_robot_is_lost():
    link = radio()
    link.send(0.0, 1, 9, b"x")
    assert link.deliver(1.0, NEAR) == []
    assert link.counters[1, 9].frames_lost == 1


def test_losses_have_the_configured_share():
    link = radio(loss=0.2, rate_bytes_s=1e6)
    delivered = 0
    for tick in range(4000):
        link.send(0.01 * tick, 1, 2, b"x" * 10)
        delivered += len(link.deliver(0.01 * tick, NEAR))
    lost = link.counters[1, 2].frames_lost
    assert lost / 4000 == pytest.approx(0.2, abs=0.02)
    assert delivered + lost == pytest.approx(4000, abs=5)  # the last ones are still in the air


def test_the_same_seed_loses_the_same_frames():
    def run(seed):
        link = radio(loss=0.5, seed=seed)
        for number in range(200):
            link.send(0.01 * number, 1 + number % 2, 2 - number % 2, bytes([number]))
        return [item for tick in range(300) for item in link.deliver(0.01 * tick, NEAR)]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_arrivals_of_all_links_come_in_order_of_time():
    link = radio(rate_bytes_s=1000.0, latency_s=0.0)
    link.send(0.0, 1, 2, b"x" * 300)
    link.send(0.0, 2, 1, b"y" * 100)
    link.send(0.0, 2, 1, b"z" * 100)
    assert link.deliver(0.0, NEAR) == []
    link.deliver(0.1, NEAR)
    assert [frame[:1] for _, _, frame in link.deliver(1.0, NEAR)] == [b"z", b"x"]


def test_range_without_walls():
    link = radio(range_m=50.0)
    assert link.in_range(A, np.array([49.9, 0.0, 0.0]))
    assert not link.in_range(A, np.array([50.1, 0.0, 0.0]))


def test_walls_shorten_the_range(scene_of):
    walls = [(x, -50.0, -50.0, x + 0.2, 50.0, 50.0) for x in (2.0, 4.0, 6.0)]
    link = radio(scene_of(walls), range_m=50.0, wall_loss_db=5.0)
    for count, first in ((0, 6.5), (1, 5.0), (2, 3.0), (3, 1.0)):
        start = np.array([first, 0.0, 0.0])
        reach = 50.0 * 10 ** (-count * 5.0 / 22.0)
        assert link.in_range(start, start + np.array([reach - 0.01, 0.0, 0.0]))
        assert not link.in_range(start, start + np.array([reach + 0.01, 0.0, 0.0]))
        assert link.in_range(start + np.array([reach - 0.01, 0.0, 0.0]), start)


def test_walls_do_not_matter_without_wall_loss(scene_of):
    scene = scene_of([(2.0, -50.0, -50.0, 2.2, 50.0, 50.0)])
    assert radio(scene, range_m=50.0).in_range(A, np.array([49.0, 0.0, 0.0]))
