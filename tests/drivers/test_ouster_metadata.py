"""Metadata of an Ouster from files and from the sensor's HTTP API."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

from drivers.ouster_metadata import fetch_metadata, load_metadata, read_metadata
from onboard.core.errors import InputError
from simulation.ouster_packets import SimulatedOuster


class Api(BaseHTTPRequestHandler):
    """A sensor's HTTP API, of new or old firmware."""

    answers: ClassVar[dict[str, bytes]]

    def do_GET(self) -> None:
        body = self.answers.get(self.path)
        self.send_response(404 if body is None else 200)
        self.end_headers()
        self.wfile.write(body or b"")

    def log_message(self, *_: object) -> None:
        """Nothing to the terminal."""


@pytest.fixture
def api() -> Iterator[tuple[str, type[Api]]]:
    handler = type("OneApi", (Api,), {"answers": {}})
    server = HTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"127.0.0.1:{server.server_port}", handler
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize("path", ["/api/v1/sensor/metadata", "/api/v1/sensor/cmd/get_metadata"])
def test_a_sensor_is_asked(api: tuple[str, type[Api]], path: str) -> None:
    host, handler = api
    handler.answers[path] = SimulatedOuster().metadata().encode()
    info = load_metadata(None, host)
    assert (info.prod_line, info.h, info.w) == ("OS-0-64", 64, 512)


def test_a_file_goes_before_the_sensor(tmp_path: Path) -> None:
    path = tmp_path / "os0.json"
    path.write_text(SimulatedOuster().metadata())
    assert load_metadata(path, "203.0.113.1").sn == SimulatedOuster().info.sn


@pytest.mark.parametrize(
    "answer", [None, b"\xff\xfe", b"[]", b"no JSON"], ids=["404", "bytes", "list", "text"]
)
def test_a_host_that_is_no_sensor_is_named(api: tuple[str, type[Api]], answer: bytes | None) -> None:
    host, handler = api
    if answer is not None:
        handler.answers["/api/v1/sensor/metadata"] = answer
    with pytest.raises(InputError, match=f"{host}: no metadata from the sensor .*set 'metadata'"):
        fetch_metadata(host)


def test_neither_file_nor_sensor_says_what_to_set() -> None:
    with pytest.raises(InputError, match="set 'metadata' to the sensor's JSON file or 'sensor_host'"):
        load_metadata(None, None)


def test_files_that_are_none_are_named(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    with pytest.raises(InputError, match=r"wrong\.json: not the metadata of an Ouster"):
        read_metadata(wrong)
    with pytest.raises(InputError, match=r"none\.json: not a readable"):
        read_metadata(tmp_path / "none.json")


def test_every_published_metadata_file_loads_or_is_refused(lidar_data: Path) -> None:
    loaded = 0
    for path in sorted((lidar_data / "ouster_sdk_tests" / "metadata").glob("*.json")):
        with contextlib.suppress(InputError):
            loaded += read_metadata(path).h in (16, 32, 64, 128)
    # the SDK refuses the other three, whose sensors have fewer beams than rows
    assert loaded == 23
