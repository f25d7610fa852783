"""The training log: what is in it, and what a resumed run does to it."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from models.training_log import COLUMNS, CSV_NAME, TrainingLog

LOSSES = (3.0, 2.0, 100.0)


def rows(directory: Path) -> list[dict[str, str]]:
    with (directory / CSV_NAME).open() as file:
        return list(csv.DictReader(file))


def write(directory: Path, first_step: int, steps: range) -> list[str]:
    with TrainingLog(directory, first_step) as log:
        return [log.write(step, step * 1.5, 1000, LOSSES, (2.5, 1.5, 90.0)) for step in steps]


def test_rows_hold_what_was_written(tmp_path: Path) -> None:
    texts = write(tmp_path, 0, range(10, 31, 10))
    found = rows(tmp_path)
    assert tuple(found[0]) == COLUMNS
    assert [row["step"] for row in found] == ["10", "20", "30"]
    assert float(found[2]["elapsed_s"]) == 45.0
    assert float(found[0]["validation_reconstruction"]) == 1.5
    assert texts[0].startswith("step 10, 15 s: loss 3.00")


def test_a_resumed_run_drops_what_it_repeats(tmp_path: Path) -> None:
    write(tmp_path, 0, range(10, 41, 10))
    write(tmp_path, 20, range(30, 41, 10))
    assert [row["step"] for row in rows(tmp_path)] == ["10", "20", "30", "40"]


def test_a_new_run_starts_an_empty_log(tmp_path: Path) -> None:
    write(tmp_path, 0, range(10, 41, 10))
    write(tmp_path, 0, range(0))
    assert rows(tmp_path) == []


def test_events_are_written_where_tensorboard_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training needs the extra 'train'")
    pytest.importorskip("tensorboard", reason="event files need tensorboard")
    write(tmp_path, 0, range(10, 21, 10))
    events = list(tmp_path.glob("events.out.tfevents.*"))
    assert len(events) == 1
    assert events[0].stat().st_size > 100


def test_no_events_without_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("models.training_log.find_spec", lambda name: None)
    write(tmp_path, 0, range(10, 21, 10))
    assert [path.name for path in tmp_path.iterdir()] == [CSV_NAME]
