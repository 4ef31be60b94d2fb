"""How well each sample of a stream agrees with the current model: its free energy F(t), and the surprise of a drop.

Surprise is the drop of F(t) below its recent median, in units of the usual drops.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.dem.engine.free_energy import SampleFreeEnergy
from mavdem.dem.engine.generalized_coordinates import taylor_weights
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.learned import Learned
from mavdem.dem.online.memory import SampleMemory

SURPRISE_SECONDS = 10.0
"""Length of the past of F(t) by which the next value is standardised, s; a choice."""

MIN_PAST_VALUES = 100
"""Values of F(t) that are needed before a surprise is reported; a choice."""

MAX_QUARTILES = 3.0
"""Largest unit of surprise, in distances of the lower quartile of F(t) from its median.

The unit is the distance of the 5 % quantile. Of normally distributed values that is 2.4 such distances. It is larger
where a failure lasts. The limit keeps such a failure from making the unit so large that the next one goes unseen.
"""


class FreeEnergyMonitor(NamedTuple):
    """A learned model with all that is needed to evaluate F(t) of the samples that follow.

    It is made in the process that learns the model, and sent from there.

    Attributes:
        learned: The model.
        end_time: Time of the last sample that it was learned from, s.
        free_energy: Free energy F(t) of a sample as a function of its data.
        past_values: F(t) of the latest training samples, up to ``SURPRISE_SECONDS``.
        window_map: (dim ε̃ + dim X, window (m + r)) map of the samples of a window, first all outputs and then all
            inputs, to the prediction errors and states at its centre. Derivatives, units and errors are linear in the
            samples, so that one product takes the place of all these steps.
        window_constants: (dim ε̃ + dim X,) constants that are added.
    """

    learned: Learned
    end_time: float
    free_energy: SampleFreeEnergy
    past_values: Array
    window_map: Array
    window_constants: Array

    @classmethod
    def from_model(cls, learned: Learned, end_time: float) -> FreeEnergyMonitor:
        """Returns the monitor of a learned model, with F(t) of its latest training samples as the past.

        The free energy of a sample needs its prediction errors and states. Both are affine functions of the samples in
        the embedding window: the samples are scaled, differentiated, and mapped by the model. All of that is done here
        once for unit vectors instead of samples, which gives the matrix and the constants of the function. Afterwards
        one matrix product for each new sample is enough.

        Args:
            learned: The model, as ``learn`` returns it, with its ``sample_free_energy``.
            end_time: Time of the last sample that it was learned from, s.

        Returns:
            The monitor, which computes F(t) directly from the samples of a window.
        """
        assert learned.sample_free_energy is not None
        window = learned.settings.window
        inputs = learned.record.inputs.shape[1]
        outputs = learned.record.outputs.shape[1]
        # An affine function is determined by its value at 0, and its values at the unit vectors minus that value. Each
        # row is a window of samples as one vector: first all outputs, and then all inputs.
        unit_vectors = np.eye(window * (outputs + inputs))
        zeros = np.zeros((1, len(unit_vectors)))
        windows = np.vstack([zeros, unit_vectors])
        window_outputs, window_inputs = np.split(windows, [window * outputs], axis=1)
        generalized_data = _generalized_data(
            learned,
            outputs=window_outputs.reshape(-1, window, outputs),
            inputs=window_inputs.reshape(-1, window, inputs),
        )
        data_at_zero = generalized_data[0]
        data_per_sample = (generalized_data[1:] - data_at_zero).T
        errors_and_states_per_data = learned.sample_free_energy.error_and_state_map
        return cls(
            learned=learned,
            end_time=end_time,
            free_energy=learned.sample_free_energy,
            past_values=learned.free_energy_of_samples[-round(SURPRISE_SECONDS / learned.dt) :],
            window_map=errors_and_states_per_data @ data_per_sample,
            window_constants=errors_and_states_per_data @ data_at_zero,
        )

    @property
    def free_energy_action(self) -> float:
        """F̄ of the model, nats: the sum of F(t) over its training samples."""
        return float(self.learned.free_energy[-1])

    def terms(self, memory: SampleMemory) -> Array | None:
        """Computes F(t) of the sample at the centre of the latest embedding window: how well it agrees with the model.

        F(t) follows from the prediction errors and the states at that sample. Both are affine functions of the samples
        in the window, which :meth:`from_model` has prepared as a matrix and a vector. F(t) is the same function as for
        the training samples, and includes the same part of the model's complexity.

        Args:
            memory: Memory with the latest samples.

        Returns:
            (10,) terms of F(t), nats, in the order of ``mavdem.dem.engine.free_energy.Term``; their sum is F(t). None
            if there is not yet a whole window of samples since the last gap.
        """
        window = self.learned.settings.window
        inputs, outputs = memory.latest_samples(window)
        if len(outputs) < window:
            return None
        samples = np.concatenate([outputs.ravel(), inputs.ravel()])
        errors_and_states = (self.window_map @ samples + self.window_constants)[None]
        error_count = len(self.free_energy.error_precision)
        errors = errors_and_states[:, :error_count]
        states = errors_and_states[:, error_count:]
        return self.free_energy.terms_of_errors(errors, states)[0]


def _generalized_data(learned: Learned, outputs: Array, inputs: Array) -> Array:
    """Returns the generalized data [ỹ; η̃] at the centre of each of N windows, computed as in the fit.

    Args:
        learned: The model, whose scaling and embedding are used.
        outputs: (N, window, m) outputs of the samples of each window.
        inputs: (N, window, r) inputs of the same samples.

    Returns:
        The data, (N, dim [ỹ; η̃]).
    """
    settings = learned.settings
    center = settings.window // 2
    output_weights = taylor_weights(settings.p, learned.dt, settings.window, center)
    input_weights = taylor_weights(settings.d, learned.dt, settings.window, center)
    count, window, _ = outputs.shape
    # All windows are scaled as one table, to which the scaling may add the column of a constant input.
    scaled_outputs = learned.scaling.scale_outputs(outputs.reshape(count * window, -1))
    scaled_inputs = learned.scaling.scale_inputs(inputs.reshape(count * window, -1))
    # The weights (p + 1, window) turn the samples of a window (window, m) into its derivatives (p + 1, m) of order 0 to
    # p; the inputs' derivatives likewise. The derivatives of a window are flattened to one row.
    output_derivatives = output_weights @ scaled_outputs.reshape(count, window, -1)
    input_derivatives = input_weights @ scaled_inputs.reshape(count, window, -1)
    return np.hstack([output_derivatives.reshape(count, -1), input_derivatives.reshape(count, -1)])


class Surprise:
    """Standardises the free energy F(t) of each sample of a stream by the median and the 5 % quantile of its past.

    A standard deviation would not do: F(t) has a long lower tail, and one gust would hide the next. Each model has its
    own level of F(t), so that each new one begins with its own past.
    """

    def __init__(self, dt: float, past_values: Iterable[float] = ()) -> None:
        """Begins with a past.

        Args:
            dt: Time from one value to the next, s.
            past_values: F(t) of the latest samples, in the order of time.
        """
        # A deque drops its oldest value for each new one. However long the step is, it holds more than the fewest
        # values with which there is a surprise.
        capacity = max(round(SURPRISE_SECONDS / dt), 2 * MIN_PAST_VALUES)
        self._past_values = deque(past_values, capacity)
        self._median = np.nan
        self._unit = np.nan
        self.update_quantiles()

    def add(self, value: float) -> float:
        """Adds the next value of F(t), and returns its surprise.

        Args:
            value: F(t), nats.

        Returns:
            The distance of the value below the median of the past, divided by the distance of the 5 % quantile below
            the median. It is negative above the median, and NaN if the past is too short.
        """
        self._past_values.append(value)
        return (self._median - value) / self._unit

    def update_quantiles(self) -> None:
        """Computes from the past the median of F(t) and the unit of surprise, both in nats.

        The unit is the distance of the 5 % quantile below the median, but at most ``MAX_QUARTILES`` times the distance
        of the lower quartile, so that a lasting failure does not increase it. This function sorts the whole past, and
        is therefore called once for each block of samples.
        """
        if len(self._past_values) < MIN_PAST_VALUES:
            return
        # The lower end of the 90 % interval is the 5 % quantile.
        low_fraction, _ = INTERVAL_QUANTILES
        low_quantile, lower_quartile, median = np.quantile(
            self._past_values, [low_fraction, 0.25, 0.5]
        )
        unit_of_surprise = min(median - low_quantile, MAX_QUARTILES * (median - lower_quartile))
        self._median = median
        # If F(t) did not vary, this minimum keeps the surprise of a drop finite.
        self._unit = max(unit_of_surprise, ROUNDING_TOLERANCE)
