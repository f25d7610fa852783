"""Learning what the quadtree codec's contexts know before the first bit, from scans of generated worlds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from models.scans import PosedScan
from onboard.codec.mixing_coder import finish, new_writer
from onboard.codec.priors import Priors, fresh_priors, trained_priors
from onboard.codec.quadtree import codec, symbols
from onboard.core.lidar import LidarModel

QUALITIES = (1.0, 2.0, 4.0, 8.0)
"""All finenesses get their share of the training."""
COUNT_LIMIT = 24
"""What a model may claim to have seen: the rest of its certainty has to come from the scan."""
_LEARNING_SHIFT_TRAINING = 12
_LEARNING_SHIFT = 14


def learn_priors(
    scans: Sequence[PosedScan],
    model: LidarModel,
    rounds: int = 2,
    report: Callable[[str], None] | None = None,
) -> Priors:
    """Code all scans in a row at several qualities with one ever learning coder; `report` gets progress."""
    priors = fresh_priors(
        symbols.SIZES, symbols.WEIGHT_SETS, limit=255, learning_shift=_LEARNING_SHIFT_TRAINING
    )
    for turn in range(rounds):
        size = 0
        for number, item in enumerate(scans):
            plan = codec.plan_scan(item.scan.ranges, model, item.pose, priors)
            for quality in QUALITIES:
                writer = new_writer(codec.MAX_PAYLOAD, priors)
                price = codec.price_of(quality)
                codec.write(plan, codec.choose(plan, price), writer, price)
                size += len(finish(writer))
                priors = trained_priors(priors, writer, 255)
            if report and number % 20 == 19:
                report(f"round {turn + 1}, {number + 1} scans, {size / (number + 1) / len(QUALITIES):.0f} B")
    return trained_priors(priors, new_writer(1, priors), COUNT_LIMIT)._replace(learning_shift=_LEARNING_SHIFT)


def shuffled(scans: Sequence[PosedScan], seed: int) -> list[PosedScan]:
    """The same scans in another order: neighbours in a set come from one world."""
    order = np.random.default_rng(seed).permutation(len(scans))
    return [scans[int(place)] for place in order]
