"""The record of a planning cycle."""

from __future__ import annotations

import json

import numpy as np

from onboard.planning.cycle import CHOSEN, TOO_LATE, Candidate, Cycle
from onboard.planning.plan import NOTHING, Plan


def test_a_cycle_becomes_plain_data_with_its_reasons():
    path = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]])
    taken = Candidate(Plan(path, "local", 12.345, 1.23456, 4.56), CHOSEN, {"turn": 0.12345})
    late = Candidate(NOTHING, TOO_LATE)
    cycle = Cycle(7, "best score", {"vertices": 120}, {"graph": 3.14159}, [taken, late], taken.plan)
    data = json.loads(json.dumps(cycle.described()))
    assert data["cycle"] == 7
    assert data["counts"] == {"vertices": 120}
    assert data["stages_ms"] == {"graph": 3.14}
    first, second = data["candidates"]
    assert first == {
        "kind": "local",
        "goal": [1.0, 2.0, 0.5],
        "gain_m3": 12.35,
        "travel_s": 4.6,
        "score": 1.235,
        "turn": 0.123,
        "verdict": "chosen",
    }
    assert second["goal"] is None
    assert second["verdict"] == "no time to be back"
