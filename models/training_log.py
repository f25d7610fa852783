"""What a training run says about itself: a CSV file, and TensorBoard events where it is installed."""

from __future__ import annotations

import csv
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

CSV_NAME = "log.csv"
COLUMNS = (
    "step", "elapsed_s", "training_scans", "loss", "reconstruction", "divergence",
    "validation_loss", "validation_reconstruction", "validation_divergence",
)  # fmt: skip

Losses = tuple[float, float, float]


class TrainingLog:
    """Appends rows to `log.csv` under a directory; rows of steps that a resumed run repeats are dropped."""

    def __init__(self, directory: Path, first_step: int) -> None:
        self._path = directory / CSV_NAME
        rows = [row for row in _rows(self._path) if int(row[0]) <= first_step]
        with self._path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([COLUMNS, *rows])
        self._events: Any = _event_writer(directory)

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._events is not None:
            self._events.close()

    def write(self, step: int, elapsed_s: float, scans: int, training: Losses, validation: Losses) -> str:
        """Add a row; returns it as text for a person."""
        row = (step, elapsed_s, scans, *training, *validation)
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow([row[0], *(f"{value:.6g}" for value in row[1:])])
        if self._events is not None:
            for name, value in zip(COLUMNS[1:], row[1:], strict=True):
                self._events.add_scalar(name, value, step)
        return (
            f"step {step}, {elapsed_s:.0f} s: loss {training[0]:.2f} (squared error {training[1]:.2f}, "
            f"divergence {training[2]:.0f} nat), validation {validation[0]:.2f} ({validation[1]:.2f})"
        )


def _rows(path: Path) -> list[list[str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))[1:]


def _event_writer(directory: Path) -> Any:
    if find_spec("tensorboard") is None:
        return None
    from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415  (optional)

    return SummaryWriter(str(directory))
