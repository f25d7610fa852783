"""Point cloud files of every kind, folders of them, and what is refused."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.cloud_formats import lzf_decompress, read_points
from drivers.recordings import open_recording
from drivers.scan_files import name_stamp_s, scan_files
from drivers.types import LidarScan, whole_scans
from onboard.core.errors import InputError

CLOUD = np.random.default_rng(3).normal(size=(150, 3)).astype(np.float32)


def pcd(kind: str, body: bytes) -> bytes:
    head = "# made by hand\nVERSION 0.7\nFIELDS intensity x y z\nSIZE 1 4 4 4\nTYPE U F F F\nCOUNT 1 1 1 1\n"
    return f"{head}WIDTH 150\nHEIGHT 1\nPOINTS 150\nDATA {kind}\n".encode() + body


def literal_lzf(plain: bytes) -> bytes:
    """The simplest LZF stream: literal runs only."""
    runs = [plain[i : i + 32] for i in range(0, len(plain), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def ply(encoding: str, body: bytes) -> bytes:
    head = f"ply\nformat {encoding} 1.0\ncomment x\nelement vertex 150\nproperty uchar red\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return (
        head + axes + "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode() + body


def vtk(encoding: str, body: bytes) -> bytes:
    return (
        f"# vtk DataFile Version 3.0\nscan\n{encoding}\nDATASET POLYDATA\nPOINTS 150 float\n".encode() + body
    )


def table(order: str) -> bytes:
    rows = np.zeros(150, dtype=[("i", "u1"), ("p", order + "f4", 3)])
    rows["p"] = CLOUD
    return rows.tobytes()


def text(prefix: str = "") -> bytes:
    return "\n".join(prefix + " ".join(repr(float(v)) for v in row) for row in CLOUD).encode()


FIELDS = bytes(150) + CLOUD.T.astype("<f4").tobytes()
PACKED = literal_lzf(FIELDS)
FILES = {
    "ascii.pcd": pcd("ascii", text("7 ")),
    "binary.pcd": pcd("binary", table("<")),
    "packed.pcd": pcd("binary_compressed", struct.pack("<II", len(PACKED), len(FIELDS)) + PACKED),
    "ascii.ply": ply("ascii", text("7 ")),
    "little.ply": ply("binary_little_endian", table("<")),
    "big.ply": ply("binary_big_endian", table(">")),
    "ascii.vtk": vtk("ASCII", text()),
    "binary.vtk": vtk("BINARY", CLOUD.astype(">f4").tobytes()),
    "kitti.bin": np.column_stack([CLOUD, np.ones(150)]).astype("<f4").tobytes(),
}


@pytest.mark.parametrize("name", FILES)
def test_every_kind_reads_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    np.testing.assert_array_equal(read_points(path), CLOUD)


@pytest.mark.parametrize("name", FILES)
def test_a_cut_file_is_one_clear_error(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name][: len(FILES[name]) // 2 + 1])
    with pytest.raises(InputError, match=name):
        read_points(path)


@given(junk=st.binary(max_size=300), suffix=st.sampled_from([".pcd", ".ply", ".vtk", ".bin", ".npy", ".npz"]))
def test_junk_never_raises_anything_else(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes, suffix: str
) -> None:
    path = tmp_path_factory.getbasetemp() / f"junk{suffix}"
    path.write_bytes(junk)
    with suppress(InputError):
        assert read_points(path).shape[1] == 3


def test_numpy_files(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.column_stack([CLOUD, CLOUD[:, :1]]))
    np.savez(tmp_path / "b.npz", colours=np.zeros(3), points=CLOUD)
    np.save(tmp_path / "flat.npy", np.zeros(9))
    np.testing.assert_array_equal(read_points(tmp_path / "a.npy"), CLOUD)
    np.testing.assert_array_equal(read_points(tmp_path / "b.npz"), CLOUD)
    with pytest.raises(InputError, match="shape"):
        read_points(tmp_path / "flat.npy")


def test_points_that_are_not_finite_are_dropped(tmp_path: Path) -> None:
    cloud = CLOUD.copy()
    cloud[3, 1], cloud[9, 0] = np.nan, np.inf
    np.save(tmp_path / "a.npy", cloud)
    assert len(read_points(tmp_path / "a.npy")) == 148


def test_lzf_back_references() -> None:
    assert lzf_decompress(bytes([2]) + b"abc" + bytes([0x80, 0x02]), 9) == b"abcabcabc"
    assert lzf_decompress(bytes([0]) + b"a" + bytes([0xE0, 0x05, 0x00]), 15) == b"a" * 15
    with pytest.raises(ValueError, match="before the start"):
        lzf_decompress(bytes([0x20, 0x05]), 3)
    with pytest.raises(ValueError, match="not 4"):
        lzf_decompress(bytes([2]) + b"abc", 4)


def test_a_folder_is_read_in_counting_order_without_what_is_no_scan(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        np.save(tmp_path / f"scan_{number}.npy", CLOUD + np.float32(number))
    np.save(tmp_path / "trajectory.npy", CLOUD)
    (tmp_path / "readme.txt").write_text("x")
    assert [file.name for file in scan_files(tmp_path)] == ["scan_1.npy", "scan_2.npy", "scan_10.npy"]
    recording = open_recording(tmp_path, "vlp-16")
    scans = list(recording.scans)
    assert (recording.total, recording.model_name) == (3, "vlp-16")
    np.testing.assert_array_equal(scans[2].points, CLOUD + np.float32(10))
    assert [round(scan.stamp_s, 3) for scan in scans] == [0.0, 0.1, 0.2]


def test_files_without_numbers_are_read_by_name(tmp_path: Path) -> None:
    for name in ("target.ply", "source.ply"):
        (tmp_path / name).write_bytes(FILES["little.ply"])
    assert [file.name for file in scan_files(tmp_path)] == ["source.ply", "target.ply"]


def test_what_cannot_be_opened_is_one_clear_line(tmp_path: Path, velodyne_pcap: Path) -> None:
    few, odd, empty = tmp_path / "few.npy", tmp_path / "film.mp4", tmp_path / "empty"
    np.save(few, CLOUD[:5])
    odd.write_text("film")
    empty.mkdir()
    (tmp_path / "zero.pcap").touch()
    (tmp_path / "text.pcap").write_text("no packets here " * 9)
    cases = [
        (tmp_path / "none.pcap", None, "no such file"),
        (odd, None, r"unknown kind '\.mp4'.*\.pcap"),
        (empty, None, "no scan inside"),
        (few, None, "no usable scan"),
        (tmp_path / "zero.pcap", None, "empty file"),
        (tmp_path / "text.pcap", None, "not a readable pcap"),
        (velodyne_pcap, "os0-64", "Velodyne VLP-16 maps as 'vlp-16', not as 'os0-64'"),
        (velodyne_pcap, "sonar", "unknown LiDAR 'sonar'"),
    ]
    for path, sensor, message in cases:
        with pytest.raises(InputError, match=message) as caught:
            open_recording(path, sensor)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "stamp_s"),
    [
        ("1650963664.25.pcd", 1650963664.25),
        ("cloud_1650963664_250000000.ply", 1650963664.25),
        ("1650963664250000000.bin", 1650963664.25),
        ("1650963664250000.bin", 1650963664.25),
        ("1650963664250.npy", 1650963664.25),
        ("1650963664.npy", 1650963664.0),
        ("0000000012.bin", None),
        ("scan_7.npy", None),
        ("16509636642.npy", None),
        ("cloud.ply", None),
    ],
)
def test_names_tell_times(name: str, stamp_s: float | None) -> None:
    assert name_stamp_s(Path(name)) == (None if stamp_s is None else pytest.approx(stamp_s, abs=1e-5))


@pytest.mark.parametrize(
    ("names", "rate_hz", "stamps_s"),
    [
        (["1650963665.0", "1650963664.5", "1650963664.0"], None, [1650963664.0, 1650963664.5, 1650963665.0]),
        (["1650963665.0", "1650963664.5", "1650963664.0"], 4.0, [0.0, 0.25, 0.5]),
        (["scan_9", "scan_10"], None, [0.0, 0.1]),
        (["1650963664.1", "1650963664.10"], None, [0.0, 0.1]),
    ],
    ids=["by name", "fixed rate", "no time told", "twice the same time"],
)
def test_scans_of_a_folder_are_timed(
    tmp_path: Path, names: list[str], rate_hz: float | None, stamps_s: list[float]
) -> None:
    for name in names:
        with (tmp_path / f"{name}.npy").open("wb") as file:
            np.save(file, CLOUD)
    scans = list(open_recording(tmp_path, rate_hz=rate_hz).scans)
    assert [scan.stamp_s for scan in scans] == pytest.approx(stamps_s, abs=1e-6)


def test_a_rate_is_for_point_cloud_files_only(tmp_path: Path) -> None:
    (tmp_path / "walk.pcap").write_bytes(b"not empty")
    with pytest.raises(InputError, match="--rate"):
        open_recording(tmp_path / "walk.pcap", "vlp-16", rate_hz=10.0)


@pytest.mark.parametrize(
    ("coverages", "kept"), [([0.1, 1.0, 0.9, 0.2], [1, 2]), ([0.1, 0.2, 0.15], [1]), ([], [])]
)
def test_slivers_are_dropped_unless_they_are_all_there_is(coverages: list[float], kept: list[int]) -> None:
    sweeps = [LidarScan(float(i), CLOUD, completeness=coverage) for i, coverage in enumerate(coverages)]
    assert [scan.stamp_s for scan in whole_scans(sweeps)] == kept
    assert not list(whole_scans([LidarScan(0.0, CLOUD[:9])]))


def test_real_files_open(lidar_data: Path) -> None:
    apartment = open_recording(lidar_data / "libpointmatcher_apartment")
    assert len(next(apartment.scans).points) == 24989
    assert apartment.total == 3
    hesai = next((lidar_data / "nebula_hesai_xt16").glob("*.pcd"))
    assert len(read_points(hesai)) == 26287
