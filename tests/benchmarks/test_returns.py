"""The benchmark of returns: its trials, its verdicts, and the corridor that it closes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import returns
from benchmarks.closing import THICKNESS_M, WIDTH_M, wall
from benchmarks.returns import HELD, HOME, LATE, Trial
from simulation.scene import Scene


def result(*outcomes: str) -> dict:
    robots = {
        f"robot{index}": {"outcome": outcome, "arrived_s": None, "away_m": 1.0}
        for index, outcome in enumerate(outcomes)
    }
    return {"sources": "abc", "trial": vars(Trial.of(1)), "robots": robots}


def test_a_trial_follows_from_its_number_and_the_share_of_closed_ones_is_right():
    trials = [Trial.of(number) for number in range(300)]
    assert trials == [Trial.of(number) for number in range(300)]
    assert {trial.world for trial in trials} == set(returns.WORLDS)
    assert all(60 <= trial.duration_s <= 120 and 0 <= trial.loss <= 0.5 for trial in trials)
    assert 0.3 < np.mean([trial.blocked for trial in trials]) < 0.5


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [((HOME, HOME), HOME), ((HOME, HELD), HELD), ((LATE, HOME), LATE), ((HELD, LATE), LATE), ((), HOME)],
)
def test_the_worst_robot_decides(outcomes, expected):
    assert returns.verdict(result(*outcomes)) == expected


def test_late_and_missing_trials_are_failures_held_ones_are_not(capsys):
    assert returns.summary([result(HOME), result(HELD), result(LATE), None]) == 2
    assert "1: " in capsys.readouterr().out


def test_finished_trials_are_used_again_unless_the_sources_changed(tmp_path, monkeypatch):
    flown = []

    def fly(number, out):
        flown.append(number)
        returns.path_of(out, number).write_text(json.dumps(result(HOME)))
        return 0

    monkeypatch.setattr(returns, "fly_apart", fly)
    monkeypatch.setattr(returns, "source_digest", lambda: "abc")
    assert returns.run_all(range(3), tmp_path, 1) == 0
    assert returns.run_all(range(4), tmp_path, 1) == 0
    assert flown == [0, 1, 2, 3]
    monkeypatch.setattr(returns, "source_digest", lambda: "other")
    assert returns.finished(tmp_path, 0, "other") is None


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0])
def test_the_wall_stands_across_the_way_and_only_there(heading):
    floor = np.array([(-50, -50, -5), (50, -50, -5), (50, 50, -5)], np.float32)
    scene = Scene(floor, np.array([(0, 1, 2)], np.int32))
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    across = np.array([-ahead[1], ahead[0], 0.0])
    centre = np.array([3.0, 1.0, 0.5])
    origins = np.stack(
        [centre - 2 * ahead + offset * across for offset in (0, 0.45 * WIDTH_M, 0.55 * WIDTH_M)]
    )
    rays = np.repeat(ahead[None], 3, axis=0)
    assert np.isinf(scene.cast(origins, rays)).all()
    scene.add(*wall(centre, heading))
    hits = scene.cast(origins, rays)
    assert hits[:2] == pytest.approx(2 - THICKNESS_M / 2, abs=1e-4)
    assert np.isinf(hits[2])
    assert scene.distance(centre[None] - 2 * ahead)[0] == pytest.approx(2 - THICKNESS_M / 2, abs=1e-4)
