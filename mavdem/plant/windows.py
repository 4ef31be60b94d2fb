"""Windows of about 7 s of a flight, as Fourier transforms of body rate and motor inputs, for the gray-box fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts.model import NoPhysical, Refinement
from mavdem.plant.closed_loop.spectra import ComplexArray
from mavdem.plant.sampled_plant import with_advanced_jumps

WINDOW_SECONDS = 7.0
"""Usual length of a window, s: a choice."""

MAX_WINDOW_STRETCH = 1.5
"""Factor by which windows may be longer than usual, so that little of a flight remains unused: a choice."""

LENGTH_STEPS = 50
"""Number of steps, per usual length, in which lengths of windows are tried."""

MIN_WINDOW_SAMPLES = 200
"""Least number of samples of a window: a choice."""

REGRESSION_LAGS = 4
"""Number of past samples from which the next one is predicted, to find its innovation: a choice."""

MIN_RATE = 39.0
"""Lowest rate of samples, Hz, at which motor lag and damping of tens of milliseconds can be estimated.

A time grid of 40 Hz may have a little less than 40 Hz.
"""

MAX_RATE = 199.0
"""Rate of samples, Hz, from twice which on only every so many samples are used."""

INTERPOLATED_CHANNEL = 0
"""Channel of ``FlightWindows.inputs`` with the inputs less the controller's immediate responses to a sample."""

HELD_CHANNEL = 1
"""Channel of ``FlightWindows.inputs`` with the immediate responses to a sample, which act only from that sample on."""

REFINEMENT_CHANNEL = 2
"""First of the channels of ``FlightWindows.inputs`` with the refinements, in the order of ``REFINEMENTS``."""

REFINEMENTS = (Refinement.JUMPS, Refinement.THRUST_CURVE)
"""Possible refinements of the model, each with one parameter.

JUMPS: by what fraction of a step inputs that jump between two samples did so before the middle of the step.
THRUST_CURVE: the relative change of the effect for one standard deviation of the inputs.
"""

MAX_JUMP_ADVANCE = 0.5
"""Largest time by which a jump comes before the middle of a step, as a fraction of the step: it is then at its start.

The least is 0. Commands that answer the sample at the end of a step act later, but they have a separate channel. A
fit with late jumps has commands with noise that lasts for less than a step; on simulated flights it took the
delay for 0 and the lag for too long (docs/evidence/parameters.md).
"""


class FlightWindows(NamedTuple):
    """Fourier transforms of W windows of a flight, of N samples each, at F frequencies; the mean is 0 in each."""

    rate: ComplexArray
    """Body rate (W, F), rad/s."""

    inputs: ComplexArray
    """Channels of the r inputs (2 + refinements, r, W, F), in units of the inputs' common standard deviation.

    The first two add up to the inputs. The others are what each refinement adds for one unit of its parameter.
    """

    samples: int
    """N, number of samples of a window."""

    dt: float
    """Time step of the samples, s."""

    unit: float
    """Common standard deviation of the inputs, in the record's unit of them."""

    unpredicted_share: float = 0.0
    """Share of the inputs' variance that the samples before do not predict, 0 to 1: jumps, and noise of the gyro."""

    @classmethod
    def from_samples(
        cls, inputs: Array, rate: Array, responses: Array, dt: float, unit: float = 1.0
    ) -> FlightWindows:
        """Transforms windows of samples to frequencies, with the inputs split into channels.

        The gray-box model assumes a signal for each channel, and multiplies its transform by a frequency response:

        1. The inputs without the controller's immediate responses. They are interpolated linearly between samples.
        2. The immediate responses. Each is held until the next sample, since it begins only at its own sample.
        3. One signal for each of the ``REFINEMENTS``: what it adds to the inputs if its parameter is 1. The model
           multiplies that by the estimated parameter.

        Args:
            inputs: (W, N, r) deviations of the inputs from their trim, in ``unit``.
            rate: (W, N) body rate, rad/s.
            responses: (W, N, r) the part of the inputs with which the controller responds to the gyro's value at the
                same sample (:func:`responses_to_innovations`), in ``unit``.
            dt: time step, s.
            unit: common standard deviation of the inputs, in the record's unit.

        Returns:
            Transforms of W windows.
        """
        # The parameter of the first refinement is by how much earlier the inputs jump, as a fraction of a time step.
        earlier_jumps = with_advanced_jumps(inputs, jump_advance=1.0)
        added_signals = {
            Refinement.JUMPS: earlier_jumps - inputs,
            # Thrust is not linear in the input u: with an effect 1 + c u, the torque is the integral u + c u² / 2. For
            # c = 1 the refinement adds the second term.
            Refinement.THRUST_CURVE: inputs**2 / 2,
        }
        channels = [inputs - responses, responses]
        for refinement in REFINEMENTS:
            channels.append(added_signals[refinement])
        # (channels, W, N, r) becomes (channels, r, W, N), since the last axis, time, is transformed.
        channels_over_time = np.moveaxis(np.array(channels), 3, 1)
        input_transforms = scipy.fft.rfft(channels_over_time)
        rate_transforms = scipy.fft.rfft(rate)
        # The value at frequency 0 is the mean of each window: its trim, which is not part of the model.
        input_transforms[..., 0] = 0.0
        rate_transforms[..., 0] = 0.0
        return cls(rate_transforms, input_transforms, rate.shape[1], dt, unit)

    @property
    def omega(self) -> Array:
        """Angular frequencies (F,), rad/s."""
        step = 2 * np.pi / (self.samples * self.dt)
        return np.asarray(step * np.arange(self.rate.shape[1]))

    def select(self, windows: slice | Indices) -> FlightWindows:
        """Returns some of the windows.

        Args:
            windows: slice, or indices (W,), of the windows to keep.

        Returns:
            The windows in the order of their indices.
        """
        return self._replace(rate=self.rate[windows], inputs=self.inputs[:, :, windows])


def cut_windows(record: Record) -> FlightWindows:
    """Cuts a record into windows of one length and transforms them, ready for the fit of the gray-box model.

    The inputs are converted to deviations from their mean over all windows (the trim), in units of their common
    standard deviation, so that the priors of the model fit any kind of input. Samples that come much faster than the
    motion needs are thinned.

    Args:
        record: inputs and outputs of a flight; one of the outputs is the body rate.

    Returns:
        The transformed windows.

    Raises:
        NotLearnable: the samples are too slow or too few, no output is a rate, or no input changes.
    """
    if 1 / record.dt < MIN_RATE:
        raise NotLearnable(NoPhysical.SAMPLED_TOO_SLOWLY, rate=1 / record.dt)
    column = rate_column(record)
    # Indices in the record of the N samples of each of W windows.
    sample_indices = _window_samples(record)
    inputs = record.inputs[sample_indices]
    trim = inputs.mean(axis=(0, 1))
    deviations = inputs - trim
    unit = np.sqrt(np.mean(deviations**2))
    if not unit:
        raise NotLearnable(NoPhysical.MOTORS_STILL)
    scaled_inputs = deviations / unit
    rate = record.outputs[sample_indices, column]
    responses = responses_to_innovations(scaled_inputs, rate)
    # The fraction of the inputs' variance that the samples before do not predict: noise of the gyro, or jumps.
    _, input_innovations = _regression_innovations(scaled_inputs, rate)
    unpredicted_share = float(np.mean(input_innovations**2) / np.mean(scaled_inputs**2))
    # Thinned samples have a longer time step than the record.
    stride = sample_indices[0, 1] - sample_indices[0, 0]
    dt = stride * record.dt
    windows = FlightWindows.from_samples(scaled_inputs, rate, responses, dt, unit)
    return windows._replace(unpredicted_share=unpredicted_share)


def responses_to_innovations(inputs: Array, rate: Array) -> Array:
    """Estimates the part of the inputs with which the controller responds to the body rate at the same sample.

    A controller may respond to a gyro sample before the motors' outputs are logged with that sample. This response must
    not be used to predict the sample, since it is its consequence. It follows from two linear regressions:

    1. Rate and inputs are regressed on the samples before. The residuals are the innovations: what the past does not
       predict.
    2. The innovations of the inputs are regressed on those of the rate. The slopes are the gains of the response.

    Args:
        inputs: inputs (W, N, r) in W windows of N samples.
        rate: body rate (W, N), rad/s.

    Returns:
        The responses (W, N, r), in the unit of the inputs; 0 in the first ``REGRESSION_LAGS`` samples of each window.
    """
    rate_innovations, input_innovations = _regression_innovations(inputs, rate)
    gains = rate_innovations @ input_innovations / (rate_innovations @ rate_innovations)
    immediate_responses = rate_innovations[:, None] * gains
    responses = np.zeros_like(inputs)
    responses[:, REGRESSION_LAGS:] = immediate_responses.reshape(len(rate), -1, inputs.shape[2])
    return responses


def _regression_innovations(inputs: Array, rate: Array) -> ArrayPair:
    """Returns the innovations of rate and inputs: the errors of their linear prediction from the samples before.

    Each sample is predicted from the ``REGRESSION_LAGS`` samples before it, by one regression over all windows.

    Args:
        inputs: inputs (W, N, r) in W windows of N samples.
        rate: body rate (W, N), rad/s.

    Returns:
        Innovations of the rate (n,) and of the inputs (n, r), at the n samples of all windows that are predicted: all
        but the first ``REGRESSION_LAGS`` samples of each window.
    """
    # The rate comes first, the r inputs follow.
    signals = np.concatenate([rate[:, :, None], inputs], axis=2)
    # The samples of a window that have enough samples before them.
    predicted_count = rate.shape[1] - REGRESSION_LAGS
    # A row of the regression has the signals of the REGRESSION_LAGS samples before, side by side, the earliest first.
    # There is one row for each predicted sample of each window.
    earlier_signals = []
    for offset in range(REGRESSION_LAGS):
        earlier_signals.append(signals[:, offset : predicted_count + offset])
    regressors = np.concatenate(earlier_signals, axis=2)
    regressors = regressors.reshape(-1, regressors.shape[2])
    predicted_signals = signals[:, REGRESSION_LAGS:].reshape(-1, signals.shape[2])
    coefficients = np.linalg.lstsq(regressors, predicted_signals)[0]
    innovations = predicted_signals - regressors @ coefficients
    return innovations[:, 0], innovations[:, 1:]


def rate_column(record: Record) -> int:
    """Returns the column of the body rate in a record's outputs: the derivative of another output, or the only output.

    Args:
        record: inputs and outputs of a flight.

    Returns:
        Column of the rate in the outputs.

    Raises:
        NotLearnable: there are several outputs, and none is the derivative of another.
    """
    if record.outputs.shape[1] == 1:
        return 0
    pairs = derivative_pairs(record)
    if not pairs:
        raise NotLearnable(NoPhysical.NO_RATE)
    _, derivative = pairs[0]
    return derivative


def _window_samples(record: Record) -> Indices:
    """Divides the segments of a record into windows of equal length that do not overlap.

    Each window is in one segment, since the time between segments is unknown. The remainder of a segment is not used.
    If the sampling rate is twice ``MAX_RATE`` or more, only every n-th sample is used, with n the whole part of their
    ratio.

    Args:
        record: inputs and outputs of a flight.

    Returns:
        Indices (W, N) in the record of the N samples of each of W windows.

    Raises:
        NotLearnable: no segment is as long as the shortest window.
    """
    stride = max(1, int(1 / record.dt / MAX_RATE))
    shortest_window = stride * MIN_WINDOW_SAMPLES
    if record.longest_segment < shortest_window:
        raise NotLearnable(
            NoPhysical.TOO_FEW_SAMPLES_WITHOUT_GAPS,
            least_samples=shortest_window,
            samples=record.longest_segment,
        )
    window_length = _window_length(record)
    starts_by_segment = []
    for segment_start, segment_length in zip(record.segment_starts, record.lengths, strict=True):
        starts_by_segment.append(
            segment_start + window_length * np.arange(segment_length // window_length)
        )
    # A window has as many whole strides as fit into it.
    offsets = np.arange(0, window_length - stride + 1, stride)
    first_samples = np.concatenate(starts_by_segment)
    return np.asarray(first_samples[:, None] + offsets, int)


def _window_length(record: Record) -> int:
    """Returns the length of windows that leaves the fewest samples unused.

    In a segment of 13 s, for example, one window of 7 s leaves 6 s unused, and one of 10.5 s only 2.5 s. Lengths from
    ``WINDOW_SECONDS`` to ``MAX_WINDOW_STRETCH`` times that are tried, in steps of 1/``LENGTH_STEPS``; a record whose
    segments are all shorter has windows of its longest segment.

    Args:
        record: inputs and outputs of a flight.

    Returns:
        Length in samples of the record.
    """
    shortest = min(round(WINDOW_SECONDS / record.dt), record.longest_segment)
    longest = min(int(MAX_WINDOW_STRETCH * shortest), record.longest_segment)

    def used_samples(length: int) -> int:
        """Returns the number of samples that windows of this length cover."""
        window_count = sum(segment_length // length for segment_length in record.lengths)
        return window_count * length

    step = max(1, shortest // LENGTH_STEPS)
    return max(range(shortest, longest + 1, step), key=used_samples)
