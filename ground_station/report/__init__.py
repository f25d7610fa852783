"""One self-contained HTML page per run, for the people who were in the field and those who were not."""

from __future__ import annotations

from pathlib import Path

from ground_station.export import write_bytes
from ground_station.record import RunRecord

__all__ = ["write_report"]


def write_report(run_dir: Path, record: RunRecord) -> Path:
    """Write `report.html` and `map.png` into `run_dir` and return the page's path. Raises InputError."""
    from ground_station.report.page import render_page  # noqa: PLC0415  # matplotlib costs a second
    from ground_station.report.views import draw_levels, draw_overview  # noqa: PLC0415

    overview = draw_overview(record)
    write_bytes(run_dir / "map.png", overview)
    page = run_dir / "report.html"
    write_bytes(page, render_page(record, overview, draw_levels(record)).encode())
    return page
