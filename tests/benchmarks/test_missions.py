"""The results table: which missions run, what is kept, what is written where."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import matrix, missions, tables
from benchmarks.matrix import Mission, Settings
from benchmarks.picture import draw_comparison, observers
from benchmarks.recordings import find_recordings
from ground_station.export import EventLog, read_ply, write_json, write_ply
from ground_station.palette import observer_colours
from onboard.core.errors import InputError


def robot(**changes: Any) -> dict[str, Any]:
    values = {"collisions": 0, "keyframes": 12, "bytes_sent": 2500, "home_t_s": 580.4, "plan_ms_p50": 3.0}
    return values | {"worst_pose_error_m": 0.034} | changes


def metrics(team: str = "both", **changes: Any) -> dict[str, Any]:
    robots = {"ground": robot(), "aerial": robot()} if team == "both" else {"ground": robot()}
    values: dict[str, Any] = {
        "robots": robots,
        "duration_s": 55.0,
        "deploy_t_s": 42.2 if team == "both" else None,
        "union_m3": 2000.0 if team == "both" else 1000.0,
        "coverage": 0.8125,
        "merged": {"occ_f1": 0.991, "unsafe26": 0.00125},
        "complete": True,
        "wall_s": 100.4,
    }
    return values | changes


@dataclass
class FakeRunner:
    """Leaves behind what `marsupial` would, at once."""

    calls: list[list[str]] = field(default_factory=list)
    changes: dict[str, Any] = field(default_factory=dict)
    fails: str | None = None
    wall_s: float = 100.4

    def __call__(self, arguments: Sequence[str], log: Path) -> int:
        self.calls.append(list(arguments))
        if self.fails is not None and self.fails in str(log):
            log.write_text("noise\nerror: no floor\n\n")
            return 2
        out = log.parent
        if arguments[0] == "map":
            write_json(out / "metrics.json", recording_metrics())
            return 0
        option = dict(zip(arguments[1::2], arguments[2::2], strict=False))
        write_json(out / "config.json", {"mission": {"duration_s": float(option["--duration"])}})
        write_json(out / "metrics.json", metrics(option["--team"], wall_s=self.wall_s, **self.changes))
        volume = metrics(option["--team"], **self.changes)["union_m3"]
        series = {"time_s": [0.0, 50.0, 5000.0], "explored_m3/union": [0.0, volume, 10 * volume]}
        write_json(out / "timeline.json", series)
        (out / "events.jsonl").write_text("{}\n")
        (out / "map.ply").write_bytes(b"map")
        return 0


def recording_metrics() -> dict[str, Any]:
    return {
        "sensor": "Velodyne VLP-16",
        "scans": 20,
        "lost_scans": 1,
        "path_m": 3.21,
        "keyframes": 2,
        "keyframe_bytes": 7000,
        "keyframe_map": {"occ_f1": 0.985},
    }


@dataclass
class Bench:
    """A folder to work in and the command line with a made-up runner."""

    path: Path
    runner: FakeRunner = field(default_factory=FakeRunner)

    @property
    def table(self) -> Path:
        return self.path / "docs" / "results.md"

    def main(self, *more: str) -> int:
        files = ["--table", str(self.table), "--readme", str(self.path / "README.md")]
        folders = ["--out", str(self.path / "runs"), "--data", str(self.path / "worlds")]
        return missions.main([*files, *folders, *more], self.runner)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_matrix_has_every_world_seed_and_team(tmp_path: Path) -> None:
    names = [mission.name for mission in matrix.all_missions(tmp_path)]
    assert len(names) == len(set(names)) == 3 * 3 * 2 + 3 * 2
    assert names[:3] == ["building-1-both", "building-1-ground", "building-2-both"]
    assert names[-1] == "darpa_cave_02-1-ground"


def test_arguments_name_the_mesh_file_and_the_team(tmp_path: Path) -> None:
    mission = Mission("hall", 1, "ground", tmp_path / "hall" / "world.ply")
    arguments = mission.arguments(tmp_path / "out", 60.0)
    assert arguments[:3] == ["simulate", "--world", str(tmp_path / "hall" / "world.ply")]
    assert arguments[-6:] == ["--team", "ground", "--out", str(tmp_path / "out"), "--json", "--force"]


@pytest.mark.parametrize(
    ("only", "expected"),
    [([], True), (["cave"], True), (["cave-2"], True), (["cave-2-ground"], False), (["cav"], False)],
)
def test_only_selects_by_world_seed_or_full_name(only: list[str], expected: bool) -> None:
    assert Mission("cave", 2, "both").matches(only) is expected


def test_table_is_written_for_the_missions_that_ran(bench: Bench) -> None:
    assert bench.main("--only", "building-1", "cave-2-both", "--duration", "60") == 0
    text = bench.table.read_text()
    assert "| building | 1 | 42 | 2000 | 1000 | 1000 | 2.00 | 0.812 | 0.991 | 0.00125 | " in text
    assert " | 0.00125 | 0.03/0.03 | 0/0 | " in text
    assert "cave 2: no result (ground alone)" in text
    assert "mine" not in text
    assert "Missions of 60 s, run 2 at a time" in text
    assert len(bench.runner.calls) == 3


def test_current_runs_are_kept(bench: Bench) -> None:
    bench.main("--only", "mine-1", "--duration", "60")
    bench.main("--only", "mine-1", "--duration", "60")
    assert len(bench.runner.calls) == 2


def test_other_duration_runs_again(bench: Bench) -> None:
    bench.main("--only", "mine-1-both", "--duration", "60")
    bench.main("--only", "mine-1-both", "--duration", "61")
    assert len(bench.runner.calls) == 2


def test_other_sources_run_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.main("--only", "mine-1-both", "--duration", "60")
    monkeypatch.setattr(matrix, "source_digest", lambda: "other")
    bench.main("--only", "mine-1-both", "--duration", "60")
    assert len(bench.runner.calls) == 2


def test_table_tells_when_rows_come_from_different_sources(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.main("--only", "mine-1", "--duration", "60")
    assert "different states" not in bench.table.read_text()
    monkeypatch.setattr(matrix, "source_digest", lambda: "other")
    bench.main("--only", "mine-2", "--duration", "60")
    assert "different states" in bench.table.read_text()


def test_interrupted_run_does_not_count(tmp_path: Path) -> None:
    settings = Settings(tmp_path, 60.0)
    mission = Mission("mine", 1, "both")
    matrix.run_one(mission, settings, FakeRunner())
    assert matrix.is_current(tmp_path / mission.name, 60.0)

    def interrupted(arguments: Sequence[str], log: Path) -> int:
        FakeRunner()(arguments, log)
        return 130

    assert matrix.run_one(mission, settings, interrupted) == 130
    assert matrix.load(tmp_path / mission.name, 60.0) is None


def test_failed_mission_is_reported_and_the_others_go_on(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.runner.fails = "mine-1-both"
    assert bench.main("--only", "mine-1", "--duration", "60") == 1
    assert "error: no floor" in capsys.readouterr().out
    assert "mine 1: no result (team)" in bench.table.read_text()


def test_absent_mesh_worlds_are_skipped_with_a_note(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    world = bench.path / "worlds" / "darpa_cave_02" / "world.ply"
    world.parent.mkdir(parents=True)
    world.touch()
    assert bench.main("--only", "darpa_cave_02", "pittsburgh_mine_plan", "--duration", "60") == 0
    assert "skipped pittsburgh_mine_plan-1-both" in " ".join(capsys.readouterr().out.split())
    assert {call[2] for call in bench.runner.calls} == {str(world)}


def test_source_digest_sees_sources_only(tmp_path: Path) -> None:
    (tmp_path / "onboard").mkdir()
    (tmp_path / "docs").mkdir()
    code = tmp_path / "onboard" / "a.py"
    code.write_text("a = 1\n")
    before = matrix.source_digest(tmp_path)
    (tmp_path / "docs" / "a.py").write_text("x\n")
    assert matrix.source_digest(tmp_path) == before
    code.write_text("a = 2\n")
    assert matrix.source_digest(tmp_path) != before


def test_runner_starts_the_command_line_of_this_tree(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    assert matrix.run_marsupial(["simulate", "--world", "nowhere", "--out", str(tmp_path / "x")], log) == 2
    assert "unknown world 'nowhere'" in matrix.last_line(log)


@pytest.mark.parametrize(
    ("both", "alone", "expected"),
    [
        ({}, {}, []),
        ({"union_m3": 1290.0}, {}, ["ratio 1.29"]),
        ({"merged": {"occ_f1": 0.9694, "unsafe26": 0.0}}, {}, ["F1 0.969"]),
        ({"complete": False}, {}, ["incomplete (team)"]),
        ({}, {"wall_s": 240.6}, ["wall 241 s (ground alone)"]),
        ({"robots": {"aerial": robot(collisions=2)}}, {}, ["2 collisions (team)"]),
    ],
)
def test_shortfalls(both: dict[str, Any], alone: dict[str, Any], expected: list[str]) -> None:
    pair = tables.Pair("cave", 1, metrics(**both), metrics("ground", **alone))
    assert tables.shortfalls(pair) == expected
    line = tables.verdict([pair])
    assert line.endswith(f": cave 1: {expected[0]}." if expected else ": none.")


def test_row_of_a_mission_without_deployment_has_dashes() -> None:
    run = metrics(deploy_t_s=None, robots={"ground": robot(home_t_s=None), "aerial": robot(home_t_s=None)})
    row = dict(zip(tables.COLUMNS, tables.mission_row(tables.Pair("cave", 1, run, None)), strict=True))
    assert row["deployed at s"] == row["ground alone m³"] == row["ratio"] == "-"
    assert row["home at s (g/a)"] == "-/-"


def test_row_without_team_run_has_all_columns() -> None:
    row = tables.mission_row(tables.Pair("cave", 1, None, metrics("ground")))
    assert len(row) == len(tables.COLUMNS)
    assert row[4] == "1000"


def test_headline_averages_over_seeds() -> None:
    pairs = [
        tables.Pair("cave", 1, metrics(union_m3=1000.0), metrics("ground", union_m3=500.0)),
        tables.Pair("cave", 2, metrics(union_m3=2000.0, complete=False), metrics("ground", union_m3=700.0)),
        tables.Pair("mine", 1, metrics(), None),
    ]
    rows = tables.headline_table(pairs).splitlines()[2:]
    assert rows == ["| cave | 2 | 1500 | 600 | 2.50 | 0.991 | 5 | 0 | 1 of 2 |"]


def test_text_outside_the_markers_is_kept(bench: Bench) -> None:
    bench.table.parent.mkdir(parents=True)
    bench.table.write_text("before\n<!-- missions:begin -->\nold\n<!-- missions:end -->\nafter\n")
    bench.main("--only", "mine-1", "--duration", "60")
    text = bench.table.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text


def test_missing_markers_are_an_error() -> None:
    with pytest.raises(ValueError, match="missions:begin"):
        tables.replace_between("nothing here", "missions", "x")


def test_readme_gets_its_headline_only_between_its_markers(bench: Bench) -> None:
    readme = bench.path / "README.md"
    readme.write_text("# Title\n<!-- headline:begin -->\n<!-- headline:end -->\nrest\n")
    bench.main("--only", "mine-1", "--duration", "60")
    assert "| mine | 1 | 2000 | 1000 | 2.00 |" in readme.read_text()
    assert readme.read_text().endswith("\nrest\n")


def test_readme_without_markers_stays_as_it_is(bench: Bench) -> None:
    readme = bench.path / "README.md"
    readme.write_text("# Title\n")
    bench.main("--only", "mine-1", "--duration", "60")
    assert readme.read_text() == "# Title\n"


def test_determinism_ignores_clocks_and_sees_everything_else(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench.main("--determinism", "--duration", "60") == 0
    assert "identical" in capsys.readouterr().out
    bench.runner.wall_s = 7.0
    assert bench.main("--determinism", "--duration", "60") == 0
    bench.runner.changes = {"coverage": 0.5}
    assert bench.main("--determinism", "--duration", "60") == 1
    assert "coverage: 0.8125 / 0.5" in capsys.readouterr().out
    assert len(bench.runner.calls) == 4  # the first run is current after the first time


def test_recordings_table_lists_what_was_read_and_what_was_refused(bench: Bench) -> None:
    data = bench.path / "lidar"
    for name in ("mrpt_velodyne/test_velodyne_VLP16.rawlog", "ouster_sdk_tests/pcaps/bad.pcap"):
        (data / name).parent.mkdir(parents=True)
        (data / name).touch()
    bench.runner.fails = "recording-bad"
    assert bench.main("--recordings", str(data)) == 0
    text = bench.table.read_text()
    assert (
        "| test_velodyne_VLP16.rawlog | Velodyne VLP-16 | 20 (1) | 3.21 | 2 | 7000 | 3500 | 0.985 |" in text
    )
    assert "- `bad.pcap`: exit 2: error: no floor" in text


def test_recordings_are_found_in_a_fixed_order(tmp_path: Path) -> None:
    for name in ("osfs/b.osf", "pcaps/a.pcap", "pcaps/a.json"):
        path = tmp_path / "ouster_sdk_tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert [path.name for path in find_recordings(tmp_path)] == ["a.pcap", "b.osf"]


def make_run(directory: Path, robots: list[str]) -> None:
    directory.mkdir(parents=True)
    cloud = np.random.default_rng(1).integers(0, 60, (500, 3)) * 0.2 + 0.1
    seen = np.random.default_rng(2).integers(0, 1 << len(robots), len(cloud)).astype(np.uint8)
    write_ply(directory / "map.ply", cloud, observer_colours(seen, len(robots)))
    write_json(directory / "metrics.json", {"robots": dict.fromkeys(robots), "union_m3": 9.0, "complete": 1})
    write_json(directory / "timeline.json", {"time_s": [0.0, 5.0], "explored_m3/union": [0.0, 9.0]})
    write_json(directory / "paths.json", {name: [[0, 1, 1, 0], [5, 9, 4, 0]] for name in robots})
    with EventLog(directory / "events.jsonl") as events:
        events.write(2.0, "deploy", position=[1, 1, 0])


def test_picture_shows_both_runs(bench: Bench) -> None:
    make_run(bench.path / "runs" / "building-1-both", ["ground", "aerial"])
    make_run(bench.path / "runs" / "building-1-ground", ["ground"])
    picture = bench.path / "docs" / "team.png"
    assert bench.main("--picture", str(picture)) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_picture_of_a_missing_run_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"metrics\.json"):
        draw_comparison(tmp_path / "a", tmp_path / "b", tmp_path / "c.png")


def test_map_file_gives_back_who_saw_what(tmp_path: Path) -> None:
    seen = np.array([0, 1, 2, 3], dtype=np.uint8)
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    write_ply(tmp_path / "map.ply", points, observer_colours(seen, 2))
    read, colours = read_ply(tmp_path / "map.ply")
    assert np.array_equal(read, points)
    assert np.array_equal(observers(colours, 2), seen)


def test_stamp_names_commit_and_jobs(tmp_path: Path) -> None:
    settings = Settings(tmp_path, 60.0, jobs=3)
    mission = Mission("mine", 1, "both")
    matrix.run_one(mission, settings, FakeRunner())
    stamp = matrix.stamp(tmp_path / mission.name)
    assert stamp["jobs"] == "3"
    assert stamp["sources"] == matrix.source_digest()
    assert stamp["commit"] == matrix.commit()
    assert json.loads((tmp_path / mission.name / "metrics.json").read_text())["union_m3"] == 2000.0
