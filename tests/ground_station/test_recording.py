"""`map_recording` from scans of a simulated hall to the files on disk."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from ground_station.range_image import likely_model_name, to_range_image
from ground_station.recording import height_colours, map_recording
from ground_station.recording_session import LENGTH, RecordingSettings
from onboard.codec import Keyframe, decode
from onboard.core.config import LidarSettings
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import MODELS, OS0_64, VLP_16, Scan
from simulation.lidar import LidarSimulator
from simulation.scene import Scene

STEPS, STEP_M = 24, 0.2
SETTINGS = RecordingSettings(keyframe_translation_m=1.0, octomap=True, mesh=True)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of scans along a hall of 14 m x 8 m x 3.4 m with two pillars."""
    boxes = [((0, 0, 1.7), (14, 8, 3.4)), ((1, 2, 1.7), (0.8, 0.8, 3.2)), ((-2, -2, 0.6), (2, 1, 1.2))]
    meshes = [
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for at, size in boxes
    ]
    mesh = trimesh.util.concatenate(meshes)
    scene = Scene(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
    simulator = LidarSimulator(
        scene, LidarSettings(model="os0-64", mount_m=(0, 0, 0)), np.random.default_rng(2)
    )
    folder = tmp_path_factory.mktemp("drive")
    for step in range(STEPS):
        pose = Pose.from_rpy(np.array([-4.0 + STEP_M * step, 0.3, 1.0]), yaw_rad=0.01 * step)
        np.save(folder / f"scan_{step}.npy", simulator.scan(pose, 0.0)[0].points())
    return folder


@pytest.fixture(scope="module")
def mapped(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("out") / "hall"
    return out, map_recording(drive, None, out, settings=SETTINGS)


def keyframes(path: Path) -> Iterator[Keyframe]:
    data = path.read_bytes()
    while data:
        (length,) = LENGTH.unpack(data[:4])
        yield decode(data[4 : 4 + length])
        data = data[4 + length :]


def trajectory(path: Path) -> NDArray[np.float64]:
    return np.loadtxt(path / "trajectory.txt").reshape(-1, 8)


def test_the_numbers_are_those_of_the_drive(mapped: tuple[Path, dict[str, Any]]) -> None:
    out, metrics = mapped
    assert (metrics["scans"], metrics["lost_scans"], metrics["complete"]) == (STEPS, 0, True)
    assert metrics["model"] == "os0-64"
    assert metrics["duration_s"] == pytest.approx((STEPS - 1) * 0.1)
    assert metrics["path_m"] == pytest.approx((STEPS - 1) * STEP_M, rel=0.03)
    assert 14 * 8 * 3.4 < metrics["map_m3"] < 14.4 * 8.4 * 3.8  # the hall, and with its walls' voxels
    assert metrics["keyframe_map"]["occ_f1"] > 0.95
    assert metrics["keyframe_map"]["free_iou"] > 0.85
    assert metrics["keyframe_map"]["unsafe26"] < 0.02
    assert json.loads((out / "metrics.json").read_text()) == metrics


def test_the_trajectory_is_tum_and_follows_the_drive(mapped: tuple[Path, dict[str, Any]]) -> None:
    rows = trajectory(mapped[0])
    np.testing.assert_allclose(rows[:, 1], np.arange(STEPS) * STEP_M, atol=0.03)
    np.testing.assert_allclose(rows[:, 2:4], 0, atol=0.03)
    np.testing.assert_allclose(2 * np.arcsin(rows[:, 6]), 0.01 * np.arange(STEPS), atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1, atol=1e-5)


def test_the_keyframes_decode_and_keep_their_distance(mapped: tuple[Path, dict[str, Any]]) -> None:
    out, metrics = mapped
    frames = list(keyframes(out / "keyframes.bin"))
    assert metrics["keyframes"] == len(frames) >= 4
    assert metrics["keyframe_bytes"] == (out / "keyframes.bin").stat().st_size - LENGTH.size * len(frames)
    positions = np.array([frame.pose.position for frame in frames])
    gaps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert (gaps > 0.95).all()
    assert (gaps < 1.3).all()


def test_the_cloud_is_the_hall(mapped: tuple[Path, dict[str, Any]]) -> None:
    out, metrics = mapped
    cloud = trimesh.load(out / "map.ply")
    points = np.asarray(cloud.vertices)
    assert len(points) == metrics["occupied_voxels"]
    np.testing.assert_allclose(points.min(axis=0), (-3.0, -4.3, -1.0), atol=0.4)
    np.testing.assert_allclose(points.max(axis=0), (11.0, 3.7, 2.4), atol=0.4)
    low, high = points[:, 2] < -0.8, points[:, 2] > 2.2
    colours = np.asarray(cloud.colors)[:, :3].astype(int)
    assert np.abs(colours[low].mean(axis=0) - colours[high].mean(axis=0)).max() > 60


def test_the_mesh_lies_on_the_walls(mapped: tuple[Path, dict[str, Any]]) -> None:
    out, _ = mapped
    vertices = np.asarray(trimesh.load(out / "mesh.ply", process=False).vertices)
    walls = ((0, -3.0), (0, 11.0), (1, -4.3), (1, 3.7), (2, -1.0), (2, 2.4))
    for axis, place in walls:
        others = [k for k in range(3) if k != axis]
        middle = np.abs(vertices[:, others] - vertices[:, others].mean(axis=0)).max(axis=1) < 1.5
        near = np.abs(vertices[:, axis] - place) < 0.3
        assert (near & middle).sum() > 20
        assert np.abs(vertices[near & middle, axis] - place).mean() < 0.05


def test_the_octomap_has_all_voxels(mapped: tuple[Path, dict[str, Any]]) -> None:
    octomap = pytest.importorskip("pyoctomap", reason="needs pyoctomap to read the tree")
    out, metrics = mapped
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(out / "map.bt"))
    volumes = {True: 0.0, False: 0.0}
    for leaf in tree.begin_leafs():
        volumes[bool(tree.isNodeOccupied(leaf))] += leaf.getSize() ** 3
    assert volumes[True] == pytest.approx(metrics["occupied_voxels"] * 0.008)
    assert sum(volumes.values()) == pytest.approx(metrics["map_m3"])


def test_nothing_is_exported_unasked(drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "few"
    folder.mkdir()
    for step in range(2):
        (folder / f"scan_{step}.npy").symlink_to(drive / f"scan_{step}.npy")
    map_recording(folder, "os0-64", tmp_path / "out")
    assert not {"map.bt", "mesh.ply"} & {path.name for path in (tmp_path / "out").iterdir()}


def test_the_report_and_its_picture_are_there(mapped: tuple[Path, dict[str, Any]]) -> None:
    out, _ = mapped
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert "Map of drive" in (out / "report.html").read_text()


def test_progress_counts_every_scan(drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "short"
    folder.mkdir()
    for step in range(3):
        (folder / f"scan_{step}.npy").write_bytes((drive / f"scan_{step}.npy").read_bytes())
    calls: list[tuple[int, int | None]] = []
    map_recording(folder, "os0-64", tmp_path / "out", lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_an_interrupted_run_leaves_readable_results(drive: Path, tmp_path: Path) -> None:
    def stop(done: int, total: int | None) -> None:
        if done == 7:
            raise KeyboardInterrupt

    metrics = map_recording(drive, None, tmp_path, stop, SETTINGS)
    assert (metrics["complete"], metrics["scans"]) == (False, 7)
    assert len(trajectory(tmp_path)) == 7
    assert len(list(keyframes(tmp_path / "keyframes.bin"))) == metrics["keyframes"] == 2
    assert json.loads((tmp_path / "metrics.json").read_text())["complete"] is False
    assert (tmp_path / "report.html").is_file()


def test_a_recording_that_breaks_in_the_middle_is_mapped_until_there(drive: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "broken", tmp_path / "out"
    folder.mkdir()
    for step in range(4):
        (folder / f"scan_{step}.npy").write_bytes((drive / f"scan_{step}.npy").read_bytes())
    (folder / "scan_3.npy").write_bytes(b"torn")
    with pytest.raises(InputError, match=r"scan_3\.npy"):
        map_recording(folder, None, out)
    assert len(trajectory(out)) == 3
    assert json.loads((out / "metrics.json").read_text())["complete"] is False


def test_a_reference_tells_how_far_the_trajectory_is_off(drive: Path, tmp_path: Path) -> None:
    """The true poses, in a frame of their own, at half the speed of the default: two scans every 0.4 s."""
    turned = Pose.from_rpy(np.array([7.0, -3.0, 2.0]), 0.1, -0.2, 1.3)
    lines = ["# stamp x y z qx qy qz qw"]
    for step in range(STEPS):
        true = Pose.from_rpy(np.array([STEP_M * step, 0.0, 0.0]), yaw_rad=0.01 * step)
        pose = turned.compose(true)
        numbers = " ".join(f"{v:.9f}" for v in (*pose.position, *pose.quaternion))
        lines.append(f"{0.2 * step + 0.004:.3f} {numbers}")
    (tmp_path / "truth.txt").write_text("\n".join(lines) + "\n")
    settings = RecordingSettings(rate_hz=5.0)
    metrics = map_recording(drive, None, tmp_path / "out", None, settings, tmp_path / "truth.txt")
    errors = metrics["reference"]
    assert errors["poses"] == STEPS
    assert errors["path_m"] == pytest.approx((STEPS - 1) * STEP_M, abs=1e-6)
    assert 0.0 < errors["ate_m"] < 0.03
    assert errors["drift_percent"] < 1.0
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["reference"] == errors


def test_a_reference_of_another_time_is_an_error_after_the_map_is_written(
    drive: Path, tmp_path: Path
) -> None:
    (tmp_path / "truth.txt").write_text("100 0 0 0 0 0 0 1\n101 1 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"no stamps in common"):
        map_recording(drive, None, tmp_path / "out", reference=tmp_path / "truth.txt")
    assert len(trajectory(tmp_path / "out")) == STEPS


def test_a_scan_that_fits_nowhere_is_counted_and_left_out(drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "odd"
    folder.mkdir()
    for step in (0, 1, 3):
        (folder / f"scan_{step}.npy").write_bytes((drive / f"scan_{step}.npy").read_bytes())
    noise = np.random.default_rng(1).uniform(-30, 30, size=(5000, 3)).astype(np.float32)
    np.save(folder / "scan_2.npy", noise)
    metrics = map_recording(folder, None, tmp_path / "out")
    assert (metrics["scans"], metrics["lost_scans"]) == (4, 1)
    assert len(trajectory(tmp_path / "out")) == 3


def test_what_cannot_be_mapped_is_one_clear_error(drive: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with pytest.raises(InputError, match="taken"):
        map_recording(drive, None, taken)
    far = tmp_path / "far.npy"
    np.save(far, np.full((200, 3), 900.0, dtype=np.float32))
    with pytest.raises(InputError, match=r"far\.npy"):
        map_recording(far, None, tmp_path / "out")
    with pytest.raises(InputError, match="no such file"):
        map_recording(tmp_path / "none.pcap", None, tmp_path / "out")


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_a_scan_survives_the_way_through_a_cloud(model: Any) -> None:
    rng = np.random.default_rng(4)
    ranges = rng.uniform(1, 19, size=(model.rows, model.columns)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.2] = 0
    image = to_range_image(Scan(0.0, ranges, model).points(), model, 3.5)
    assert image.stamp_s == 3.5
    np.testing.assert_allclose(image.ranges, ranges, atol=1e-4)


def test_a_pixel_keeps_its_nearest_return_and_others_stay_unknown() -> None:
    ahead = np.array([[8.0, 0.01, 0.0], [5.0, 0.005, 0.0], [0.0, 0.0, 9.0], [0.05, 0, 0], [500.0, 3, 0]])
    image = to_range_image(ahead.astype(np.float32), OS0_64, 0.0).ranges
    assert np.count_nonzero(image) == 1
    assert image.max() == pytest.approx(5.0, abs=1e-3)


def test_points_outside_the_beams_are_left_out() -> None:
    elevations = np.deg2rad([15.9, 16.1, -15.9, -16.1])
    points = np.stack([5 * np.cos(elevations), np.zeros(4), 5 * np.sin(elevations)], axis=-1).astype(
        np.float32
    )
    image = to_range_image(points, VLP_16, 0.0).ranges
    rows = np.flatnonzero(image.any(axis=1))
    assert rows.tolist() == [0, 15]
    assert np.count_nonzero(image) == 2


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_the_likely_model_is_told_by_the_view(model: Any) -> None:
    cloud = Scan(0.0, np.full((model.rows, model.columns), 4.0, dtype=np.float32), model).points()
    assert likely_model_name(cloud) == model.name


def test_height_colours_run_from_blue_to_red() -> None:
    colours = height_colours(np.linspace(0, 5, 100, dtype=np.float32)).astype(int)
    assert colours[0, 2] > colours[0, 1]
    assert colours[-1, 0] > 2 * colours[-1, 2]
    assert height_colours(np.zeros(0, dtype=np.float32)).shape == (0, 3)


def test_real_recordings_have_their_known_motion(tmp_path: Path) -> None:
    default = Path(__file__).parents[2].parent / "shared" / "data"
    lidar = Path(os.environ.get("MARSUPIAL_DATA", default)) / "lidar"
    if not lidar.is_dir():
        pytest.skip(f"no public recordings at {lidar}; set MARSUPIAL_DATA")
    pcaps = lidar / "ouster_sdk_tests" / "pcaps"
    map_recording(pcaps / "OS-1-128_v2.3.0_1024x10_lb_n3.pcap", None, tmp_path / "street")
    true = np.loadtxt(pcaps / "OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(trajectory(tmp_path / "street")[:, 1:4], true[:, :, 3], atol=0.03)
    pair = lidar / "small_gicp_pair"
    map_recording(pair, "os0-64", tmp_path / "pair")
    target_source = Pose.from_matrix(np.loadtxt(pair / "T_target_source.txt"))
    moved = trajectory(tmp_path / "pair")[1, 1:4]
    np.testing.assert_allclose(moved, target_source.inverse().position, atol=0.03)
