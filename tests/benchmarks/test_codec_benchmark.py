"""The codec benchmark: its peers, its sets of scans, its tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import benchmarks.codec.__main__ as command
from benchmarks.codec import ours, report, scansets
from benchmarks.codec.measure import measure
from benchmarks.codec.ours import BUDGETS, QUALITIES, Ours
from benchmarks.codec.peers import float_coder
from benchmarks.codec.peers.fill import filled
from benchmarks.codec.peers.quadtree import SETTINGS, PrototypeQuadtree, PrototypeQuadtrees, cell_weights
from benchmarks.codec.protocol import Decoded
from benchmarks.codec.scansets import SENSORS, ScanSet, make_sets, scan_sets
from benchmarks.codec.summary import ALL, Point, bytes_at, comparisons, curve, points, unsafe26_at
from benchmarks.codec.worlds import OTHERS, Source, sources
from models.scans import PosedScan
from onboard.codec.metric import Similarity
from onboard.codec.voxels import voxelise
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel, Scan
from simulation.worlds import make_world

DATA = Path("nowhere")


def corridor_scans(model: LidarModel, count: int) -> ScanSet:
    """Scans inside a box of 12 x 4 x 3 m, 2 % dropouts."""
    rng = np.random.default_rng(3)
    directions = model.directions.astype(np.float64)
    images, places = [], []
    for _ in range(count):
        eye = rng.uniform([2.0, 1.0, 0.6], [10.0, 3.0, 2.4])
        with np.errstate(divide="ignore"):
            walls = np.where(directions > 0, np.array([12.0, 4.0, 3.0]) - eye, -eye) / directions
        ranges = walls.min(axis=2) + rng.normal(0.0, 0.02, walls.shape[:2])
        ranges[rng.random(ranges.shape) < 0.02] = 0.0
        images.append(ranges.astype(np.float32))
        places.append(eye)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    names = np.array([f"box-{k % 2}" if k % 3 else "cave-7" for k in range(count)])
    return ScanSet(model, np.stack(images), np.array(places), level, names)


class Raw:
    """All ranges as they are."""

    series, setting, header_bytes = "raw", "float32", 17

    def encode(self, item: PosedScan) -> bytes:
        return item.scan.ranges.tobytes()

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        ranges = np.frombuffer(data, np.float32).reshape(64, 512)
        return Decoded(pose, lambda: voxelise(ranges, OS0_64, pose))


def similarity(f1: float, unsafe26: float = 0.0) -> Similarity:
    return Similarity(0.5, f1, 0.9, 0.1, unsafe26, 0.0, 0.9)


def point(size: float, f1: float, series: str = "a", unsafe26: float = 0.0, world: str = ALL) -> Point:
    return Point(series, f"{size}", world, 3, size, size, similarity(f1, unsafe26), (1.0, 2.0), (1.0, 2.0))


@pytest.fixture(scope="module")
def small() -> dict[str, ScanSet]:
    return {sensor: corridor_scans(model, 6) for sensor, model in SENSORS.items()}


def test_the_range_coder_gives_back_every_bit():
    rng = np.random.default_rng(1)
    bits = (rng.random(4000) < np.repeat([0.02, 0.5, 0.9, 0.999], 1000)).astype(int)
    stream = np.zeros(2000, np.uint8)
    state = np.zeros(float_coder.STATE_WORDS, np.int64)

    def code(decoding: bool) -> list[int]:
        tables = np.full((2, 8), 0.5), np.zeros((2, 8)), np.full((1, 3), 0.5)
        found, last = [], 0
        for k, bit in enumerate(bits):
            contexts = np.array([k // 1000, 4 + last])
            given = 0 if decoding else int(bit)
            last = float_coder.code_bit(state, stream, decoding, given, *tables, 0, contexts, 255.0, 0.02)
            found.append(last)
        return found

    float_coder.start_encoding(state)
    code(False)
    length = float_coder.finish_encoding(state, stream)
    stream[length:] = 0
    float_coder.start_decoding(state, stream)
    assert code(True) == bits.tolist()
    assert length < 260, "1.75 kbit of information fit 220 bytes"


def test_holes_are_filled_from_both_sides():
    row = np.array([[4.0, 0.0, 4.4, 0.0, 0.0, 12.0, np.inf, 0.0], [0.0] * 8])
    image = filled(row, 20.0)
    assert image[0, 1] == pytest.approx(2 / (1 / 4.0 + 1 / 4.4))
    assert image[0, 3:5].tolist() == [4.4, 12.0]
    assert image[0, 6] == 20.0
    assert image[0, 7] == 20.0  # the row is a ring: 20 m on the left is as near as 4 m on the right
    assert (image[1] == 20.0).all()


def test_every_cell_weighs_one():
    scans = corridor_scans(VLP_16, 1)
    known = scans.ranges[0] > 0
    weight = cell_weights(filled(scans.ranges[0], 20.0), known, VLP_16, scans[0].pose)
    assert weight[~known].max() == 0.0
    occupied, _ = voxelise(scans.ranges[0], VLP_16, scans[0].pose)
    assert weight.sum() == pytest.approx(len(occupied))


@pytest.mark.parametrize("sensor", list(SENSORS))
def test_the_quadtree_gives_better_maps_for_more_bytes(small, sensor):
    scans = small[sensor]
    sizes, scores = [], []
    for setting in (SETTINGS[sensor][2], SETTINGS[sensor][-1]):
        samples = measure([PrototypeQuadtree(setting, scans.model, scans)], scans, lambda text: None)
        sizes.append(np.mean([sample.size_bytes for sample in samples]))
        scores.append(np.mean([sample.similarity.f1 for sample in samples]))
    assert sizes[0] < sizes[1]
    assert 0.7 < scores[0] < scores[1]
    assert scores[1] > 0.99


def test_the_quadtree_decodes_what_the_encoder_saw(small):
    scans = small["aerial"]
    codec = PrototypeQuadtree(SETTINGS["aerial"][-1], scans.model, scans)
    image = codec.image(codec.encode(scans[0]))
    wanted = filled(scans.ranges[0], 20.0)
    assert np.mean(np.abs(image - wanted) < 0.3) > 0.97


def test_far_rays_stay_far_at_every_step(small):
    """57 steps of 0.35 m are 19.95 m, which is no obstacle."""
    scans = small["aerial"]
    far = PosedScan(Scan(0.0, np.full((64, 512), np.inf, np.float32), OS0_64), scans[0].pose)
    for setting in SETTINGS["aerial"][2:7]:
        codec = PrototypeQuadtree(setting, OS0_64, scans)
        occupied, free = codec.decode(codec.encode(far), far.pose).maps()
        assert len(occupied) == 0
        assert len(free) > 100_000


def test_priors_make_scans_shorter(small):
    scans = small["aerial"]
    nothing = ScanSet(scans.model, scans.ranges[:0], scans.positions, scans.quaternions, scans.worlds)
    setting = SETTINGS["aerial"][3]
    lengths = [len(PrototypeQuadtree(setting, OS0_64, s).encode(scans[0])) for s in (scans, nothing)]
    assert lengths[0] < 0.9 * lengths[1]


def test_the_settings_are_those_of_the_published_tables(small):
    nothing = {
        s: ScanSet(x.model, x.ranges[:0], x.positions, x.quaternions, x.worlds) for s, x in small.items()
    }
    labels = {s: [c.setting for c in PrototypeQuadtrees().codecs(s, nothing[s])] for s in SENSORS}
    assert labels["aerial"][0] == "16x16 q0.4 tol0.4 th200"
    assert labels["aerial"][-1] == "8x8 q0.2 tol0.25 th0.3"
    assert labels["ground"][3] == "8x24 q0.35 tol0.4 th8"
    assert [len(found) for found in labels.values()] == [10, 8]


def test_our_codec_runs_at_every_quality_and_budget(small, monkeypatch):
    calls = []

    class Frame:
        pose = Pose.identity()

        def voxels(self, voxel_m: float) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((1, 3), np.int32), np.full((1, 3), voxel_m).astype(np.int32)

    monkeypatch.setattr(ours, "encode", lambda scan, pose, **options: calls.append(options) or b"12345")
    monkeypatch.setattr(ours, "decode", lambda data: Frame())
    codecs = Ours().codecs("aerial", small["aerial"])
    for codec in codecs:
        assert codec.decode(codec.encode(small["aerial"][0]), Pose.identity()).pose is Frame.pose
    fixed = [{"quality": quality, "codec": "quadtree"} for quality in QUALITIES]
    budgets = [{"budget_bytes": budget, "codec": "quadtree"} for budget in BUDGETS]
    assert calls == [*fixed, *budgets, {"codec": "exact"}]
    assert {codec.header_bytes for codec in codecs} == {0}


def test_measuring_counts_header_and_compares_maps(small):
    samples = measure([Raw()], small["aerial"], lambda text: None)
    assert len(samples) == 6
    assert {sample.size_bytes for sample in samples} == {64 * 512 * 4 + 17}
    assert {sample.similarity.f1 for sample in samples} == {1.0}
    assert samples[1].world == "box-1"
    assert min(sample.encode_ms for sample in samples) >= 0.0


def test_points_are_means_by_kind_of_world(small):
    found = points(measure([Raw()], small["aerial"], lambda text: None))
    assert [(p.world, p.scans) for p in found] == [(ALL, 6), ("cave", 2), ("box", 4)]
    assert found[0].similarity.occ_iou == 1.0
    assert found[0].encode_ms[0] <= found[0].encode_ms[1]


def test_curves_are_interpolated_in_log_bytes():
    line = [point(100, 0.8, unsafe26=0.2), point(400, 0.9, unsafe26=0.1), point(500, 0.89), point(900, 0.97)]
    assert bytes_at(line, 0.85) == pytest.approx(200.0)
    assert unsafe26_at(line, 0.85) == pytest.approx(0.15)
    assert bytes_at(line, 0.97) == pytest.approx(900.0)
    assert bytes_at(line, 0.98) is None
    assert bytes_at(line, 0.7) is None
    assert curve([point(9, 0.5, "b"), *line[::-1]], "a") == line


def test_series_are_compared_at_equal_quality():
    ours_line = [point(100, 0.8), point(200, 0.96)]
    peer_line = [point(200, 0.8, "b"), point(400, 0.96, "b"), point(10, 0.5, "b", world="cave")]
    found = {(item.world, item.f1): item for item in comparisons([*ours_line, *peer_line], "a", "b")}
    assert found[ALL, 0.95].ratio == pytest.approx(0.5)
    assert found[ALL, 0.99].ratio is None
    assert found["cave", 0.9].ours_bytes is None


def test_tables_and_plot(tmp_path):
    found = [point(100, 0.8), point(200, 0.96), point(150, 0.9, world="cave")]
    assert "| a 100 | 100 (100) | 0.8000 | 0.500 |" in report.main_table(found)
    assert "cave" not in report.main_table(found)
    assert "| a 150 | cave | 3 | 150 | 0.9000 | 0.0000 |" in report.world_table(found)
    assert "| all | 0.90 | 154 | - | - | 0.0000 | - |" in report.equal_table(comparisons(found, "a", "b"))
    report.draw({("aerial", "test"): found}, "aerial", tmp_path / "rd.png")
    assert (tmp_path / "rd.png").read_bytes().startswith(b"\x89PNG")


def test_splits_never_share_a_world():
    labels = {s: [source.label for source in sources(s, DATA, 60)] for s in ("test", "other", "dev", "train")}
    together = [label for found in labels.values() for label in found]
    assert len(set(together)) == len(together)
    assert set(labels["other"]) == set(OTHERS)
    assert sum(source.scans for source in sources("test", DATA, 60)) == 180
    with pytest.raises(InputError, match="unknown split"):
        sources("all", DATA, 60)


def test_scan_sets_are_kept_and_come_back(tmp_path, small):
    scans = small["aerial"]
    path = tmp_path / "cache" / "x.npz"
    scans.save(path)
    back = ScanSet.load(path, OS0_64)
    assert len(back) == 6
    assert np.array_equal(back.ranges, scans.ranges)
    assert np.array_equal(back[2].pose.position, scans.positions[2])
    assert back.kinds == ["cave", "box", "box", "cave", "box", "box"]
    with pytest.raises(InputError, match="os0-64, expected vlp-16"):
        ScanSet.load(path, VLP_16)


def test_sets_are_made_once_and_without_worlds_that_fail(tmp_path, monkeypatch):
    def broken() -> None:
        raise InputError("no roomy floor")

    worlds = [Source("building-3", lambda: make_world("building", 3), 2), Source("broken", broken, 2)]
    monkeypatch.setattr(scansets, "sources", lambda split, data, scans: worlds)
    told: list[str] = []
    made = scan_sets("test", data=DATA, cache=tmp_path, scans=2, report=told.append)
    assert made["ground"].worlds.tolist() == ["building-3"] * 2
    assert any("broken left out: no roomy floor" in text for text in told)
    monkeypatch.setattr(scansets, "sources", lambda split, data, scans: worlds[1:])
    again = scan_sets("test", data=DATA, cache=tmp_path, scans=2, report=told.append)
    assert np.array_equal(again["aerial"].ranges, made["aerial"].ranges)
    with pytest.raises(InputError, match="gave a scan"):
        make_sets("test", data=DATA, scans=2, report=told.append)


def test_the_command_writes_json_tables_and_plots(tmp_path, monkeypatch, small):
    class Raws:
        def codecs(self, sensor: str, learnt: ScanSet) -> list[Raw]:
            return [Raw()]

    monkeypatch.setattr(command, "scan_sets", lambda split, **options: small)
    monkeypatch.setattr(command, "FAMILIES", {"raw": Raws})
    (tmp_path / "images").mkdir()
    arguments = ["--out", str(tmp_path), "--sensors", "aerial", "--splits", "test", "--docs", str(tmp_path)]
    assert command.main(arguments) == 0
    results = json.loads((tmp_path / "codec.json").read_text())
    assert results["aerial test"]["points"][0]["similarity"]["f1"] == 1.0
    assert "## aerial, test" in (tmp_path / "codec.md").read_text()
    assert (tmp_path / "rd-aerial.png").is_file()
    page = (tmp_path / "codec_results.md").read_text()
    assert page.startswith("# Results")
    assert all(
        part in page for part in ("images/codec-aerial.png", "### aerial, test worlds", "At equal F1:")
    )
    assert (tmp_path / "images" / "codec-aerial.png").is_file()


def test_the_command_says_what_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(scansets, "sources", lambda split, data, scans: [])
    assert command.main(["--out", str(tmp_path), "--data", str(tmp_path / "none")]) == 2
    assert "no world of the split 'train'" in capsys.readouterr().err
