"""`simulate` end to end on a small room: files, metrics, determinism, ctrl-C."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.core.errors import ConfigError, InputError
from simulation.run import Progress, select_team, simulate
from tests.simulation.small_mission import EAGER, room, team

TOP = {
    "world",
    "seed",
    "duration_s",
    "wall_s",
    "robots",
    "deployed",
    "deploy_t_s",
    "target",
    "regroup",
    "union_m3",
    "reachable_m3",
    "coverage",
    "merged",
    "complete",
}
ROBOT = {
    "explored_m3",
    "path_m",
    "collisions",
    "min_clearance_m",
    "keyframes",
    "keyframe_bytes",
    "bytes_sent",
    "bytes_received",
    "plans",
    "plan_ms_p50",
    "plan_ms_p99",
    "map_ms_p50",
    "home",
    "home_t_s",
    "pose_error_m",
    "worst_pose_error_m",
}
MERGED = {"occ_f1", "occ_precision", "occ_recall", "free_iou", "unsafe26"}
FILES = {"metrics.json", "map.ply", "events.jsonl", "report.html"}
CONFIG = team(mission={"duration_s": 40.0}, deployment=EAGER)
ROOM_M3 = 12 * 8 * 3 - 0.2 * 5.6 * 3


def timeless(metrics: dict[str, Any]) -> dict[str, Any]:
    """The metrics without what a clock measured."""
    robots = {
        name: {key: value for key, value in robot.items() if "_ms_" not in key}
        for name, robot in metrics["robots"].items()
    }
    return {key: value for key, value in metrics.items() if key != "wall_s"} | {"robots": robots}


def events_of(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]


def map_points(out: Path) -> int:
    """Number of points of map.ply; its size must agree with its header."""
    header, body = (out / "map.ply").read_bytes().split(b"end_header\n", 1)
    count = int(next(line for line in header.splitlines() if line.startswith(b"element vertex")).split()[-1])
    assert len(body) == 15 * count
    return count


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], list[Progress]]:
    out = tmp_path_factory.mktemp("run")
    seen: list[Progress] = []
    return out, simulate(CONFIG, room(), 3, out, progress=seen.append, octomap=True), seen


def test_all_files_are_there_and_readable(finished):
    out, metrics, _ = finished
    assert {path.name for path in out.iterdir()} >= FILES
    assert json.loads((out / "metrics.json").read_text()) == json.loads(json.dumps(metrics))
    assert map_points(out) > 3_000
    assert (out / "map.bt").read_bytes().startswith(b"# Octomap OcTree binary file\n")
    report = (out / "report.html").read_text()
    assert report.lstrip().lower().startswith("<!doctype html")
    assert "room, seed 3" in report


def test_metrics_have_exactly_the_documented_keys(finished):
    _, metrics, _ = finished
    assert set(metrics) == TOP
    assert set(metrics["merged"]) == MERGED
    assert set(metrics["robots"]) == {"ground", "aerial"}
    assert all(set(robot) == ROBOT for robot in metrics["robots"].values())


def test_the_numbers_fit_the_room(finished):
    _, metrics, _ = finished
    assert (metrics["world"], metrics["seed"]) == ("room", 3)
    assert metrics["duration_s"] <= 40.0
    assert metrics["reachable_m3"] == pytest.approx(ROOM_M3, rel=0.15)
    assert 0.5 < metrics["coverage"] <= 1.0
    volumes = [robot["explored_m3"] for robot in metrics["robots"].values()]
    assert max(volumes) <= metrics["union_m3"] <= sum(volumes)
    assert metrics["union_m3"] < 1.4 * ROOM_M3  # free space and the walls around it
    assert all(0 <= value <= 1 for value in metrics["merged"].values())
    assert metrics["merged"]["occ_f1"] > 0.7
    assert metrics["merged"]["unsafe26"] < 0.01


def test_the_robots_numbers_fit_each_other(finished):
    _, metrics, _ = finished
    ground, aerial = metrics["robots"]["ground"], metrics["robots"]["aerial"]
    assert ground["collisions"] == aerial["collisions"] == 0
    assert 0 < ground["path_m"] <= 0.7 * metrics["duration_s"]
    assert 0 < aerial["path_m"] <= 1.0 * metrics["duration_s"]
    for robot in (ground, aerial):
        assert 0 < robot["keyframes"] <= robot["keyframe_bytes"] <= robot["bytes_sent"]
        assert 0 < robot["plan_ms_p50"] <= robot["plan_ms_p99"]
        assert 0 < robot["pose_error_m"] <= robot["worst_pose_error_m"] < 0.1
        assert robot["map_ms_p50"] > 0
        assert robot["plans"] > 0
        assert robot["home"] is (robot["home_t_s"] is not None)
    assert ground["bytes_received"] <= aerial["bytes_sent"]


def test_events_tell_the_story_in_order(finished):
    out, metrics, _ = finished
    events = events_of(out)
    times = [event["time_s"] for event in events]
    assert times == sorted(times)
    assert events[-1] == {"time_s": times[-1], "kind": "end", "complete": metrics["complete"]}
    deploy = next(event for event in events if event["kind"] == "deploy")
    assert metrics["deployed"] is True
    assert deploy["time_s"] == metrics["deploy_t_s"]
    assert deploy["target"] == pytest.approx(metrics["target"], abs=0.01)
    assert len(metrics["regroup"]) == 3
    finals = {event["robot"]: event["phase"] for event in events if event["kind"] == "phase"}
    assert metrics["complete"] is (set(finals.values()) == {"done"})


def test_progress_goes_on_and_ends_with_the_result(finished):
    _, metrics, seen = finished
    times = [progress.time_s for progress in seen]
    assert times == sorted(times)
    assert times[0] == 0.0
    assert max(b - a for a, b in pairwise(times)) < 5.5
    assert seen[0].phase == "carrying/carried"
    assert all(progress.duration_s == 40.0 for progress in seen)
    unions = [progress.union_m3 for progress in seen]
    assert (np.diff(unions) >= 0).all()
    assert unions[-1] == pytest.approx(metrics["union_m3"], abs=0.01)


def test_the_same_seed_gives_the_same_results(finished, tmp_path):
    out, metrics, _ = finished
    again = simulate(CONFIG, room(), 3, tmp_path)
    assert timeless(again) == timeless(metrics)
    for name in ("events.jsonl", "map.ply"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()


def test_a_ground_robot_alone(tmp_path):
    metrics = simulate(team(mission={"duration_s": 15.0}), room(), 1, tmp_path, team="ground")
    assert set(metrics) == TOP
    assert set(metrics["robots"]) == {"ground"}
    assert metrics["deployed"] is False
    assert metrics["deploy_t_s"] is metrics["target"] is None
    assert metrics["robots"]["ground"]["explored_m3"] == metrics["union_m3"] > 100
    assert metrics["complete"] is (metrics["robots"]["ground"]["home"])


def test_an_aerial_robot_alone_takes_off_and_comes_back(tmp_path):
    metrics = simulate(team(mission={"duration_s": 90.0}), room(), 1, tmp_path, team="aerial")
    assert set(metrics) == TOP
    aerial = metrics["robots"]["aerial"]
    assert metrics["deployed"] is False
    assert (aerial["collisions"], aerial["home"], metrics["complete"]) == (0, True, True)
    assert aerial["explored_m3"] == metrics["union_m3"] > 0.8 * ROOM_M3
    assert metrics["regroup"] == pytest.approx([-3.0, 0.0, 1.4], abs=0.01)
    phases = [event["phase"] for event in events_of(tmp_path) if event["kind"] == "phase"]
    assert phases == ["exploring", "returning", "waiting", "landing", "done"]


def test_ctrl_c_leaves_what_there_is_and_goes_on(tmp_path):
    def interrupt(progress: Progress) -> None:
        if progress.time_s >= 5.0 and not interrupted:
            interrupted.append(progress.time_s)
            raise KeyboardInterrupt

    interrupted: list[float] = []
    with pytest.raises(KeyboardInterrupt):
        simulate(CONFIG, room(), 3, tmp_path, progress=interrupt)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert set(metrics) == TOP
    assert metrics["complete"] is False
    assert metrics["duration_s"] == pytest.approx(interrupted[0], abs=0.2)
    assert map_points(tmp_path) > 1_000
    assert events_of(tmp_path)[-1]["kind"] == "end"
    assert (tmp_path / "report.html").read_text().rstrip().endswith("</html>")


def test_a_team_that_is_not_in_the_configuration_is_refused():
    config = CONFIG.model_copy(update={"robots": CONFIG.robots[1:]})
    with pytest.raises(ConfigError, match="a mission needs a ground robot"):
        select_team(config, "ground")
    with pytest.raises(ConfigError, match="no aerial robot"):
        select_team(CONFIG.model_copy(update={"robots": CONFIG.robots[:1]}), "aerial")


@pytest.mark.parametrize("start", [(20.0, 0.0, 0.0), (-3.0, 0.0, 9.0)])
def test_a_start_without_ground_or_space_is_refused_before_anything_runs(tmp_path, start):
    world = replace(room(), start=np.array(start))
    with pytest.raises(InputError, match="start"):
        simulate(CONFIG, world, 1, tmp_path)
    assert not (tmp_path / "metrics.json").exists()
