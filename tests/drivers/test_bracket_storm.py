"""Random faults, permissions, losses and restarts: the latch moves only after both steps."""

from __future__ import annotations

import random

import pytest
from bracket_bench import WIRE, Bench

from drivers.bracket import Bracket
from simulation.bracket import NodeFaults
from simulation.latch import LatchFaults

STEPS = 400
CHANGES = 25
"""Steps between two changes of what goes wrong."""


def random_faults(rng: random.Random) -> NodeFaults:
    def some(chance: float) -> bool:
        return rng.random() < chance

    latch = LatchFaults(
        sticks_at=rng.random() if some(0.3) else None,
        closed_switch=some(0.5) if some(0.1) else None,
        open_switch=some(0.5) if some(0.1) else None,
        slowness=rng.choice([1.0, 1.0, 3.0, 10.0]),
        current_error_a=rng.choice([0.0, 0.0, -3.0, 9.0]),
    )
    return NodeFaults(
        latch,
        mute=some(0.1),
        deaf=some(0.1),
        no_sensors=some(0.1),
        frozen_counter=some(0.05),
        damaged=rng.choice([0.0, 0.0, 0.3]),
        lost=rng.choice([0.0, 0.0, 0.3]),
        no_jam_detection=some(0.3),
    )


class Storm:
    """One run; the seed decides everything."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.bench = Bench(step_s=self.rng.choice([0.02, 0.05, 0.1]), seed=seed)
        self.permissions: list[tuple[float, bool]] = []
        self.host_last_s = 0.0
        self.moved = 0

    def disturb(self) -> None:
        bench, rng = self.bench, self.rng
        bench.node.faults = random_faults(rng) if rng.random() < 0.6 else NodeFaults()
        bench.node.latch.faults = bench.node.faults.latch
        bench.host_runs = rng.random() < 0.9
        if rng.random() < 0.1:
            bench.host = Bracket(WIRE)
        if rng.random() < 0.05:
            bench.node.reboot()
        if rng.random() < 0.3:
            bench.node.latch.push_in()

    def step(self, permitted: bool, lock: bool) -> None:
        bench = self.bench
        before = bench.node.latch.position
        bench.tick(permitted and not lock, lock)
        self.permissions.append((bench.now_s, permitted and bench.host_runs))
        if bench.host_runs:
            self.host_last_s = bench.now_s
        if bench.node.latch.position > before:
            self.moved += 1
            self.check_motion()
        if bench.now_s - self.host_last_s > 0.5 + 2 * bench.step_s:
            assert not bench.node.energised

    def check_motion(self) -> None:
        """Both steps were sent, in order, within a second, while it was permitted."""
        fired = self.bench.sent("BracketFire")
        assert fired
        fired_s = fired[-1][0]
        arms = [stamp for stamp, _ in self.bench.sent("BracketArm") if stamp < fired_s]
        assert arms
        assert any(0.0 < stamp - arm < 1.0 for stamp, _ in fired for arm in arms)
        assert all((stamp, True) in self.permissions for stamp, _ in fired)


@pytest.mark.parametrize("seed", range(24))
def test_the_latch_moves_only_after_both_steps_and_never_for_a_lost_host(seed):
    storm = Storm(seed)
    permitted = False
    for n in range(STEPS):
        if n % CHANGES == 0:
            storm.disturb()
        if storm.rng.random() < 0.05:
            permitted = not permitted
        storm.step(permitted, lock=storm.rng.random() < 0.02)
    storm.bench.close()


def test_storms_do_open_the_latch_now_and_then():
    moved = 0
    for seed in range(8):
        storm = Storm(seed)
        for n in range(STEPS):
            if n % CHANGES == 0:
                storm.disturb()
            storm.step(permitted=True, lock=n % 50 == 0)
        moved += storm.moved > 0
        storm.bench.close()
    assert moved >= 3
