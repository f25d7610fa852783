"""Exports: read back by independent libraries, whole or absent, readable after a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from ground_station.export import EventLog, plain, read_events, write_json, write_ply
from ground_station.palette import ROBOT_COLOURS, SHARED_COLOUR, UNSEEN_COLOUR, observer_colours, rgb
from onboard.core.errors import InputError


def test_ply_reads_back_in_trimesh(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-100, 100, (500, 3)).astype(np.float32)
    colours = rng.integers(0, 256, (500, 3), dtype=np.uint8)
    write_ply(tmp_path / "map.ply", points, colours)
    cloud = trimesh.load(tmp_path / "map.ply")
    np.testing.assert_array_equal(cloud.vertices.astype(np.float32), points)
    np.testing.assert_array_equal(cloud.colors[:, :3], colours)


def test_ply_reads_back_in_open3d(tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d")
    points = np.array([[0.1, -2.0, 3.0], [10.3, 0.0, -0.5]])
    write_ply(tmp_path / "map.ply", points, np.array([[255, 0, 51], [0, 102, 255]], dtype=np.uint8))
    cloud = open3d.io.read_point_cloud(str(tmp_path / "map.ply"))
    np.testing.assert_allclose(np.asarray(cloud.points), points, atol=1e-6)
    np.testing.assert_allclose(np.asarray(cloud.colors), [[1, 0, 0.2], [0, 0.4, 1]], atol=1e-6)


def test_empty_ply_has_a_header_and_no_points(tmp_path: Path) -> None:
    write_ply(tmp_path / "map.ply", np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8))
    assert b"element vertex 0\n" in (tmp_path / "map.ply").read_bytes()


def test_colours_follow_the_bit_mask() -> None:
    masks = np.array([0b01, 0b10, 0b11, 0b00], dtype=np.uint8)
    expected = rgb([ROBOT_COLOURS[0], ROBOT_COLOURS[1], SHARED_COLOUR, UNSEEN_COLOUR])
    np.testing.assert_array_equal(observer_colours(masks, 2), expected)


def test_colours_serve_larger_teams() -> None:
    masks = np.array([1 << 4, 0b10001], dtype=np.uint8)
    np.testing.assert_array_equal(observer_colours(masks, 5), rgb([ROBOT_COLOURS[4], SHARED_COLOUR]))


def test_json_keeps_order_and_replaces_what_json_cannot_say(tmp_path: Path) -> None:
    data = {
        "z": np.float32(1.5),
        "a": np.array([1, 2]),
        "nan": float("nan"),
        "inf": np.inf,
        "path": Path("x"),
    }
    write_json(tmp_path / "metrics.json", data)
    text = (tmp_path / "metrics.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"z": 1.5, "a": [1, 2], "nan": None, "inf": None, "path": "x"}
    assert text.index('"z"') < text.index('"a"')


def test_json_refuses_unknown_types() -> None:
    with pytest.raises(TypeError, match="object"):
        plain({"thing": object()})


def test_failed_json_leaves_the_earlier_file(tmp_path: Path) -> None:
    target = tmp_path / "metrics.json"
    write_json(target, {"run": 1})
    with pytest.raises(TypeError):
        write_json(target, {"run": {1, 2}})
    assert json.loads(target.read_text()) == {"run": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.json"]


def test_missing_directory_is_the_users_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        write_json(tmp_path / "absent" / "metrics.json", {})


def test_events_read_back(tmp_path: Path) -> None:
    with EventLog(tmp_path / "events.jsonl") as log:
        log.write(0.0, "start", robots=["ground", "aerial"])
        log.write(12.5, "deploy", position=np.array([1.0, 2.0, 0.0]))
    assert read_events(tmp_path / "events.jsonl") == [
        {"time_s": 0.0, "kind": "start", "robots": ["ground", "aerial"]},
        {"time_s": 12.5, "kind": "deploy", "position": [1.0, 2.0, 0.0]},
    ]


def test_killed_writer_leaves_every_written_event(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    script = (
        "import os, signal, sys; from pathlib import Path; from ground_station.export import EventLog\n"
        "log = EventLog(Path(sys.argv[1]))\n"
        "for step in range(100): log.write(step, 'step', value=step)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], env=os.environ | {"PYTHONPATH": root}, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert [event["value"] for event in read_events(path)] == list(range(100))


@given(cut=st.integers(0, 200))
def test_log_cut_anywhere_gives_a_prefix(tmp_path_factory: pytest.TempPathFactory, cut: int) -> None:
    path = tmp_path_factory.mktemp("log") / "events.jsonl"
    with EventLog(path) as log:
        for step in range(4):
            log.write(step, "step", text="müde")
    whole = read_events(path)
    data = path.read_bytes()[:cut]
    path.write_bytes(data)
    assert read_events(path) == whole[: data.count(b"\n")]


def test_reopened_log_drops_the_torn_line_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"time_s": 1.0, "kind": "a"}\n{"time_s": 2.0, "ki')
    with EventLog(path) as log:
        log.write(3.0, "c")
    assert [event["kind"] for event in read_events(path)] == ["a", "c"]


@pytest.mark.parametrize("line", ["{broken", "[1, 2]", '{"kind": "no time"}'])
def test_broken_line_in_the_middle_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"time_s": 1.0, "kind": "a"}\n' + line + '\n{"time_s": 2.0, "kind": "b"}\n')
    with pytest.raises(InputError, match=r"events\.jsonl:2"):
        read_events(path)


def test_log_in_an_absent_directory_is_the_users_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        EventLog(tmp_path / "absent" / "events.jsonl")
    with pytest.raises(InputError, match="cannot read"):
        read_events(tmp_path / "absent" / "events.jsonl")
