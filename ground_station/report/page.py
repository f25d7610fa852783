"""The page itself: one HTML file that needs nothing from the network."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from typing import Any

from ground_station.palette import robot_colour
from ground_station.record import RunRecord
from ground_station.report.fields import (
    TEAM,
    flatten,
    name_and_unit,
    show,
    show_bytes,
    show_time,
    split_by_robot,
)
from ground_station.report.plots import BYTES, EXPLORED, plot_bytes, plot_explored, series

CAPTION = (
    "Darker means more occupied voxels in a column; colours mix where storeys overlap; "
    "numbers refer to the events."
)
STYLE_SHEET = Path(__file__).with_name("style.css")


def render_page(record: RunRecord, overview: bytes, levels: bytes | None) -> str:
    """The whole report; `overview` and `levels` are PNG images of the map."""
    sections = [
        _cards(record),
        _curves(record),
        _picture("Map", overview, CAPTION),
        _picture("Levels", levels, "One plan per storey or height band.") if levels else "",
        _events(record),
        _metrics(record),
        _parameters(record),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(record.title)}</title>\n<style>\n{STYLE_SHEET.read_text(encoding='utf-8')}</style></head>\n"
        f"<body><main>\n{_header(record)}\n" + "\n".join(filter(None, sections)) + "\n</main></body></html>\n"
    )


def _header(record: RunRecord) -> str:
    state, text = ("good", "complete") if record.complete else ("bad", "incomplete")
    return f'<header><h1>{escape(record.title)}</h1><span class="badge {state}">{text}</span></header>'


def _cards(record: RunRecord) -> str:
    explored = {name: values[-1] for name, values in series(record, EXPLORED).items() if values}
    cards = [("Explored, team", show(explored["union"], "m³"), "team")] if "union" in explored else []
    for name in [name for name in record.robots if name in explored]:
        cards.append(
            (f"Explored by {name}", show(explored[name], "m³"), f"robot-{record.robots.index(name)}")
        )
    if times := record.timeline.get("time_s"):
        cards.append(("Mission time", show_time(times[-1]), ""))
    if deployed := [marker.time_s for marker in record.markers if marker.kind == "deploy"]:
        cards.append(("Deployed after", show_time(deployed[0]), ""))
    if sent := [values[-1] for values in series(record, BYTES).values() if values]:
        cards.append(("Sent over the radio", show_bytes(sum(sent)), ""))
    accents = "".join(
        f".robot-{index}{{border-top-color:{robot_colour(index)}}}" for index in range(len(record.robots))
    )
    boxes = "".join(
        f'<div class="card {style}"><b>{escape(value)}</b><span>{escape(label)}</span></div>'
        for label, value, style in cards
    )
    return f'<style>{accents}</style><section class="cards">{boxes}</section>'


def _curves(record: RunRecord) -> str:
    plots = [plot for plot in (plot_explored(record), plot_bytes(record)) if plot]
    boxes = "".join(f"<figure>{plot}</figure>" for plot in plots)
    return f'<section class="curves">{boxes}</section>' if boxes else ""


def _picture(title: str, image: bytes, caption: str) -> str:
    data = base64.b64encode(image).decode("ascii")
    return (
        f"<section><h2>{escape(title)}</h2><figure>"
        f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure></section>"
    )


def _events(record: RunRecord) -> str:
    if not record.markers:
        return ""
    rows = [
        [str(number), show_time(marker.time_s), marker.kind, marker.label, _place(marker.position)]
        for number, marker in enumerate(record.markers, start=1)
    ]
    return f"<section><h2>Events</h2>{_table(['#', 'Time', 'Kind', 'What', 'x, y, z (m)'], rows)}</section>"


def _place(position: tuple[float, float, float]) -> str:
    return ", ".join(f"{value:.1f}" for value in position)


def _metrics(record: RunRecord) -> str:
    by_robot, others = split_by_robot(record.metrics, record.robots)
    columns = [*record.robots, *([TEAM] if any(TEAM in row for row in by_robot.values()) else [])]
    robots = [
        [name_and_unit(key)[0], *(show(row.get(name), name_and_unit(key)[1]) for name in columns)]
        for key, row in by_robot.items()
    ]
    team = [[name_and_unit(key)[0], show(value, name_and_unit(key)[1])] for key, value in others.items()]
    tables = _table(["Per robot", *columns], robots) + _table(["Mission", ""], team)
    return f'<section><h2>Metrics</h2><div class="tables">{tables}</div></section>' if tables else ""


def _parameters(record: RunRecord) -> str:
    rows = [[key, show(value)] for key, value in flatten(record.parameters).items()]
    table = _table(["Key", "Value"], rows)
    return f"<section><details><summary>Parameters</summary>{table}</details></section>" if rows else ""


def _table(head: list[str], rows: list[list[Any]]) -> str:
    if not rows:
        return ""
    titles = "".join(f"<th>{escape(title)}</th>" for title in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"
