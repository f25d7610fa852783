"""The report: self-contained, complete, safe against what titles and labels may contain."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ground_station.record import Marker, RunRecord
from ground_station.report import write_report
from ground_station.report.plots import plot_bytes, plot_explored
from ground_station.report.views import draw_levels, draw_overview

MakeRecord = Callable[..., RunRecord]


class _Page(HTMLParser):
    """Collects what a browser would load, and the text that a reader sees."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.texts: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]

    def handle_data(self, data: str) -> None:
        self.texts.append(data.strip())


def _parse(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory, building_record: MakeRecord) -> Path:
    """The report of the building, written once."""
    return write_report(tmp_path_factory.mktemp("run"), building_record())


def test_page_loads_nothing_from_elsewhere(report: Path) -> None:
    page = _parse(report)
    assert page.links
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert not {"script", "link", "iframe"} & set(page.tags)
    text = report.read_text(encoding="utf-8")
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))


def test_page_tells_the_run(report: Path, building_record: MakeRecord) -> None:
    record = building_record()
    texts = _parse(report).texts
    union = record.timeline["explored_m3/union"][-1]
    for text in (
        "building, seed 1",
        "complete",
        f"{union:,.0f} m³",
        "4:00 min",
        "aerial released",
        "12.0",
        "0.104",
    ):
        assert any(text in shown for shown in texts), text
    assert {"Per robot", "ground", "aerial", "team", "mission.duration_s", "robots.ground.size_m"} <= set(
        texts
    )


def test_incomplete_run_says_so(tmp_path: Path, building_record: MakeRecord) -> None:
    texts = _parse(write_report(tmp_path, building_record(complete=False))).texts
    assert "incomplete" in texts
    assert "complete" not in texts


def test_titles_and_labels_are_escaped(tmp_path: Path, building_record: MakeRecord) -> None:
    attack = "<script>alert(1)</script>"
    record = building_record(
        title=attack, markers=[Marker(attack, "start", (0, 0, 0), 0)], parameters={attack: attack}
    )
    page = _parse(write_report(tmp_path, record))
    assert "script" not in page.tags
    assert attack in page.texts


def test_same_record_same_bytes(tmp_path: Path, report: Path, building_record: MakeRecord) -> None:
    assert write_report(tmp_path, building_record()).read_bytes() == report.read_bytes()
    assert (tmp_path / "map.png").read_bytes() == report.with_name("map.png").read_bytes()


def test_map_picture_shows_both_robots(report: Path) -> None:
    with Image.open(report.with_name("map.png")) as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    orange = (pixels[:, 0] - pixels[:, 2] > 80).mean()
    blue = (pixels[:, 2] - pixels[:, 0] > 80).mean()
    assert orange > 0.005
    assert blue > 0.005


def test_empty_run_still_gives_a_page(tmp_path: Path, building_record: MakeRecord) -> None:
    record = building_record(
        metrics={},
        timeline={"time_s": []},
        paths={},
        occupied=np.empty((0, 3), np.float32),
        seen_by=np.empty(0, np.uint8),
        markers=[],
        complete=False,
    )
    page = _parse(write_report(tmp_path, record))
    assert "incomplete" in page.texts
    assert "svg" not in page.tags


def test_ground_robot_alone(tmp_path: Path, building_record: MakeRecord) -> None:
    whole = building_record()
    record = building_record(
        robots=["ground"],
        paths={"ground": whole.paths["ground"]},
        seen_by=(whole.seen_by > 0).astype(np.uint8),
    )
    texts = _parse(write_report(tmp_path, record)).texts
    assert "Explored by ground" in texts
    assert "Explored by aerial" not in texts


def test_plots_leave_out_what_was_not_recorded(building_record: MakeRecord) -> None:
    silent = building_record(timeline={"time_s": [0.0, 1.0], "bytes/keyframe": [0.0, 0.0]})
    assert plot_bytes(silent) is None
    assert plot_explored(silent) is None


def test_flat_world_has_no_level_plans(building_record: MakeRecord) -> None:
    whole = building_record()
    assert draw_levels(building_record(paths={"ground": whole.paths["ground"]})) is None
    assert draw_levels(whole) is not None


@pytest.mark.parametrize("turned", [False, True])
def test_picture_is_readable_for_any_proportions(building_record: MakeRecord, turned: bool) -> None:
    """A corridor 200 m long must give neither a thread nor a tower."""
    corridor = np.zeros((1000, 3), np.float32)
    corridor[:, int(turned)] = np.arange(1000) * 0.2
    record = building_record(occupied=corridor, seen_by=np.ones(1000, np.uint8), paths={}, markers=[])
    with Image.open(io.BytesIO(draw_overview(record))) as picture:
        assert 0.25 < picture.height / picture.width < 2
