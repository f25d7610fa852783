"""`marsupial` and `marsupial simulate`: exit codes, one-line errors, clean JSON, help with examples."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ground_station.cli.simulate import describe
from ground_station.export import read_events
from onboard.core.errors import InputError


@pytest.mark.parametrize("command", ["simulate", "map", "world", "config show", "config check"])
def test_help_has_examples(cli: Any, command: str) -> None:
    result = cli.run(*command.split(), "--help")
    assert result.exit_code == 0
    assert "Examples" in result.stdout
    assert f"marsupial {command}" in result.stdout


def test_help_is_quick_to_import(cli: Any) -> None:
    """`--help` must not wait for the heavy libraries."""
    code = (
        "import sys; from ground_station.cli import app\n"
        "sys.exit(bool({'numpy', 'numba', 'open3d', 'matplotlib', 'scipy'} & set(sys.modules)))"
    )
    root = str(Path(__file__).parents[3])
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


def test_version_is_one_line(cli: Any) -> None:
    result = cli.run("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("marsupial ")
    assert result.stdout.count("\n") == 1


def test_simulate_passes_everything_on(cli: Any, simulator: Any, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run"
    arguments = [
        "--world",
        "cave",
        "--seed",
        "7",
        "--duration",
        "60.5",
        "--team",
        "ground",
        "--start",
        "-1,2,0.5",
        "--bt",
        "--poses",
        "true",
    ]
    result = cli.run("simulate", *arguments, "--out", out)
    assert result.exit_code == 0, result.output
    config, _, seed, path, team = simulator.calls[0]
    assert (config.mission.duration_s, seed, path, team) == (60.5, 7, out, "ground")
    assert simulator.octomap
    assert simulator.poses == "true"
    assert simulator.worlds == [("cave", 7, (-1.0, 2.0, 0.5))]
    assert "100.0 m³" in result.stdout
    assert str(out / "report.html") in result.stdout
    assert "map.ply" not in result.stdout


def test_defaults_are_the_shipped_team_and_its_duration(cli: Any, simulator: Any, tmp_path: Path) -> None:
    assert cli.run("simulate", "--out", tmp_path / "run").exit_code == 0
    config, _, seed, _, team = simulator.calls[0]
    assert not simulator.octomap
    assert simulator.poses == "estimated"
    assert [robot.name for robot in config.robots] == ["ground", "aerial"]
    assert (config.mission.duration_s, seed, team) == (900.0, 1, "both")


def test_json_is_pure(cli: Any, simulator: Any, tmp_path: Path) -> None:
    result = cli.run("simulate", "--json", "--out", tmp_path / "run")
    assert json.loads(result.stdout) == {"explored_m3": {"ground": 100.0, "union": 100.0}, "open_s": None}
    assert result.stderr == ""


@pytest.mark.parametrize("duration", ["0", "-5", "nan", "inf", "-inf"])
def test_impossible_durations_are_refused(cli: Any, simulator: Any, tmp_path: Path, duration: str) -> None:
    assert f"--duration {duration}" in cli.refuses(
        "simulate", "--duration", duration, "--out", tmp_path / "run"
    )
    assert not (tmp_path / "run").exists()
    assert not simulator.calls


@pytest.mark.parametrize(
    "arguments",
    [
        ["--duration", "long"],
        ["--seed", "-1"],
        ["--team", "nobody"],
        ["--poses", "guessed"],
        ["--start", "1,2"],
        ["--start", "a,b,c"],
        ["--start", "nan,0,0"],
        ["--unknown"],
    ],
)
def test_wrong_usage_exits_with_2(cli: Any, simulator: Any, tmp_path: Path, arguments: list[str]) -> None:
    result = cli.run("simulate", *arguments, "--out", tmp_path / "run")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert not simulator.calls


def test_unknown_world_is_one_line(cli: Any, simulator: Any, tmp_path: Path) -> None:
    assert "building" in cli.refuses("simulate", "--world", "atlantis", "--out", tmp_path / "run")
    assert "atlantis" in cli.refuses("world", "--world", "atlantis", "--out", tmp_path / "x.png")


def test_unwritable_output_is_one_line(cli: Any, simulator: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "cannot write" in cli.refuses("simulate", "--out", tmp_path / "file" / "run")
    assert "cannot write" in cli.refuses("simulate", "--out", tmp_path / "file")
    assert not simulator.calls


def test_earlier_run_is_replaced_only_on_demand(cli: Any, simulator: Any, tmp_path: Path) -> None:
    assert cli.run("simulate", "--out", tmp_path).exit_code == 0
    (tmp_path / "notes.txt").write_text("mine")
    assert "--force" in cli.refuses("simulate", "--out", tmp_path)
    assert cli.run("simulate", "--out", tmp_path, "--force").exit_code == 0
    assert len(read_events(tmp_path / "events.jsonl")) == 1
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_interrupt_exits_with_130_and_keeps_the_events(cli: Any, simulator: Any, tmp_path: Path) -> None:
    simulator.fault = KeyboardInterrupt()
    result = cli.run("simulate", "--out", tmp_path)
    assert result.exit_code == 130
    assert "interrupted" in result.stderr
    assert [event["kind"] for event in read_events(tmp_path / "events.jsonl")] == ["start"]


def test_error_text_is_not_taken_for_markup(cli: Any, simulator: Any, tmp_path: Path) -> None:
    simulator.fault = InputError("a[red]b[/nothing]")
    assert "error: a[red]b[/nothing]" in cli.run("simulate", "--out", tmp_path).stderr


def test_bugs_are_not_hidden(cli: Any, simulator: Any, tmp_path: Path) -> None:
    simulator.fault = ZeroDivisionError()
    assert isinstance(cli.run("simulate", "--out", tmp_path).exception, ZeroDivisionError)


def test_progress_line_names_robots_and_speed() -> None:
    state: Any = SimpleNamespace(
        time_s=30.0, duration_s=60.0, explored_m3={"ground": 12.4}, union_m3=12.4, message="released"
    )
    assert describe(state, 3.0) == "ground 12 team 12 m³  10.0x  released"


def test_mission_out_of_time_is_no_failure(cli: Any, simulator: Any, tmp_path: Path) -> None:
    simulator.metrics["complete"] = False
    assert cli.run("simulate", "--out", tmp_path).exit_code == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_killed_run_exits_with_130_and_keeps_the_events(tmp_path: Path, number: signal.Signals) -> None:
    script = """if True:
        import os, signal, sys, types
        from ground_station.cli.app import main
        from ground_station.export import EventLog

        signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore it
        _, out, number = sys.argv
        sys.argv = ["marsupial", "simulate", "--out", out]

        def simulate(config, world, *, out, **others):
            EventLog(out / "events.jsonl").write(1.0, "explore")
            os.kill(os.getpid(), int(number))

        run, worlds = types.ModuleType("simulation.run"), types.ModuleType("simulation.worlds")
        run.simulate, worlds.world_by_name = simulate, lambda *_: None
        sys.modules |= {module.__name__: module for module in (run, worlds)}
        main()
    """
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path), str(int(number))],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert "interrupted" in done.stderr
    assert [event["kind"] for event in read_events(tmp_path / "events.jsonl")] == ["explore"]
