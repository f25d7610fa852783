"""The exploration benchmark around its flights: what runs, what is kept, what is measured and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.exploration import __main__ as command
from benchmarks.exploration import flights
from benchmarks.exploration.contenders import CONTENDERS, CUT_OFF_M
from benchmarks.exploration.flights import RESULT, Flight
from benchmarks.exploration.measures import measured, phases, still_share, stopped_early
from benchmarks.exploration.places import moved_start, short_name, world_for
from benchmarks.exploration.report import section
from benchmarks.exploration.statistics import compare, summary
from ground_station.export import EventLog, write_json
from onboard.core.config import load_config
from onboard.core.errors import InputError
from simulation.coverage import Coverage
from simulation.run import reachable
from tests.simulation.small_mission import TEAM, played, room, team

VOLUMES = {"ours": 1200.0, "parity": 1000.0, "nearest": 800.0, "team": 3000.0, "ground": 1500.0}


@dataclass
class FakeRunner:
    """Leaves behind what a flight would, at once."""

    calls: list[dict[str, str]] = field(default_factory=list)
    volumes: dict[str, float] = field(default_factory=lambda: dict(VOLUMES))
    fails: str | None = None
    reason: str = "time to return"

    def __call__(self, arguments: Sequence[str], log: Path) -> int:
        option = dict(zip(arguments[::2], arguments[1::2], strict=True))
        self.calls.append(option)
        out = Path(option["--out"])
        if self.fails is not None and self.fails in out.name:
            log.write_text("noise\nerror: no floor\n")
            return 2
        leave_run(out, option, self.volumes[option["--contender"]], self.reason)
        return 0


def leave_run(out: Path, option: dict[str, str], volume_m3: float, reason: str) -> None:
    robots = {"team": ["ground", "aerial"], "ground": ["ground"]}.get(option["--contender"], ["aerial"])
    write_json(out / "config.json", {"robots": [{"name": name, "kind": name} for name in robots]})
    series = {"time_s": [0.0, 100.0, 300.0], "explored_m3/union": [0.0, volume_m3 / 2, volume_m3]}
    write_json(out / "timeline.json", series | {"coverage": [0.0, 0.5, 0.92]})
    track = [[t, min(t, 5.0), 0.0, 1.0] for t in range(11)]
    write_json(out / "paths.json", dict.fromkeys(robots, track))
    with EventLog(out / "events.jsonl") as log:
        for name in robots:
            log.write(0.0, "phase", robot=name, phase="exploring")
            log.write(10.0, "phase", robot=name, phase="returning", reason=reason)
    one = {"explored_m3": 0.6 * volume_m3 if len(robots) > 1 else volume_m3, "path_m": 5.0}
    found = {name: one | {"collisions": 0, "home": name == "aerial"} for name in robots}
    metrics = {"union_m3": volume_m3, "coverage": 0.92, "robots": found}
    spec = {"sources": flights.digest(), "metrics": metrics}
    write_json(out / RESULT, spec)


@dataclass
class Bench:
    """A folder to work in and the command line with a made-up runner."""

    path: Path
    runner: FakeRunner = field(default_factory=FakeRunner)

    def main(self, *more: str) -> int:
        return command.main(["--out", str(self.path / "runs"), "--jobs", "1", *more], self.runner)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_every_pair_flies_and_the_document_gets_its_section(bench: Bench) -> None:
    table = bench.path / "results.md"
    table.write_text("before\n<!-- exploration:begin -->\nold\n<!-- exploration:end -->\nafter\n")
    assert bench.main("--seeds", "2", "--table", str(table)) == 0
    assert len(bench.runner.calls) == 3 * 2 * 3
    assert [call["--contender"] for call in bench.runner.calls[:3]] == ["ours", "parity", "nearest"]
    assert {call["--duration"] for call in bench.runner.calls} == {"300"}
    text = table.read_text()
    assert (
        "| cave | ours | 2 | 1200 (1200 to 1200) | 750 | 0.92 | 300 (2 of 2) | 5 | 50.0 | 0 | 0 | 0 | 0 |"
        in text
    )
    assert "| ours over parity | +20 % (+20 to +20, n 6) |" in text
    assert "Worst of ours against nearest: building 1 (+50 %)" in text
    assert text.startswith("before\n")
    assert "old" not in text
    assert (bench.path / "runs" / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_teams_have_their_own_time_and_seeds(bench: Bench) -> None:
    bench.main(
        "--worlds", "mine", "--planners", "ours", "team", "ground", "--seeds", "3", "--team-seeds", "1"
    )
    assert len(bench.runner.calls) == 3 + 2
    assert {call["--duration"] for call in bench.runner.calls[1:3]} == {"600"}


def test_finished_runs_are_kept_and_interrupted_ones_run_again(bench: Bench) -> None:
    bench.main("--worlds", "cave", "--seeds", "1")
    (bench.path / "runs" / "cave-1-parity-300s" / RESULT).unlink()
    bench.main("--worlds", "cave", "--seeds", "1")
    assert [call["--contender"] for call in bench.runner.calls[3:]] == ["parity"]


def test_other_sources_run_again_unless_taken_as_they_are(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.main("--worlds", "cave", "--seeds", "1")
    monkeypatch.setattr(flights, "digest", lambda: "other")
    bench.main("--worlds", "cave", "--seeds", "1", "--as-is")
    assert len(bench.runner.calls) == 3
    bench.main("--worlds", "cave", "--seeds", "1", "--planners", "ours")
    assert len(bench.runner.calls) == 4
    capsys.readouterr()
    bench.main("--worlds", "cave", "--seeds", "1", "--as-is")
    assert "different states of the sources" in " ".join(capsys.readouterr().out.split())


def test_a_failed_run_is_reported_and_the_others_count(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.runner.fails = "cave-1-parity"
    assert bench.main("--worlds", "cave", "mine", "--seeds", "1") == 1
    text = capsys.readouterr().out
    assert "error: no floor" in text
    assert "n 1)" in text


def test_nothing_finished_is_an_error(bench: Bench) -> None:
    with pytest.raises(InputError, match="no finished run"):
        bench.main("--as-is")


def test_measures_of_a_team(tmp_path: Path) -> None:
    flight = Flight("cave", 1, "team", 600.0)
    option = {"--contender": "team"}
    (tmp_path / flight.name).mkdir()
    leave_run(tmp_path / flight.name, option, 3000.0, "time to return")
    run = measured(flight, tmp_path)
    assert run is not None
    assert run.overlap == pytest.approx(0.2)
    assert (run.late, run.path_m, run.stopped_early, run.done_s) == (1, 10.0, False, 300.0)
    assert run.volume_at(200.0) == pytest.approx(2250.0)
    assert run.volume_at(900.0) == 3000.0
    assert measured(Flight("cave", 2, "team", 600.0), tmp_path) is None


@pytest.mark.parametrize(("reason", "early"), [("nothing left to explore", True), ("time to return", False)])
def test_going_home_for_lack_of_goals_with_much_left_is_noted(
    tmp_path: Path, reason: str, early: bool
) -> None:
    flight = Flight("cave", 1, "ours", 300.0)
    (tmp_path / flight.name).mkdir()
    leave_run(tmp_path / flight.name, {"--contender": "ours"}, 1.0, reason)
    run = measured(flight, tmp_path)
    assert run is not None
    assert run.stopped_early is early


def test_want_of_time_is_no_early_stop() -> None:
    def events(verdict: str) -> list[dict[str, Any]]:
        candidates = [{"verdict": "lower score"}, {"verdict": verdict}]
        gone = {"time_s": 9.0, "kind": "phase", "phase": "returning", "reason": "nothing left to explore"}
        return [{"time_s": 8.9, "kind": "cycle", "candidates": candidates}, gone]

    assert stopped_early(events("refused"), {"aerial": {}}, 0.5)
    assert not stopped_early(events("no time to be back"), {"aerial": {}}, 0.5)
    assert not stopped_early(events("refused"), {"aerial": {}}, 0.97)
    assert not stopped_early(events("refused"), {"ground": {}}, 0.5)


def test_standing_counts_while_exploring_only() -> None:
    track = [[t, min(t, 5.0), 0.0, 0.0] for t in range(21)]
    events: list[dict[str, Any]] = [
        {"time_s": 0.0, "kind": "phase", "robot": "aerial", "phase": "exploring"},
        {"time_s": 8.0, "kind": "phase", "robot": "ground", "phase": "returning"},
        {"time_s": 10.0, "kind": "phase", "robot": "aerial", "phase": "returning"},
    ]
    assert still_share(track, "aerial", phases(events, "aerial")) == pytest.approx(0.5)
    assert still_share(track, "ground", phases(events, "ground")) == pytest.approx(3 / 8)
    assert still_share(track, "aerial", []) == 0.0
    assert still_share([], "ground", []) == 0.0


def test_interval_covers_the_mean_and_grows_with_the_scatter() -> None:
    rng = np.random.default_rng(2)
    narrow = summary({"a": rng.normal(0.2, 0.02, 8).tolist(), "b": rng.normal(0.2, 0.02, 8).tolist()})
    wide = summary({"a": rng.normal(0.2, 0.3, 8).tolist(), "b": rng.normal(0.2, 0.3, 8).tolist()})
    assert narrow.low < narrow.mean < narrow.high
    assert narrow.mean == pytest.approx(np.exp(0.2), rel=0.02)
    assert wide.high - wide.low > 5 * (narrow.high - narrow.low)
    assert summary({"a": [0.1, 0.1]}).low == pytest.approx(np.exp(0.1))


def test_only_equal_worlds_seeds_and_times_are_compared(bench: Bench) -> None:
    bench.main("--worlds", "cave", "mine", "--seeds", "2")
    wanted = [Flight("cave", seed, "ours", 300.0) for seed in (1, 2)] + [Flight("cave", 2, "parity", 300.0)]
    runs = [run for flight in wanted if (run := measured(flight, bench.path / "runs")) is not None]
    found = compare(runs, "ours", "parity")
    assert found is not None
    assert found.pairs == [(pytest.approx(1.2), "cave", 2)]
    assert compare(runs, "ours", "nearest") is None
    assert "n 1)" in section(runs)


def test_cut_off_team_has_no_radio_beyond_the_bracket() -> None:
    config = load_config(TEAM)
    assert CONTENDERS["apart"].configured(config, 60.0).radio.range_m == CUT_OFF_M
    assert CONTENDERS["team"].configured(config, 60.0).radio == config.radio
    assert CONTENDERS["ours"].configured(config, 60.0).mission.duration_s == 60.0


def test_names_of_worlds() -> None:
    assert short_name("cave") == "cave"
    assert short_name("/data/darpa_cave_02/world.ply") == "darpa_cave_02"
    assert short_name("hall.obj") == "hall"
    assert world_for("mine", 3).name == "mine"


def test_seeds_move_the_start_of_a_mesh_to_another_floor_point() -> None:
    starts = [moved_start(room(), seed).start for seed in (2, 3, 2)]
    assert (starts[0] == starts[2]).all()
    assert np.linalg.norm(starts[0] - starts[1]) > 0.1
    assert all(abs(start[2]) < 0.01 and abs(start[0]) < 6 and abs(start[1]) < 4 for start in starts)


def test_coverage_agrees_with_the_final_score() -> None:
    config = team("aerial", mission={"duration_s": 6.0})
    mission, _ = played(config, room())
    truth = reachable(config, room())
    cover = Coverage(truth)
    assert cover.share == 0.0
    maps = [agent.core.explorer.map for agent in mission.agents]
    cover.add(maps)
    once = cover.share
    cover.add(maps)
    inside = truth.contains(maps[0].known_indices()).sum() * 0.2**3 / truth.reachable_m3
    assert cover.share == once == pytest.approx(float(inside), abs=1e-9)
