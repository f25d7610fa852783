"""Recordings for the tests of the drivers: made on the spot, or real ones beside the checkout."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest
from made_recordings import PACKETS_PER_TURN, velodyne_packet, write_pcap


@pytest.fixture(scope="session")
def lidar_data() -> Path:
    """Public LiDAR recordings beside the checkout."""
    default = Path(__file__).parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("MARSUPIAL_DATA", default)) / "lidar"
    if not folder.is_dir():
        pytest.skip(f"no public recordings at {folder}; set MARSUPIAL_DATA")
    return folder


@pytest.fixture
def velodyne_pcap(tmp_path: Path) -> Path:
    """Three turns and a quarter."""
    turns = round(3.3 * PACKETS_PER_TURN)
    return write_pcap(tmp_path / "drive.pcap", [velodyne_packet(n) for n in range(turns)])


@pytest.fixture
def rawlog(tmp_path: Path) -> Path:
    """One turn of packets between other bytes, block headers among them, as MRPT writes them."""
    packets = b"".join(velodyne_packet(n) for n in range(PACKETS_PER_TURN))
    path = tmp_path / "walk.rawlog"
    path.write_bytes(gzip.compress(b"CObservation\xff\xee\x00" * 9 + packets + b"\xff\xee calibration"))
    return path
