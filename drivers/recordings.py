"""Open any supported LiDAR recording by its suffix and contents."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path

from drivers.cloud_formats import SUFFIXES
from drivers.osf import open_osf
from drivers.packet_recordings import open_bag, open_pcap, open_rawlog
from drivers.rosbag import bag_folder
from drivers.scan_files import open_scan_files
from drivers.types import Recording
from onboard.core.errors import InputError
from onboard.core.lidar import lidar_model

KINDS = (".pcap", ".pcapng", ".rawlog", ".osf", ".db3", ".mcap", *SUFFIXES)


def open_recording(path: Path, sensor: str | None = None, rate_hz: float | None = None) -> Recording:
    """Open `path`; `sensor` is the nominal LiDAR's name, needed only where the files do not tell.

    `rate_hz`: so many scans a second, for point cloud files whatever their names tell.
    Raises InputError, one line, for a missing path, an empty file, an unknown kind, missing metadata, a
    sensor that contradicts the recording, and a recording without a single usable scan.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_file() and path.stat().st_size == 0:
        raise InputError(f"{path}: empty file")
    if sensor is not None:
        lidar_model(sensor)
    recording = _open(path, rate_hz)
    if sensor is not None and recording.model_name not in (None, sensor):
        raise InputError(
            f"{path}: {recording.sensor_name} maps as '{recording.model_name}', not as '{sensor}'"
        )
    first = next(recording.scans, None)
    if first is None:
        raise InputError(
            f"{path}: no usable scan inside ({recording.sensor_name}): empty, cut or wrong metadata"
        )
    return replace(
        recording, model_name=recording.model_name or sensor, scans=chain([first], recording.scans)
    )


def _open(path: Path, rate_hz: float | None) -> Recording:
    bag = bag_folder(path)
    if bag is None and (path.is_dir() or path.suffix in SUFFIXES):
        return open_scan_files(path, rate_hz)
    if rate_hz is not None:
        raise InputError(f"{path}: --rate is for point cloud files; packets tell their times themselves")
    if bag is not None:
        return open_bag(bag)
    match path.suffix:
        case ".rawlog":
            return open_rawlog(path)
        case ".osf":
            return open_osf(path)
        case ".pcap" | ".pcapng":
            return open_pcap(path)
        case other:
            raise InputError(
                f"{path}: unknown kind '{other}'; known: {', '.join(KINDS)}, a ROS 2 bag or a folder of scans"
            )
