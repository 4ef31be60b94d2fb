"""What a recorded setpoint of the body rate consists of: the attitude controller's correction, and its feed-forward."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.vocabulary import wrapped_angle

MIN_COEFFICIENT = 0.5
"""Least regression coefficient of a part for a rate setpoint to contain it: nearer to 1 than to 0."""


class AttitudePiece(NamedTuple):
    """A piece of flight without gaps, with N even samples."""

    rate_setpoint: Array
    """(N,) rad/s."""
    angle: Array
    """(N,) rad."""
    angle_setpoint: Array
    """(N,) rad, without steps from π to -π."""


class RateSetpointParts(NamedTuple):
    """Which parts a recorded setpoint of the body rate contains."""

    has_feedforward: bool
    """Whether it contains the derivative of the angle's setpoint."""
    has_correction: bool
    """Whether it contains the attitude controller's correction, angle gain · error of the angle."""


def rate_setpoint_parts(
    sampling_rate: float, pieces: Sequence[AttitudePiece], angle_gain: float
) -> RateSetpointParts:
    """Returns which parts a recorded setpoint of the body rate contains, by a regression on both.

    Args:
        sampling_rate: rate of the samples, Hz.
        pieces: pieces of flight, at least one.
        angle_gain: gain of the attitude controller, 1/s.
    """
    # The derivative is taken piece by piece: between two pieces the angle setpoint jumps.
    slopes = [sampling_rate * np.gradient(piece.angle_setpoint) for piece in pieces]
    corrections = [
        angle_gain * wrapped_angle(piece.angle_setpoint - piece.angle) for piece in pieces
    ]
    regressors = np.column_stack([np.concatenate(slopes), np.concatenate(corrections)])
    rate_setpoint = np.concatenate([piece.rate_setpoint for piece in pieces])
    feedforward, correction = np.linalg.lstsq(regressors, rate_setpoint)[0]
    return RateSetpointParts(
        has_feedforward=bool(feedforward > MIN_COEFFICIENT),
        has_correction=bool(correction > MIN_COEFFICIENT),
    )
