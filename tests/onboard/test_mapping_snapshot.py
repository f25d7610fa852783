"""Stored maps: equal after a round trip, whole after a kill, refused when damaged."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.crc import crc32c
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.mapping.snapshot import from_bytes, load, save, to_bytes
from onboard.mapping.voxel_map import OWN, PEER, VoxelMap
from tests.onboard.mapping_scenes import room_scan

ROOM = np.array([-4.0, -3.1, -1.3]), np.array([5.3, 4.2, 2.4])


def add_scans(voxel_map: VoxelMap, steps: range) -> None:
    rng = np.random.default_rng(2)
    for step in steps:
        sensor = Pose.from_rpy(np.array([0.3 * step, 0.1, 0.0]), yaw_rad=0.2 * step)
        voxel_map.integrate(room_scan(sensor, *ROOM, rng, every=11), sensor.matrix(), source=step % 2)


def mixed_map() -> VoxelMap:
    """Own and peer scans, assumed free and occupied voxels."""
    voxel_map = VoxelMap(voxel_m=0.25, max_range_m=12.0, threads=2)
    add_scans(voxel_map, range(4))
    voxel_map.assume_free([-1.0] * 3, [9.0] * 3)
    voxel_map.assume_occupied([[1.0, 2.0, 0.5], [8.0, 8.0, 8.0]])
    return voxel_map


MIXED = to_bytes(mixed_map())


def assert_equal_maps(first: VoxelMap, second: VoxelMap) -> None:
    assert (first.voxel_m, first.max_range_m, first.version) == (
        second.voxel_m,
        second.max_range_m,
        second.version,
    )
    for source in (OWN, PEER, None):
        np.testing.assert_array_equal(first.known_masks(source), second.known_masks(source))
    stores = first.store, second.store
    assert stores[0].count == stores[1].count
    for name in ("block_keys", "log_odds", "planning_occupied", "planning_known", "changed"):
        arrays = [getattr(store, name)[: store.count] for store in stores]
        np.testing.assert_array_equal(*arrays)
    for name in ("occupied", "own_occupied"):
        np.testing.assert_array_equal(*(getattr(store, name)() for store in stores))


def test_round_trip_keeps_everything(tmp_path):
    original = mixed_map()
    save(original, tmp_path / "map.bin")
    restored = load(tmp_path / "map.bin")
    assert_equal_maps(original, restored)
    assert restored.workers.threads == 2
    assert [path.name for path in tmp_path.iterdir()] == ["map.bin"]


def test_restored_map_goes_on_like_the_original(tmp_path):
    original = mixed_map()
    save(original, tmp_path / "map.bin")
    restored = load(tmp_path / "map.bin")
    for voxel_map in (original, restored):
        add_scans(voxel_map, range(4, 8))
        voxel_map.assume_occupied([[-2.0, 2.0, 0.5]])
    assert_equal_maps(original, restored)
    points = np.random.default_rng(1).uniform(-5, 9, (500, 3))
    np.testing.assert_array_equal(original.status(points), restored.status(points))


def test_empty_and_large_maps_survive():
    assert_equal_maps(VoxelMap(), from_bytes(to_bytes(VoxelMap())))
    large = VoxelMap()
    large.assume_free([-40.0, -40, 0], [40.0, 40, 1.0])
    assert large.store.count > 2048
    assert_equal_maps(large, from_bytes(to_bytes(large)))


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_kill_while_saving_leaves_the_old_map(tmp_path, call):
    path = tmp_path / "map.bin"
    save(mixed_map(), path)
    before = path.read_bytes()
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "from onboard.mapping.snapshot import load, save\n"
        "path = Path(sys.argv[1]); voxel_map = load(path)\n"
        "voxel_map.assume_occupied([[3.0, 3.0, 3.0]])\n"
        "def die(*arguments):\n"
        "    os.truncate(path.with_name('.map.bin.tmp'), 1000)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        f"{'os.fsync' if call == 'fsync' else 'Path.replace'} = die\n"
        "save(voxel_map, path)\n"
    )
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], env=os.environ | {"PYTHONPATH": root}, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == before
    assert_equal_maps(load(path), mixed_map())
    save(load(path), path)  # the torn file of the killed run is in nobody's way
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.bin"]


def test_failed_saving_leaves_the_old_map_and_no_litter(tmp_path, monkeypatch):
    path = tmp_path / "map.bin"
    save(mixed_map(), path)
    before = path.read_bytes()

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"map\.bin: cannot write the map: No space left"):
        save(VoxelMap(), path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.bin"]


@given(place=st.integers(0, len(MIXED) - 1), bit=st.integers(0, 7))
def test_any_flipped_bit_is_noticed(place, bit):
    damaged = bytearray(MIXED)
    damaged[place] ^= 1 << bit
    with pytest.raises(InputError, match="map"):
        from_bytes(bytes(damaged))


@given(size=st.integers(0, len(MIXED) - 1))
def test_any_truncation_is_noticed(size):
    with pytest.raises(InputError, match="map"):
        from_bytes(MIXED[:size])


def test_damage_names_the_file_and_the_remedy(tmp_path):
    path = tmp_path / "map.bin"
    path.write_bytes(MIXED[:-200])
    with pytest.raises(InputError, match=r"map\.bin: a damaged map.*remove the file"):
        load(path)
    with pytest.raises(InputError, match=r"absent\.bin: cannot read"):
        load(tmp_path / "absent.bin")


def sealed(body: bytes) -> bytes:
    return body + crc32c(body).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"OTHERMAP" + MIXED[8:-4], "not a stored map"),
        (MIXED[:8] + b"\x09\x00" + MIXED[10:-4], "format 9"),
        (MIXED[:36] + b"\xff\xff\xff\xff" + MIXED[40:-4], "4294967295 blocks"),
        (MIXED[:36] + b"\x05\x00\x00\x00" + MIXED[40:-4], "another length"),
        (MIXED[:44] + b"no zlib stream", "damaged map"),
    ],
)
def test_wrong_contents_under_a_right_checksum(body, reason):
    with pytest.raises(InputError, match=reason):
        from_bytes(sealed(body))
