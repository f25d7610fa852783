"""Corrections of keyframe poses between localisation and the air."""

from __future__ import annotations

from onboard.localization.corrections import Correction, Knot
from onboard.sharing.messages import CorrectionKnot, Corrections


def to_message(correction: Correction) -> Corrections:
    """What peers are sent."""
    knots = tuple(CorrectionKnot(knot.sequence, knot.shift_m, knot.turn_rad) for knot in correction.knots)
    return Corrections(correction.source, correction.revision, knots)


def from_message(message: Corrections) -> Correction:
    """What a peer has sent; one without knots acknowledges and corrects nothing."""
    knots = tuple(Knot(knot.sequence, knot.shift_m, knot.turn_rad) for knot in message.knots)
    return Correction(message.source, message.revision, knots)
