"""`marsupial explain`: the list of cycles, one cycle with its terms, JSON, the picture, and clear errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground_station.export import EventLog, write_json, write_ply


def candidate(
    kind: str, goal: list[float] | None, score: float, verdict: str, **terms: Any
) -> dict[str, Any]:
    return {"kind": kind, "goal": goal, "gain_m3": 12.5, "score": score, **terms, "verdict": verdict}


CYCLES: list[dict[str, Any]] = [
    {
        "cycle": 1,
        "reason": "best score",
        "counts": {"vertices": 40},
        "stages_ms": {"gain": 3.25},
        "candidates": [
            candidate("local", [4.0, 1.0, 1.5], 1.0, "lower score"),
            candidate("frontier", [2.0, 3.0, 4.9], 2.0, "no time to be back", novelty=0.75),
            candidate("local", [5.0, 2.0, 1.5], 1.5, "chosen", path=[[0, 0, 1.5], [5, 2, 1.5]]),
        ],
    },
    {"cycle": 2, "reason": "nothing worth its time within the budget", "candidates": []},
]


@pytest.fixture
def solo(tmp_path: Path) -> Path:
    """A run in which one robot planned twice."""
    with EventLog(tmp_path / "events.jsonl") as log:
        log.write(0.0, "start")
        for time_s, cycle in zip((2.0, 6.0), CYCLES, strict=True):
            log.write(time_s, "cycle", robot="aerial", **cycle)
    rows = [[0.0, 0.0, 0.0, 1.5], [2.0, 1.0, 0.5, 1.5], [6.0, 3.0, 1.0, 1.5]]
    write_json(tmp_path / "paths.json", {"aerial": rows})
    cloud = np.random.default_rng(1).integers(-20, 40, (800, 3)) * 0.2 + 0.1
    write_ply(tmp_path / "map.ply", cloud, np.zeros((800, 3), np.uint8))
    return tmp_path


@pytest.fixture
def both(solo: Path) -> Path:
    """The same with another robot that planned."""
    with EventLog(solo / "events.jsonl") as log:
        log.write(7.0, "cycle", robot="ground", **CYCLES[1])
    return solo


def words(text: str) -> str:
    return " ".join(text.split())


def test_without_a_cycle_there_is_a_list_of_them(cli: Any, solo: Path) -> None:
    text = words(cli.run("explain", solo).stdout)
    assert "2.0 aerial 1 local 5.0, 2.0, 1.5 3 best score" in text
    assert "6.0 aerial 2 - - 0 nothing worth its" in text


def test_a_cycle_shows_every_term_with_the_choice_on_top(cli: Any, solo: Path) -> None:
    lines = cli.run("explain", solo, "--cycle", "1").stdout.splitlines()
    rows = [words(line) for line in lines]
    head = next(index for index, row in enumerate(rows) if row.startswith("# kind"))
    assert rows[head] == "# kind goal gain_m3 score novelty verdict"
    assert rows[head + 1] == "1 local 5.0, 2.0, 1.5 12.5 1.5 - chosen"
    assert rows[head + 2] == "2 frontier 2.0, 3.0, 4.9 12.5 2 0.75 no time to be back"
    assert rows[head + 3] == "3 local 4.0, 1.0, 1.5 12.5 1 - lower score"
    assert "counts vertices 40" in rows
    assert "stages ms gain 3.25" in rows


@pytest.mark.parametrize(("time_s", "cycle"), [("2", 1), ("5.9", 1), ("6", 2), ("900", 2)])
def test_a_time_means_the_cycle_in_force(cli: Any, solo: Path, time_s: str, cycle: int) -> None:
    event = json.loads(cli.run("explain", solo, "--time", time_s, "--json").stdout)
    assert event["cycle"] == cycle


def test_json_has_everything_that_was_logged(cli: Any, solo: Path) -> None:
    events = json.loads(cli.run("explain", solo, "--json").stdout)
    assert [event["candidates"] for event in events] == [cycle["candidates"] for cycle in CYCLES]


def test_the_picture_is_written(cli: Any, solo: Path) -> None:
    picture = solo / "why.png"
    result = cli.run("explain", solo, "--cycle", "1", "--png", picture)
    assert result.exit_code == 0, result.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in result.stdout


def test_a_robot_has_to_be_named_where_several_planned(cli: Any, both: Path) -> None:
    assert "--robot (aerial, ground)" in cli.refuses("explain", both, "--cycle", "1")
    event = json.loads(cli.run("explain", both, "--robot", "ground", "--time", "9", "--json").stdout)
    assert (event["robot"], event["cycle"]) == ("ground", 2)
    assert len(json.loads(cli.run("explain", both, "--json").stdout)) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cycle", "7"], "--cycle 7: not in the log; it has 1 to 2"),
        (["--time", "1"], "--time 1: the first cycle was at 2 s"),
        (["--robot", "boat"], "--robot boat: planned nothing"),
        (["--cycle", "1", "--time", "3"], "exclude each other"),
        (["--png", "a.png"], "--png draws one cycle"),
        (["--cycle", "1", "--png", "a.jpg"], "end the name in .png"),
    ],
)
def test_wrong_questions_get_one_line(cli: Any, solo: Path, arguments: list[str], message: str) -> None:
    assert message in cli.refuses("explain", solo, *arguments)


def test_missing_runs_and_logs_get_one_line(cli: Any, tmp_path: Path) -> None:
    assert "no such run" in cli.refuses("explain", tmp_path / "nowhere")
    assert "events.jsonl" in cli.refuses("explain", tmp_path)
    with EventLog(tmp_path / "events.jsonl") as log:
        log.write(0.0, "start")
    assert "no planning cycles" in cli.refuses("explain", tmp_path)


def test_a_picture_without_the_map_names_the_file(cli: Any, solo: Path) -> None:
    (solo / "map.ply").unlink()
    assert "map.ply" in cli.refuses("explain", solo, "--cycle", "1", "--png", solo / "a.png")
    (solo / "paths.json").unlink()
    assert "paths.json" in cli.refuses("explain", solo, "--cycle", "1", "--png", solo / "a.png")
