"""`marsupial codec`: files in and out, one-line errors, JSON, and training behind its extra."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ground_station.cli import codec_training
from ground_station.cli.codec import parse_budgets
from onboard.codec import decode
from onboard.core.errors import InputError

RANGES = np.full((16, 1800), 4.0, np.float32)


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.npz"
    np.savez(path, ranges=np.stack([RANGES, RANGES / 2]), position=np.ones((2, 3)))
    return path


@pytest.mark.parametrize("command", ["encode", "decode", "evaluate", "plot", "train", "export"])
def test_help_has_examples(cli: Any, command: str) -> None:
    result = cli.run("codec", command, "--help")
    assert result.exit_code == 0
    assert f"marsupial codec {command}" in result.stdout


def test_encode_and_decode(cli: Any, scan: Path, tmp_path: Path) -> None:
    result = cli.run("codec", "encode", scan, "--index", "1", "--budget", "150", "--json")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    path = scan.with_suffix(".mkf")
    assert facts["file"] == str(path)
    assert facts["bytes"] == path.stat().st_size <= 150
    assert facts["sensor"] == "vlp-16"
    assert facts["position"] == [1, 1, 1]
    assert float(np.median(decode(path.read_bytes()).ranges)) == pytest.approx(2.0, abs=0.4)
    for suffix in ("npz", "npy", "ply"):
        out = tmp_path / f"out.{suffix}"
        result = cli.run("codec", "decode", path, "--out", out)
        assert result.exit_code == 0, result.output
        assert out.is_file()
        assert "quadtree" in result.stdout


def test_the_codec_and_the_name_can_be_chosen(cli: Any, scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "exact.mkf"
    assert cli.run("codec", "encode", scan, "--codec", "exact", "--out", out).exit_code == 0
    assert json.loads(cli.run("codec", "decode", out, "--json").stdout)["codec"] == "exact"


def test_evaluate_tells_people_and_programs(cli: Any, scan: Path) -> None:
    options = ("codec", "evaluate", scan, "--budgets", "200,100", "--limit", "1")
    result = cli.run(*options, "--json")
    assert result.exit_code == 0, result.output
    scores = json.loads(result.stdout)
    assert [score["setting"] for score in scores] == ["auto, 100 B", "auto, 200 B"]
    assert all(score["scans"] == 1 and 0 < score["f1"] <= 1 for score in scores)
    table = cli.run(*options)
    assert table.exit_code == 0
    assert "unsafe26" in table.stdout
    assert "auto, 200 B" in table.stdout


def test_plot(cli: Any, scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    result = cli.run("codec", "plot", scan, "--budgets", "60,120", "--out", out)
    assert result.exit_code == 0, result.output
    assert out.read_bytes().startswith(b"\x89PNG")
    assert "end the name in .png" in cli.refuses("codec", "plot", scan, "--out", "a.pdf")


def test_errors_are_one_line(cli: Any, scan: Path, tmp_path: Path) -> None:
    absent, text = tmp_path / "absent.npz", tmp_path / "a.txt"
    assert "no such file" in cli.refuses("codec", "encode", absent)
    assert "not a scan" in cli.refuses("codec", "encode", text)
    assert "holds 2 scans" in cli.refuses("codec", "encode", scan, "--index", "2")
    assert "budget_bytes = 5" in cli.refuses("codec", "encode", scan, "--budget", "5")
    assert "exclude each other" in cli.refuses("codec", "encode", scan, "--budget", "90", "--quality", "2")
    assert "quality = 0.01" in cli.refuses("codec", "encode", scan, "--quality", "0.01")
    assert "cannot write" in cli.refuses("codec", "encode", scan, "--out", tmp_path / "no" / "a.mkf")
    assert "expected 18 to 60000" in cli.refuses("codec", "decode", scan)
    assert "end the name in" in cli.refuses("codec", "decode", scan, "--out", text)
    assert "cannot read" in cli.refuses("codec", "decode", absent)


def test_scans_of_two_sensors_are_not_mixed(cli: Any, scan: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "other.npy", np.full((64, 512), 3.0))
    assert "one LiDAR at a time" in cli.refuses("codec", "evaluate", scan, tmp_path / "other.npy")


def test_budgets() -> None:
    assert parse_budgets("300, 100,300") == [100, 300]
    for text in ("", "a", "100,", "1.5"):
        with pytest.raises(InputError, match="whole numbers"):
            parse_budgets(text)
    for text in ("17", "100,60001"):
        with pytest.raises(InputError, match="between 18 and 60000"):
            parse_budgets(text)


class Api:
    """Stands in for models.cli_api and keeps what it was asked for."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def generate_scans(self, *arguments: Any, **options: Any) -> None:
        options.pop("progress")(1, 4, "cave 3000")
        self.calls.append(("generate", arguments, options))

    def train_model(self, *arguments: Any, **options: Any) -> Path:
        options.pop("report")("step 1")
        self.calls.append(("train", arguments, options))
        return Path("vae/checkpoint.pt")

    def export_model(self, *arguments: Any, **options: Any) -> Any:
        self.calls.append(("export", arguments, options))
        return SimpleNamespace(tag=b"\x12\xab")


@pytest.fixture
def api(monkeypatch: pytest.MonkeyPatch) -> Api:
    made = Api()
    monkeypatch.setattr(codec_training, "import_module", lambda name: {"models.cli_api": made}[name])
    return made


def test_train(cli: Any, api: Api, tmp_path: Path) -> None:
    result = cli.run(
        "codec", "train", "--sensor", "os0-64", "--data", tmp_path, "--out", "vae", "--seed", "3"
    )
    assert result.exit_code == 0, result.output
    ((name, arguments, options),) = api.calls
    assert (name, arguments) == ("train", ("os0-64", tmp_path, Path("vae")))
    assert options == {"steps": 28_000, "limit_minutes": None, "seed": 3, "device": "cpu"}
    assert "vae/checkpoint.pt" in result.stdout
    assert "step 1" in result.stderr


def test_train_makes_scans_first_where_asked(cli: Any, api: Api, tmp_path: Path) -> None:
    data = tmp_path / "scans"
    result = cli.run(
        "codec", "train", "--sensor", "vlp-16", "--data", data, "--generate", "5", "--minutes", "1"
    )
    assert result.exit_code == 0, result.output
    assert [call[0] for call in api.calls] == ["generate", "train"]
    assert api.calls[0][1:] == ((data,), {"worlds_per_kind": 5, "meshes": None})
    assert "1 of 4: cave 3000" in result.stderr


def test_export(cli: Any, api: Api, tmp_path: Path) -> None:
    checkpoint = tmp_path / "checkpoint.pt"
    checkpoint.write_bytes(b"")
    result = cli.run(
        "codec", "export", checkpoint, "--data", tmp_path, "--out", "model", "--precision", "int8"
    )
    assert result.exit_code == 0, result.output
    assert api.calls == [
        ("export", (checkpoint, tmp_path, Path("model")), {"step_sigma": 1.0, "precision": "int8"})
    ]
    assert "12ab" in result.stdout


def test_training_errors_are_one_line(cli: Any, api: Api, tmp_path: Path) -> None:
    train = ("codec", "train", "--sensor", "os0-64", "--data")
    assert "--generate" in cli.refuses(*train, tmp_path / "absent")
    assert "--minutes" in cli.refuses(*train, tmp_path, "--minutes", "nan")
    assert "no such checkpoint" in cli.refuses("codec", "export", tmp_path / "absent.pt")
    assert "--step" in cli.refuses("codec", "export", tmp_path / "absent.pt", "--step", "0")
    assert api.calls == []


def test_without_torch_the_extra_is_named(cli: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(name: str) -> Any:
        raise ModuleNotFoundError("No module named 'torch'")

    monkeypatch.setattr(codec_training, "import_module", refuse)
    line = cli.refuses("codec", "train", "--sensor", "os0-64", "--data", tmp_path)
    assert "pip install 'marsupial[train]'" in line
