"""Scans and keyframes as files: what is read, what is refused, and what comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.cloud_formats import read_points
from ground_station.codec_files import DECODED_SUFFIXES, read_keyframe, read_scans, write_decoded
from ground_station.export import write_ply
from onboard.codec import decode, encode
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, Scan

RANGES = np.full((16, 1800), 4.0, np.float32)
POSE = Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0, 0.0]))


def saved(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def test_one_scan_with_its_pose(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npz", ranges=RANGES, position=POSE.position, quaternion=POSE.quaternion)
    (item,) = read_scans(path)
    assert item.scan.model is VLP_16
    assert item.scan.ranges.dtype == np.float32
    assert (item.scan.ranges == 4).all()
    assert item.pose.position.tolist() == [1, 2, 3]
    assert item.pose.quaternion.tolist() == [0, 0, 1, 0]


def test_a_set_of_scans_keeps_each_pose(tmp_path: Path) -> None:
    positions = np.arange(9.0).reshape(3, 3)
    path = saved(
        tmp_path / "a.npz",
        ranges=np.stack([RANGES] * 3),
        position=positions,
        quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)),
        model="vlp-16",
    )
    assert [item.pose.position.tolist() for item in read_scans(path, "vlp-16")] == positions.tolist()


def test_what_has_no_pose_stands_at_the_origin(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", RANGES.astype(np.float64))
    for path in (tmp_path / "a.npy", saved(tmp_path / "b.npz", ranges=RANGES)):
        (item,) = read_scans(path)
        assert not item.pose.position.any()
        assert item.pose.quaternion.tolist() == [0, 0, 0, 1]


def test_a_cloud_is_projected(tmp_path: Path) -> None:
    points = Scan(0.0, np.full((64, 512), 3.0, np.float32), OS0_64).points()
    write_ply(tmp_path / "a.ply", points, np.zeros(points.shape, np.uint8))
    (item,) = read_scans(tmp_path / "a.ply", "os0-64")
    assert item.scan.model is OS0_64
    np.testing.assert_allclose(item.scan.ranges, 3.0, atol=1e-5)
    with pytest.raises(InputError, match=r"a\.ply: a point cloud needs --sensor: vlp-16 or os0-64"):
        read_scans(tmp_path / "a.ply")


def test_a_cloud_that_the_sensor_cannot_see_is_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", np.array([[0.0, 0.0, 9.0]] * 30), np.zeros((30, 3), np.uint8))
    with pytest.raises(InputError, match=r"a\.ply: no point"):
        read_scans(tmp_path / "a.ply", "vlp-16")


@pytest.mark.parametrize(
    ("arrays", "why"),
    [
        ({"points": RANGES}, "no array 'ranges'"),
        ({"ranges": RANGES[0]}, r"ranges \(1800,\); expected"),
        ({"ranges": RANGES[:, :7]}, "images of 16 x 7; expected 16 x 1800"),
        ({"ranges": np.zeros((0, 16, 1800))}, "ranges"),
        ({"ranges": RANGES, "position": np.zeros(2)}, "position"),
        ({"ranges": RANGES, "quaternion": np.zeros((2, 4))}, "quaternion"),
        ({"ranges": np.array(["x"])}, "not a readable npz"),
    ],
)
def test_npz_files_that_are_no_scans(tmp_path: Path, arrays: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=rf"a\.npz: .*{why}"):
        read_scans(saved(tmp_path / "a.npz", **arrays))


def test_a_sensor_that_contradicts_the_image(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npz", ranges=RANGES)
    with pytest.raises(InputError, match=r"16 x 1800; expected 64 x 512 \(os0-64\)"):
        read_scans(path, "os0-64")


@pytest.mark.parametrize(("name", "data"), [("a.npz", b"PK\x03\x04"), ("a.npy", b""), ("a.pcd", b"no")])
def test_broken_files_are_named(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=name):
        read_scans(tmp_path / name, "vlp-16")


def test_names_that_are_no_scans(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.txt: not a scan"):
        read_scans(tmp_path / "a.txt")
    with pytest.raises(InputError, match=r"a\.npz: no such file"):
        read_scans(tmp_path / "a.npz")


@pytest.mark.parametrize("suffix", DECODED_SUFFIXES)
def test_what_was_decoded_can_be_read_again(tmp_path: Path, suffix: str) -> None:
    keyframe = decode(encode(Scan(0.0, RANGES, VLP_16), POSE))
    path = tmp_path / f"a{suffix}"
    write_decoded(path, keyframe)
    if suffix == ".ply":
        points = read_points(path)
        local = (points - keyframe.pose.position) @ keyframe.pose.rotation
        np.testing.assert_allclose(np.linalg.norm(local, axis=1), keyframe.ranges.ravel(), atol=1e-4)
        return
    (item,) = read_scans(path)
    np.testing.assert_array_equal(item.scan.ranges, keyframe.ranges)
    assert item.pose.position.tolist() == ([1, 2, 3] if suffix == ".npz" else [0, 0, 0])


def test_keyframe_files(tmp_path: Path) -> None:
    path = tmp_path / "a.mkf"
    data = encode(Scan(0.0, RANGES, VLP_16), POSE)
    path.write_bytes(data)
    assert read_keyframe(path).model is VLP_16
    path.write_bytes(data[:-1])
    with pytest.raises(InputError, match=r"a\.mkf: keyframe: checksum"):
        read_keyframe(path)
    with pytest.raises(InputError, match="cannot read it"):
        read_keyframe(tmp_path)
    with pytest.raises(InputError, match=r"b\.txt: end the name in"):
        write_decoded(tmp_path / "b.txt", decode(data))
