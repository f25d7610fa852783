"""The parts of the exact codec: integer rays, order of the rays, predictions, training of the priors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from onboard.codec.exact import decode_exact, encode_exact
from onboard.codec.exact.codec import shipped_priors
from onboard.codec.exact.contexts import KNOWN_SIZES, SIZES, WEIGHT_SETS
from onboard.codec.exact.order import FIRST_SIDE, SIDE_FIELDS, coding_steps
from onboard.codec.exact.predict import (
    HIT_BITS,
    NONE,
    PREDICTIONS,
    SIDES,
    UNIT_BITS,
    floor_ratio,
    predict_ray,
)
from onboard.codec.exact.rays import DIRECTION_BITS, POSITION_BITS, cast_rays, integer_rotation
from onboard.codec.exact.training import make_prior_file, train_priors
from onboard.codec.priors import load_priors
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel

POSE = Pose.from_rpy(np.array([-3.07, 1.52, 41.2]), 0.3, -0.2, 2.7)
MODELS = (OS0_64, VLP_16)


def test_integer_rotation_is_the_rotation() -> None:
    assert np.abs(integer_rotation(POSE) / (1 << 30) - POSE.rotation).max() < 1e-6


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_integer_rays_are_the_rays(model: LidarModel) -> None:
    rays = cast_rays(model, POSE)
    expected = model.directions.reshape(-1, 3) @ POSE.rotation.T
    assert np.abs(rays.directions / (1 << DIRECTION_BITS) - expected).max() < 1e-5
    voxels = rays.home + rays.eye / (1 << POSITION_BITS)
    assert np.array_equal(rays.home, np.floor(POSE.position / 0.2))
    assert np.abs(voxels * 0.2 - POSE.position).max() < 1e-5


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_every_ray_has_its_turn_once_and_coded_neighbours(model: LidarModel) -> None:
    done = np.zeros((model.rows, model.columns), dtype=bool)
    for step in coding_steps(model):
        for row in range(step[0], model.rows, step[1]):
            for column in range(step[2], model.columns, step[3]):
                assert not done[row, column]
                near = step[FIRST_SIDE:].reshape(SIDES, SIDE_FIELDS)[:, :2]
                sides = [(row + r, (column + c) % model.columns) for r, c in near]
                inside = [(r, c) for r, c in sides if 0 <= r < model.rows]
                if step[4] > 0:
                    assert all(done[place] for place in inside)
                done[row, column] = True
    assert done.all()


def test_floor_ratio_is_exact() -> None:
    rng = np.random.default_rng(1)
    for numerator, denominator in zip(
        rng.integers(1, 1 << 52, 300), rng.integers(1, 1 << 20, 300), strict=True
    ):
        for n in (int(numerator), int(numerator) // int(denominator) * int(denominator), (1 << 38)):
            if n:
                assert floor_ratio(n, int(denominator)) == n // int(denominator)


def test_a_wall_is_predicted_from_any_two_of_its_rays() -> None:
    angles = OS0_64.azimuths_rad
    wall = 20.0 / np.cos(angles) * (1 << HIT_BITS)
    hits = np.full((OS0_64.rows, OS0_64.columns), NONE, dtype=np.int32)
    hits[:] = np.where(np.abs(angles) < 1.2, wall, NONE)
    out = np.empty(PREDICTIONS, dtype=np.int64)
    steps = coding_steps(OS0_64)
    step = next(i for i, s in enumerate(steps) if s[4] == 2 and s[5] == 2)
    column = 204
    predict_ray(hits, 16, column, steps, step, out)
    expected = wall[column] / (1 << (HIT_BITS - UNIT_BITS))
    for prediction in (out[4], out[5], out[8]):
        assert abs(prediction - expected) < 0.01 * expected
    assert abs(out[0] - expected) > 0.03 * expected


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_shipped_priors_fit_the_contexts(model: LidarModel, known: bool) -> None:
    priors = shipped_priors(model.name, known)
    assert priors.sizes == (SIZES + KNOWN_SIZES if known else SIZES)
    assert priors.weights.shape == (WEIGHT_SETS, len(priors.sizes) + 1)


def test_training_learns_its_scans(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    scans = [
        (np.float32(4.0) + rng.normal(0.0, 0.02, (VLP_16.rows, VLP_16.columns))).astype(np.float32)
        for _ in range(3)
    ]
    none = np.zeros((0, 3), dtype=np.int32)
    priors = train_priors([(scan, POSE, None) for scan in scans], VLP_16, known=False)
    assert (priors.models & np.uint32(1023)).max() <= 40
    path = make_prior_file([(scan, POSE, (none, none)) for scan in scans], VLP_16, tmp_path, known=True)
    assert path.name == "vlp-16-known.npz"
    assert load_priors(path).sizes == SIZES + KNOWN_SIZES
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("onboard.codec.exact.codec.shipped_priors", lambda name, known: priors)
        trained = encode_exact(scans[0], VLP_16, POSE)
        assert len(decode_exact(trained, VLP_16, POSE).occupied) > 100
    assert len(trained) < 0.8 * len(encode_exact(scans[0], VLP_16, POSE))
