"""Scans and keyframes as files: range images, posed scan sets and clouds in; npz, npy or PLY out."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.cloud_formats import READERS, read_points
from ground_station.export import write_bytes, write_ply
from ground_station.range_image import to_range_image
from onboard.codec import Keyframe, decode
from onboard.core.errors import InputError, WireError
from onboard.core.geometry import Pose
from onboard.core.lidar import MODELS, LidarModel, Scan, lidar_model

SCAN_SUFFIXES = (".npz", ".npy", *READERS)
DECODED_SUFFIXES = (".npz", ".npy", ".ply")
_UNTURNED = (0.0, 0.0, 0.0, 1.0)
_GREY = 160


@dataclass(frozen=True, eq=False)
class PosedScan:
    """A scan and the pose of its LiDAR in the map frame."""

    scan: Scan
    pose: Pose


def read_scans(path: Path, sensor: str | None = None) -> list[PosedScan]:
    """The scans of a file; those without a pose stand at the origin.

    npz: `ranges` (H, W) or (N, H, W) in metres and, optionally, `position` and `quaternion` (xyzw), one each
    or N; npy: such ranges alone; a point cloud is projected into the range image of `sensor`. Raises
    InputError, naming the file, for anything else.
    """
    if path.suffix not in SCAN_SUFFIXES:
        raise InputError(f"{path}: not a scan; expected a file ending in {', '.join(SCAN_SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.suffix in READERS:
        return [PosedScan(_projected(path, sensor), Pose.identity())]
    arrays = _load(path)
    images = _images(path, arrays)
    model = _model_of(path, images, sensor)
    positions = _rows(path, arrays, "position", (0.0, 0.0, 0.0), len(images))
    quaternions = _rows(path, arrays, "quaternion", _UNTURNED, len(images))
    return [
        PosedScan(Scan(0.0, image, model), Pose(position, quaternion))
        for image, position, quaternion in zip(images, positions, quaternions, strict=True)
    ]


def read_keyframe(path: Path) -> Keyframe:
    """The keyframe in a file. Raises InputError, naming the file, where there is none."""
    try:
        return decode(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read it: {error.strerror}") from error
    except WireError as error:
        raise InputError(f"{path}: {error}") from error


def check_decoded_suffix(path: Path) -> None:
    """Raise InputError for a name that `write_decoded` cannot serve."""
    if path.suffix not in DECODED_SUFFIXES:
        raise InputError(f"{path}: end the name in {', '.join(DECODED_SUFFIXES)}")


def write_decoded(path: Path, keyframe: Keyframe) -> None:
    """npz as `read_scans` reads it, npy the ranges, ply the returns in the map frame. Raises InputError."""
    check_decoded_suffix(path)
    if path.suffix == ".ply":
        local = Scan(0.0, keyframe.ranges, keyframe.model).points()
        points = local @ keyframe.pose.rotation.T + keyframe.pose.position
        write_ply(path, points, np.full(points.shape, _GREY, dtype=np.uint8))
    else:
        write_bytes(path, _packed(keyframe, path.suffix))


def _packed(keyframe: Keyframe, suffix: str) -> bytes:
    stream = io.BytesIO()
    if suffix == ".npy":
        np.save(stream, keyframe.ranges)
    else:
        np.savez_compressed(
            stream,
            ranges=keyframe.ranges,
            position=keyframe.pose.position,
            quaternion=keyframe.pose.quaternion,
            model=np.array(keyframe.model.name),
        )
    return stream.getvalue()


def _projected(path: Path, sensor: str | None) -> Scan:
    if sensor is None:
        raise InputError(f"{path}: a point cloud needs --sensor: {' or '.join(MODELS)}")
    scan = to_range_image(read_points(path), lidar_model(sensor), 0.0)
    if not scan.ranges.any():
        raise InputError(f"{path}: no point of it lies in the view of {sensor}")
    return scan


def _load(path: Path) -> dict[str, NDArray[np.float64]]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"ranges": loaded.astype(np.float64)}
        with loaded:
            wanted = {"ranges", "position", "quaternion"} & set(loaded.files)
            return {name: loaded[name].astype(np.float64) for name in wanted}
    except (OSError, ValueError, EOFError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable {path.suffix[1:]} file ({error})") from error


def _images(path: Path, arrays: dict[str, NDArray[np.float64]]) -> NDArray[np.float32]:
    if "ranges" not in arrays:
        raise InputError(f"{path}: no array 'ranges' inside")
    ranges = arrays["ranges"].astype(np.float32)
    if ranges.ndim not in (2, 3) or not ranges.size:
        raise InputError(f"{path}: ranges {ranges.shape}; expected (H, W) or (N, H, W)")
    return ranges.reshape(-1, *ranges.shape[-2:])


def _model_of(path: Path, images: NDArray[np.float32], sensor: str | None) -> LidarModel:
    """The LiDAR whose image has this shape, which `sensor` must agree with."""
    shapes = {(model.rows, model.columns): model for model in MODELS.values()}
    model = shapes.get(images.shape[1:])
    if model is None or (sensor is not None and model is not lidar_model(sensor)):
        wanted = [m for m in MODELS.values() if sensor in (None, m.name)]
        expected = ", ".join(f"{m.rows} x {m.columns} ({m.name})" for m in wanted)
        raise InputError(f"{path}: images of {images.shape[1]} x {images.shape[2]}; expected {expected}")
    return model


def _rows(
    path: Path,
    arrays: dict[str, NDArray[np.float64]],
    name: str,
    default: tuple[float, ...],
    count: int,
) -> NDArray[np.float64]:
    values = arrays.get(name, np.broadcast_to(np.array(default), (count, len(default))))
    if values.shape == (len(default),) and count == 1:
        values = values[None]
    if values.shape != (count, len(default)):
        raise InputError(f"{path}: {name} {values.shape}; expected {(count, len(default))}")
    return values
