"""The prototype quadtree codec as a peer: the settings of its tables, priors from training scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.codec.peers.fill import filled
from benchmarks.codec.peers.float_coder import Bytes, Floats
from benchmarks.codec.peers.quadtree_kernel import CONTEXTS, FAMILIES, FAR_M, MIXERS, run
from benchmarks.codec.protocol import Codec, Decoded
from benchmarks.codec.scansets import ScanSet
from models.scans import PosedScan
from onboard.codec.voxels import VOXEL_M, voxelise
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

HEADER_BYTES = 17
LEARNING_LIMIT, LEARNING_RATE = 255.0, 0.002
PRIOR_COUNT, CODING_LIMIT, CODING_RATE = 12.0, 255.0, 0.01
"""The published tables do not say these; chosen on development scans, in favour of this peer."""
_STREAM_BYTES = 1 << 17


@dataclass(frozen=True)
class Setting:
    """Lattice and splits (rows, columns), range step, tolerance and threshold of a split (0.2 m cells)."""

    lattice: tuple[int, int]
    splits: tuple[tuple[int, int], ...]
    step_m: float
    tolerance_m: float
    threshold: float

    @property
    def label(self) -> str:
        tall, wide = self.lattice
        return f"{tall}x{wide} q{self.step_m:g} tol{self.tolerance_m:g} th{self.threshold:g}"


_FINE = (
    (0.4, 0.4, 64.0),
    (0.4, 0.4, 32.0),
    (0.4, 0.4, 16.0),
    (0.35, 0.4, 8.0),
    (0.3, 0.35, 4.0),
    (0.3, 0.3, 2.0),
    (0.25, 0.25, 1.0),
    (0.2, 0.25, 0.3),
)
_HALVES = ((2, 2),) * 3
SETTINGS = {
    "aerial": (
        *(Setting((16, 16), (*_HALVES, (2, 2)), 0.4, 0.4, threshold) for threshold in (200.0, 100.0)),
        *(Setting((8, 8), _HALVES, *values) for values in _FINE),
    ),
    "ground": tuple(Setting((8, 24), (*_HALVES, (1, 3)), *values) for values in _FINE),
}


@dataclass(eq=False)
class Model:
    """State of the context mixing: probabilities and counts (K, M), mixer weights (S, K + 1)."""

    probabilities: Floats
    counts: Floats
    weights: Floats

    @classmethod
    def fresh(cls) -> Model:
        weights = np.full((MIXERS, FAMILIES + 1), 1.4 / FAMILIES)
        weights[:, -1] = 0.0
        return cls(np.full((FAMILIES, CONTEXTS), 0.5), np.zeros((FAMILIES, CONTEXTS)), weights)

    def copied(self) -> Model:
        return Model(self.probabilities.copy(), self.counts.copy(), self.weights.copy())


class PrototypeQuadtree:
    """One setting with its priors. Holes are filled before coding; they weigh nothing."""

    series = "prototype_quadtree"
    header_bytes = HEADER_BYTES

    def __init__(self, setting: Setting, model: LidarModel, learnt: ScanSet) -> None:
        self.setting = setting.label
        self._values = setting
        self._model = model
        self._prior = self._learn(learnt)

    def encode(self, item: PosedScan) -> bytes:
        stream = np.zeros(_STREAM_BYTES, dtype=np.uint8)
        length, _ = self._run(self._prior.copied(), item, stream, CODING_LIMIT, CODING_RATE)
        return stream[:length].tobytes()

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        """What rounds to the last step is far: else every far ray ends in an obstacle at 57 x 0.35 m."""
        image = self.image(data)
        step_m = self._values.step_m
        image[image > round(FAR_M / step_m) * step_m - 1e-6] = np.inf
        return Decoded(pose, lambda: voxelise(image, self._model, pose))

    def image(self, data: bytes) -> Floats:
        """The (H, W) ranges of a coded scan."""
        stream = np.zeros(len(data) + 64, dtype=np.uint8)
        stream[: len(data)] = np.frombuffer(data, dtype=np.uint8)
        nothing = np.zeros((self._model.rows, self._model.columns))
        return self._kernel(self._prior.copied(), nothing, nothing, stream, True, CODING_LIMIT, CODING_RATE)[
            1
        ]

    def _learn(self, learnt: ScanSet) -> Model:
        """Contexts after coding all training scans; their counts are cut so that they go on adapting."""
        prior = Model.fresh()
        stream = np.zeros(_STREAM_BYTES, dtype=np.uint8)
        for index in range(len(learnt)):
            self._run(prior, learnt[index], stream, LEARNING_LIMIT, LEARNING_RATE)
        prior.counts = np.minimum(prior.counts, PRIOR_COUNT)
        return prior

    def _run(
        self, model: Model, item: PosedScan, stream: Bytes, limit: float, rate: float
    ) -> tuple[int, Floats]:
        ranges = filled(item.scan.ranges, FAR_M)
        weight = cell_weights(ranges, item.scan.ranges > 0, self._model, item.pose)
        return self._kernel(model, ranges, weight, stream, False, limit, rate)

    def _kernel(
        self,
        model: Model,
        ranges: Floats,
        weight: Floats,
        stream: Bytes,
        decoding: bool,
        limit: float,
        rate: float,
    ) -> tuple[int, Floats]:
        values = self._values
        splits = np.array(values.splits, dtype=np.int64)
        steps = (values.step_m, values.tolerance_m, values.threshold)
        state = (model.probabilities, model.counts, model.weights)
        length, image = run(
            ranges, weight, values.lattice, splits, *steps, stream, decoding, *state, limit, rate
        )
        return int(length), image


def cell_weights(ranges: Floats, known: NDArray[np.bool_], model: LidarModel, pose: Pose) -> Floats:
    """(H, W): each pixel counts 1 / number of known pixels in the 0.2 m cell of its end point, holes 0."""
    rays = model.directions.reshape(-1, 3).astype(np.float64) @ pose.rotation.T
    ends = pose.position + rays * ranges.reshape(-1, 1)
    cells = np.floor(ends / VOXEL_M).astype(np.int64) + (1 << 20)
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    _, place = np.unique(keys, return_inverse=True)
    shares = np.bincount(place, known.ravel().astype(np.float64))[place]
    return np.where(known.ravel(), 1.0 / np.maximum(shares, 1.0), 0.0).reshape(ranges.shape)


class PrototypeQuadtrees:
    """All settings of the published tables."""

    series = PrototypeQuadtree.series

    def codecs(self, sensor: str, learnt: ScanSet) -> list[Codec]:
        return [PrototypeQuadtree(setting, learnt.model, learnt) for setting in SETTINGS[sensor]]
