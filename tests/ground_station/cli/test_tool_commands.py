"""`marsupial world`, `map` and `config`."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from ground_station.cli.terminal import default_config_path
from ground_station.cli.toml import to_toml


def test_world_prints_extents_and_writes_the_picture(cli: Any, simulator: Any, tmp_path: Path) -> None:
    result = cli.run("world", "--out", tmp_path / "world.png", "--start", "1,2,3")
    assert result.exit_code == 0
    assert "40.0 x 20.0 x 3.0 m" in result.stdout
    assert "1,200" in result.stdout
    assert (tmp_path / "world.png").exists()
    assert simulator.worlds == [("building", 1, (1.0, 2.0, 3.0))]


def test_world_refuses_what_it_cannot_write(cli: Any, simulator: Any, tmp_path: Path) -> None:
    assert ".png" in cli.refuses("world", "--out", tmp_path / "world.docx")
    assert "cannot write" in cli.refuses("world", "--out", tmp_path / "absent" / "world.png")


def test_map_reports_and_prints(cli: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[tuple[Any, ...]] = []

    def fake(
        path: Path,
        sensor: str,
        out: Path,
        progress: Callable[[int, int | None], None],
        settings: Any,
        reference: Path | None,
    ) -> dict[str, Any]:
        progress(3, None)
        progress(10, 10)
        calls.append((path, sensor, out, settings.octomap, settings.mesh, settings.rate_hz, reference))
        return {"scans": 10}

    module = ModuleType("ground_station.recording")
    vars(module)["map_recording"] = fake
    monkeypatch.setitem(sys.modules, "ground_station.recording", module)
    recording = tmp_path / "walk.pcap"
    recording.write_bytes(b"")
    out, known = tmp_path / "map", tmp_path / "truth.txt"
    options = ("--sensor", "os0-64", "--json", "--mesh", "--rate", "5", "--reference", known)
    result = cli.run("map", recording, "--out", out, *options)
    assert json.loads(result.stdout) == {"scans": 10}
    assert calls == [(recording, "os0-64", out, False, True, 5.0, known)]
    assert "Scans" in cli.run("map", recording, "--out", tmp_path / "map").stdout


def test_interrupted_map_exits_with_130(cli: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    module = ModuleType("ground_station.recording")
    vars(module)["map_recording"] = lambda *_: {"scans": 4, "complete": False}
    monkeypatch.setitem(sys.modules, "ground_station.recording", module)
    (tmp_path / "walk.pcap").write_bytes(b"")
    result = cli.run("map", tmp_path / "walk.pcap", "--json", "--out", tmp_path / "map")
    assert result.exit_code == 130
    assert json.loads(result.stdout)["scans"] == 4


def test_map_of_nothing_is_one_line(cli: Any, tmp_path: Path) -> None:
    assert "absent.pcap" in cli.refuses("map", tmp_path / "absent.pcap", "--out", tmp_path / "map")
    assert not (tmp_path / "map").exists()
    assert cli.run("map", tmp_path / "x.pcap", "--sensor", "sonar").exit_code == 2


def without_null(data: Any) -> Any:
    """TOML has no null: what is not set is left out."""
    if isinstance(data, dict):
        return {key: without_null(value) for key, value in data.items() if value is not None}
    return [without_null(item) for item in data] if isinstance(data, list) else data


def test_shown_configuration_reads_back(cli: Any, tmp_path: Path) -> None:
    shown = cli.run("config", "show")
    (tmp_path / "again.toml").write_text(shown.stdout)
    assert cli.run("config", "show", tmp_path / "again.toml").stdout == shown.stdout
    resolved = json.loads(cli.run("config", "show", "--json").stdout)
    assert resolved["mission"]["area_m"] is None
    assert tomllib.loads(shown.stdout) == without_null(resolved)


def test_check_accepts_the_shipped_team(cli: Any) -> None:
    result = cli.run("config", "check", default_config_path())
    assert result.exit_code == 0
    assert "ground (ground), aerial (aerial)" in result.stdout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("voxel_m = 0.2", "voxel_m = 5", ["map.voxel_m", "5", "1"]),
        ("[radio]", "[radios]", ["radios"]),
        ("[radio]", "[radio", ["not valid TOML"]),
        ("id = 2", "id = 1", ["ids must differ"]),
    ],
)
def test_check_names_file_key_and_bound(
    cli: Any, tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    path = tmp_path / "team.toml"
    path.write_text(default_config_path().read_text().replace(old, new, 1))
    line = cli.refuses("config", "check", path)
    assert all(word in line for word in ["team.toml", *words])


def test_unreadable_configuration_is_one_line(cli: Any, tmp_path: Path) -> None:
    assert "absent.toml" in cli.refuses("config", "check", tmp_path / "absent.toml")
    assert "cannot read" in cli.refuses("config", "show", tmp_path)


def test_toml_survives_strings_lists_and_missing_values(cli: Any) -> None:
    data = {
        "text": 'a "quoted" \\ line\n',
        "none": None,
        "list": [1.5, -2],
        "yes": True,
        "t": {"u": {"v": [{"w": 1}]}},
    }
    expected = {key: value for key, value in data.items() if key != "none"}
    assert tomllib.loads(to_toml(data)) == expected
