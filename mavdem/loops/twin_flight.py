"""Flights of a vehicle's twin in the simulator, on the setpoints of the recorded flight and in wind of its spectrum."""

import tomllib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES
from mavdem.errors import NotLearnable
from mavdem.facts.loops import Twins
from mavdem.loops.axis_loops import Loop, LoopsByAxis
from mavdem.loops.measured_response import interpolated_setpoint
from mavdem.loops.twin import Twin
from mavdem.plant.parameters import wind_torque_density

MAX_REPLAY_SECONDS = 120.0
"""Longest segment that is flown, s: it takes the simulator a few seconds."""
MIN_SETPOINT_SHARE = 0.5
"""Fraction of a segment with setpoints, from which on it can be flown."""
MIN_YAW_SETPOINT_RATIO = 0.8
"""Standard deviation of yaw's rate setpoint over that of the rate, from which on yaw is steered.

A heading that is only held is turned by roll and pitch of a leaned vehicle.
"""
TWIN_FLIGHTS = 3
"""Flights of the twin, each in other wind of the same spectrum."""

SETTLING_SECONDS = 3.0
"""Beginning of a flight that is left out of its figures, s."""
RATE_BANDS = (0.3, 0.6, 1.2, 2.4, 4.8, 8.0)
"""Edges of the bands in which spectra of the rate are compared, Hz: octaves, and most of one."""
SPECTRUM_WINDOW_SECONDS = 20.0
"""Length of the windows of these spectra, s, at most half of the flight."""


class ReplaySegment(NamedTuple):
    """Setpoints and motion of one axis in the part of a recorded flight that the simulated twin flies again."""

    outputs: Array
    """(T, 2) recorded angle, rad, and rate, rad/s; (T, 1) the rate alone, of yaw."""
    setpoints: Array
    """(T, 2) setpoints of angle, rad, and rate, rad/s.

    That of the rate is without what the attitude controller makes of the angle's error. Of yaw it is all, and that of
    the angle is 0.
    """


def replay_segments(loops: LoopsByAxis) -> dict[str, ReplaySegment]:
    """Returns by axis the longest segment of a flight, where its setpoints were recorded.

    The twin flies all axes at once, so they must be of the same time. That is roll's longest segment, cut at
    ``MAX_REPLAY_SECONDS``. Pitch and yaw are there where they were learned from the same segments as roll; yaw only
    where it was steered.

    Args:
        loops: by axis; roll must be there.

    Returns:
        The segment of each axis; empty without setpoints of roll.
    """
    roll = loops["roll"].record
    longest = np.argmax(roll.lengths)
    start = roll.segment_starts[longest]
    samples = min(roll.lengths[longest], round(MAX_REPLAY_SECONDS / roll.dt))
    rows = slice(start, start + samples)
    segments = dict[str, ReplaySegment]()
    for axis, loop in loops.items():
        record = loop.record
        is_same_flight = record.lengths == roll.lengths and record.begins == roll.begins
        segment = _replay_segment(loop, rows) if is_same_flight else None
        if segment is not None:
            segments[axis] = segment
    return segments if "roll" in segments else {}


def _replay_segment(loop: Loop, rows: slice) -> ReplaySegment | None:
    """Returns what the vehicle did in some rows of a record, and the setpoints with which the twin can fly the same.

    An attitude controller adds a correction, angle gain × error of the angle, to the setpoint of the rate. The twin has
    such a controller too, so the logged correction must be taken off. ArduPilot's ATTITUDE_TARGET leaves it out, its
    other messages and PX4's have it. Which it is shows in what the logged setpoint of the rate is nearest to: the slope
    of the angle's setpoint (no correction), that and the correction, or the correction alone.

    Args:
        loop: of the axis, with its record.
        rows: of the record.

    Returns:
        None where too few setpoints were recorded, or yaw was not steered.
    """
    # Outputs are angle and rate of roll and pitch, and the rate alone of yaw.
    record = loop.record
    outputs = record.outputs[rows]
    if loop.axis == "yaw":
        columns = _setpoints(loop, rows, ["yaw rate setpoint"])
        if columns is None:
            return None
        # Yaw is steered by its rate, so the setpoint of its angle is 0. One that hardly moves was not steered.
        (yaw_rate,) = columns
        if not yaw_rate.std() > MIN_YAW_SETPOINT_RATIO * outputs.std():
            return None
        return ReplaySegment(outputs, np.column_stack([0 * yaw_rate, yaw_rate]))
    columns = _setpoints(loop, rows, [f"{loop.axis} setpoint", f"{loop.axis} rate setpoint"])
    if columns is None:
        return None
    angle, rate = columns
    correction = loop.controller.angle_gain * (angle - outputs[:, 0])
    feed_forward = np.gradient(angle, record.dt)
    # The nearest has the least standard deviation from the recorded setpoint.
    candidates = (feed_forward, correction + feed_forward, correction)
    distances = [np.std(rate - candidate) for candidate in candidates]
    lacks_correction = loop.controller.is_ardupilot and np.argmin(distances) == 0
    if not lacks_correction:
        rate = rate - correction
    return ReplaySegment(outputs, np.column_stack([angle, rate]))


def _setpoints(loop: Loop, rows: slice, names: Sequence[str]) -> list[Array] | None:
    """Returns setpoints of a record in some of its rows, interpolated between messages.

    Args:
        loop: with the record.
        rows: of the record, T of them.
        names: of the setpoints, as "roll setpoint".

    Returns:
        (T,) each; None where one of them does not exist, or all together were recorded in less than
        ``MIN_SETPOINT_SHARE`` of the rows.
    """
    record = loop.record
    if record.setpoints is None or not set(names) <= set(record.setpoint_names):
        return None
    columns = [record.setpoint_names.index(name) for name in names]
    recorded = record.setpoints[rows, columns]
    is_finite = np.isfinite(recorded).all(axis=1)
    if is_finite.mean() < MIN_SETPOINT_SHARE:
        return None
    samples = np.arange(len(recorded))
    return [
        interpolated_setpoint(np.interp(samples, samples[is_finite], column[is_finite]))
        for column in recorded.T
    ]


def compare_twin_with_flight(twin: Twin, loops: LoopsByAxis) -> dict[str, dict[str, list[float]]]:
    """Returns by axis the figures of the recorded flight and of its twin's, as :func:`motion_figures`.

    The wind of the recorded flight is not known in time, only its spectrum. So the twin flies ``TWIN_FLIGHTS`` times in
    other wind of that spectrum, and figures are compared instead of time series.

    Args:
        twin: of the vehicle.
        loops: by axis, with the records of the flight.

    Returns:
        By axis; empty without setpoints of roll.

    Raises:
        NotLearnable: the twin cannot fly.
    """
    segments = replay_segments(loops)
    if not segments:
        return {}
    flights = [fly_twin(twin, loops, segments, seed) for seed in range(TWIN_FLIGHTS)]
    figures = {}
    for axis, segment in segments.items():
        motions = [flight[:, AXES.index(axis)] for flight in flights]
        figures[axis] = motion_figures(loops[axis], segment.outputs, motions)
    return figures


def fly_twin(
    twin: Twin, loops: LoopsByAxis, segments: Mapping[str, ReplaySegment], seed: int = 0
) -> Array:
    """Flies the ``twin`` on the setpoints of a flight, in wind torque of the spectra that its loops were learned with.

    Axes without a segment keep a setpoint of 0, in still air.

    Args:
        twin: of the vehicle.
        loops: by axis.
        segments: of the flight, by axis; roll must be there.
        seed: of the wind and the sensors' noise.

    Returns:
        (T, 3, 2) angles, rad, and rates, rad/s, of roll, pitch and yaw.

    Raises:
        NotLearnable: the twin cannot fly.
    """
    samples = len(segments["roll"].outputs)
    setpoints = np.zeros((samples, len(AXES), 2))
    torque = np.zeros((samples, len(AXES)))
    rng = default_rng(seed)
    for axis, segment in segments.items():
        column = AXES.index(axis)
        setpoints[:, column] = segment.setpoints
        torque[:, column] = wind_torque_realisation(loops[axis], samples, rng)
    try:
        return _simulated(twin, loops["roll"].record.dt, setpoints, torque, seed)
    except ValueError as error:
        raise NotLearnable(Twins.CANNOT_FLY, because=error) from None


def _simulated(twin: Twin, dt: float, setpoints: Array, torque: Array, seed: int) -> Array:
    """Returns how the simulator flies a ``twin``, read from its vehicle file (``sitl_scenarios.replay.replayed``).

    Args:
        twin: the vehicle.
        dt: time between samples, s.
        setpoints: (T, 3, 2) of angle, rad, and rate, rad/s, of roll, pitch and yaw.
        torque: (T, 3) of the wind, rad/s².
        seed: of the sensors' noise.

    Returns:
        (T, 3, 2) angles, rad, and rates, rad/s.

    Raises:
        ValueError: the simulator cannot fly it.
    """
    from mavdem.report.vehicle_files import vehicle_text
    from sitl_scenarios.files import scenario_of
    from sitl_scenarios.replay import replayed

    vehicle = tomllib.loads(vehicle_text(twin, ".toml", ""))
    return replayed(scenario_of({**vehicle, "seed": seed}), dt, setpoints, torque)


def wind_torque_realisation(loop: Loop, samples: int, rng: np.random.Generator) -> Array:
    """Returns a Gaussian wind torque with the spectral density that was learned with a ``loop``.

    Independent normal Fourier coefficients of the right variance are transformed back to time. With n samples of step
    dt, a one-sided density S asks for real and imaginary parts of variance S n / (4 dt) each.

    Args:
        loop: with plant and time step.
        samples: how many of the record's time steps.
        rng: source of the random numbers.

    Returns:
        (samples,) angular acceleration, rad/s², of mean 0.
    """
    dt = loop.record.dt
    frequency = np.fft.rfftfreq(samples, dt).astype(np.float64)
    density = np.where(frequency > 0, wind_torque_density(loop.plant, frequency), 0.0)
    real, imaginary = rng.standard_normal((2, len(density)))
    amplitude = np.sqrt(density * samples / (4 * dt))
    return np.fft.irfft(amplitude * (real + 1j * imaginary), samples)


def motion_figures(
    loop: Loop, recorded: Array, simulated: Sequence[Array]
) -> dict[str, list[float]]:
    """Returns figures by which a recorded motion and simulated ones of an axis can be compared.

    Args:
        loop: of the axis, with the time step.
        recorded: (T, 2) angle, rad, and rate, rad/s; (T, 1) the rate alone.
        simulated: (T, 2) each, likewise.

    Returns:
        "levels": power of the rate in each of ``RATE_BANDS``, simulated over recorded, dB. "rate": standard deviation
        of the rate, deg/s, recorded and mean of the simulated; and, but for yaw, "lean" and "sway": mean and standard
        deviation of the angle, degrees, likewise.
    """
    # It takes half a second to import.
    from scipy.signal import detrend, welch

    dt = loop.record.dt
    outputs = recorded.shape[1]
    # Shape (M, T, 2 or 1): the recorded motion first. Of yaw, only the rate of the simulated ones is taken.
    motions = np.array([recorded, *(motion[:, -outputs:] for motion in simulated)])
    motions = motions[:, round(SETTLING_SECONDS / dt) :]
    angles, rates = motions[..., 0], motions[..., -1]
    window = int(min(SPECTRUM_WINDOW_SECONDS / dt, motions.shape[1] / 2))
    frequency, density = welch(rates, 1 / dt, nperseg=window, detrend=detrend)
    # Band 0 is below the first edge, and the last one above the last edge: both are left out.
    bands = np.digitize(frequency, RATE_BANDS)
    level_by_band = np.array(
        [density[:, bands == band].mean(axis=1) for band in range(1, len(RATE_BANDS))]
    )
    recorded_level, simulated_levels = level_by_band[:, 0], level_by_band[:, 1:]
    level_ratio = simulated_levels.mean(axis=1) / recorded_level
    figures = {"rate": np.degrees(rates.std(axis=1))}
    if loop.axis != "yaw":
        degrees = np.degrees(angles)
        figures["lean"] = degrees.mean(axis=1)
        figures["sway"] = degrees.std(axis=1)
    result = {"levels": (10 * np.log10(level_ratio)).tolist()}
    # Of each figure, that of the recorded motion and the mean of the simulated ones.
    for name, values in figures.items():
        result[name] = [values[0], values[1:].mean()]
    return result
