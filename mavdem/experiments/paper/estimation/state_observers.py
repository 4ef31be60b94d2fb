"""Observers of the hidden roll rate: DEM, Kalman filters for white and coloured process noise, and a difference.

All estimate roll and roll rate of a window of flight from the measured roll and the motor commands, with a known model.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.experiments.paper.estimation.dem_observer import (
    DEM_STATE_ORDER,
    KNOWN_INPUT_PRECISION,
    DemObserver,
    embedding_derivative,
)
from mavdem.experiments.paper.estimation.observers import (
    DiscreteModel,
    fixed_lag_states,
    kalman_states,
    smikf_states,
    with_noise_states,
)
from mavdem.experiments.paper.estimation.roll_windows import (
    MEASUREMENT_VARIANCE,
    ROLL_SYSTEM_MATRIX,
    RollWindow,
)

NOISE_STATE_ORDER = 6
"""Order of the autoregressions of state augmentation, as in the authors' scripts."""

LOOK_AHEAD = DEM_STATE_ORDER // 2
"""Samples after its own that an estimate of DEM uses: half of the embedding window."""

ROLL_OUTPUT = np.eye(1, 2)
"""C: the roll alone is measured."""

DEM = f"DEM, p = {DEM_STATE_ORDER}"
DEM_LOW_ORDER = "DEM, p = 2"
KALMAN = "Kalman filter"
SMIKF = "SMIKF"
AUTHORS_SMIKF = "SMIKF, the authors’ form"
AUGMENTATION = f"state augmentation, AR({NOISE_STATE_ORDER})"
LATER_KALMAN = f"Kalman filter, {LOOK_AHEAD} samples later"
LATER_AUGMENTATION = f"state augmentation, {LOOK_AHEAD} samples later"
DERIVATIVE = "central difference of the roll"
"""Names of the observers in tables and documents."""

PEERS = (KALMAN, SMIKF, AUGMENTATION)
"""The observers that Bos et al. compare DEM with."""

FIXED_LAG_SMOOTHERS = (LATER_KALMAN, LATER_AUGMENTATION)
"""Filters whose estimates use as many later samples as DEM's do: fixed-lag smoothers."""

StateEstimator = Callable[[RollWindow, Array, Array], Array]
"""Function that estimates the states (T, 2) of a window from its outputs (T, 1) and inputs (T, 4)."""


def dem_states(window: RollWindow, outputs: Array, inputs: Array, p: int) -> Array:
    """Estimates the states of a window by DEM with the authors' settings.

    Args:
        window: model and noises of the window.
        outputs: (T, 1) measured roll.
        inputs: (T, 4) motor commands.
        p: embedding order.

    Returns:
        (T, 2) roll, rad, and roll rate, rad/s; NaN at both ends, where the embedding window is not complete.
    """
    observer = DemObserver(
        A=ROLL_SYSTEM_MATRIX,
        B=window.B,
        C=ROLL_OUTPUT,
        output_precision=1 / MEASUREMENT_VARIANCE,
        state_precisions=1 / window.process_noise.var(axis=0, ddof=1),
        input_precisions=np.full(inputs.shape[1], KNOWN_INPUT_PRECISION),
        dt=window.dt,
        p=p,
    )
    return observer.estimate(outputs, inputs).states


def white_noise_model(window: RollWindow) -> DiscreteModel:
    """Makes the discrete model of a window with white noises.

    The covariance of the process noise is diagonal and has the variances of the window's own noise, as in the authors'
    scripts. So the observers know more than they would in flight: that noise is computed from the hidden state.

    Args:
        window: transition and process noise of the window.

    Returns:
        The model.
    """
    Phi, Gamma = window.transition
    Q = np.diag(window.process_noise.var(axis=0, ddof=1))
    return DiscreteModel(Phi, Gamma, ROLL_OUTPUT, Q, R=np.array([[MEASUREMENT_VARIANCE]]))


def coloured_noise_model(window: RollWindow) -> DiscreteModel:
    """Returns the discrete model of a window whose process noise is autoregressive, by state augmentation."""
    return with_noise_states(white_noise_model(window), window.process_noise, NOISE_STATE_ORDER)


def _kalman(window: RollWindow, outputs: Array, inputs: Array) -> Array:
    """Estimates the states by the Kalman filter for white noise."""
    return kalman_states(white_noise_model(window), outputs, inputs)


def _augmented_kalman(window: RollWindow, outputs: Array, inputs: Array) -> Array:
    """Estimates the states by the Kalman filter with noise states."""
    return kalman_states(coloured_noise_model(window), outputs, inputs)[:, :2]


def _smikf(window: RollWindow, outputs: Array, inputs: Array, accumulates: bool) -> Array:
    """Estimates the states by SMIKF, a Kalman filter that knows the autocovariances of coloured process noise.

    Args:
        window: samples of a roll flight, with the model of the roll axis.
        outputs: (T, 1) measured roll.
        inputs: (T, 4) motor commands.
        accumulates: whether the covariance of noise and state error contains the noise of earlier samples, which the
            authors' scripts leave out.

    Returns:
        (T, 2) roll and roll rate.
    """
    noise = window.process_noise
    return smikf_states(white_noise_model(window), noise, outputs, inputs, accumulates=accumulates)


def _later_kalman(window: RollWindow, outputs: Array, inputs: Array) -> Array:
    """Estimates the states by the fixed-lag smoother for white noise."""
    return fixed_lag_states(white_noise_model(window), 2, LOOK_AHEAD, outputs, inputs)


def _later_augmented_kalman(window: RollWindow, outputs: Array, inputs: Array) -> Array:
    """Estimates the states by the fixed-lag smoother with noise states."""
    return fixed_lag_states(coloured_noise_model(window), 2, LOOK_AHEAD, outputs, inputs)


def _differences(window: RollWindow, outputs: Array, inputs: Array) -> Array:
    """Estimates roll and roll rate without a model: the roll is the measured one, the rate its central difference.

    Args:
        window: window of the flight, for its sampling step.
        outputs: (T, 1) measured roll, rad.
        inputs: inputs, which all estimators take, and this one does not need.

    Returns:
        (T, 2) roll, rad, and roll rate, rad/s.
    """
    del inputs
    return np.hstack([outputs, embedding_derivative(outputs, 2, window.dt)])


class StateObserver(NamedTuple):
    """An observer of the states."""

    estimate: StateEstimator
    """Its estimates."""

    look_ahead: int
    """Samples after its own that an estimate uses."""


OBSERVERS = {
    DEM: StateObserver(partial(dem_states, p=DEM_STATE_ORDER), LOOK_AHEAD),
    DEM_LOW_ORDER: StateObserver(partial(dem_states, p=2), 1),
    KALMAN: StateObserver(_kalman, 0),
    SMIKF: StateObserver(partial(_smikf, accumulates=True), 0),
    AUTHORS_SMIKF: StateObserver(partial(_smikf, accumulates=False), 0),
    AUGMENTATION: StateObserver(_augmented_kalman, 0),
    LATER_KALMAN: StateObserver(_later_kalman, LOOK_AHEAD),
    LATER_AUGMENTATION: StateObserver(_later_augmented_kalman, LOOK_AHEAD),
    DERIVATIVE: StateObserver(_differences, 1),
}
"""All observers by name."""

COMPARED_OBSERVERS = tuple(name for name in OBSERVERS if name != AUTHORS_SMIKF)
"""Names of the observers that are compared at their own time."""
