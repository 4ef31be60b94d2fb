"""Flights of a vehicle's twin in the simulator, on the setpoints of the recorded flight and in wind of its spectrum."""

import tomllib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES
from mavdem.errors import NotLearnable
from mavdem.facts.loops import TwinFact
from mavdem.loops.axis_loops import Loop, LoopsByAxis
from mavdem.loops.measured_response import interpolated_setpoint
from mavdem.loops.twin import Twin
from mavdem.plant.parameters import wind_torque_density

MAX_REPLAY_SECONDS = 120.0
"""Longest segment that is flown, s: it takes the simulator a few seconds. A choice."""
MIN_SETPOINT_SHARE = 0.5
"""Least fraction of a segment with setpoints for the twin to fly it: a choice."""
MIN_YAW_SETPOINT_RATIO = 0.8
"""Standard deviation of yaw's rate setpoint relative to the yaw rate's, from which on yaw is steered: a choice.

While the heading is only held, most of the yaw rate comes from roll and pitch of a leaned vehicle.
"""
TWIN_FLIGHTS = 3
"""Number of flights of the twin, each in other wind of the same spectrum: a choice."""

SETTLING_SECONDS = 3.0
"""Beginning of a flight that is left out of its figures, s, while the twin settles: a choice."""
RATE_BANDS = (0.3, 0.6, 1.2, 2.4, 4.8, 8.0)
"""Edges of the bands in which spectra of the rate are compared, Hz: octaves, except the last."""
SPECTRUM_WINDOW_SECONDS = 20.0
"""Length of the windows of these spectra, s, at most half of the flight."""

DECIBELS_PER_POWER_DECADE = 10
"""Decibels in a factor of ten of a power."""


class ReplaySegment(NamedTuple):
    """Setpoints and motion of one axis in the piece of a recorded flight that the simulated twin flies again."""

    outputs: Array
    """Recorded angle, rad, and rate, rad/s (T, 2); for yaw the rate alone (T, 1)."""
    setpoints: Array
    """Setpoints of angle, rad, and rate, rad/s (T, 2).

    The rate setpoint is without the correction that the attitude controller adds for the error of the angle. For yaw it
    is the whole setpoint, and the setpoint of the angle is 0.
    """


def replay_segments(loops: LoopsByAxis) -> dict[str, ReplaySegment]:
    """Returns the piece of a recorded flight that the twin can fly again: setpoints and motion of each axis.

    It is the longest segment of roll, cut at ``MAX_REPLAY_SECONDS``. As the twin flies all axes at once, pitch and yaw
    are included only if they were identified from the same segments as roll; yaw must also have been steered.

    Args:
        loops: identified loops by axis, "roll" among them.

    Returns:
        The segment of each axis, by its name; empty if no setpoints of roll were recorded.
    """
    roll = loops["roll"].record
    longest = np.argmax(roll.lengths)
    start = roll.segment_starts[longest]
    sample_count = min(roll.lengths[longest], round(MAX_REPLAY_SECONDS / roll.dt))
    samples_of_segment = slice(start, start + sample_count)
    segments = dict[str, ReplaySegment]()
    for axis, loop in loops.items():
        record = loop.record
        is_same_flight = record.lengths == roll.lengths and record.begins == roll.begins
        segment = _replay_segment(loop, samples_of_segment) if is_same_flight else None
        if segment is not None:
            segments[axis] = segment
    return segments if "roll" in segments else {}


def _replay_segment(loop: Loop, rows: slice) -> ReplaySegment | None:
    """Returns the motion of one axis in some rows of a record, and the setpoints with which the twin can repeat it.

    An attitude controller adds a correction, angle gain × error of the angle, to the rate setpoint. As the twin has
    such a controller too, the correction is subtracted from a logged setpoint that contains it. ArduPilot's
    ATTITUDE_TARGET does not contain it, ArduPilot's other messages and PX4's do. To find out, the logged rate setpoint
    is compared with three signals: the derivative of the angle setpoint (no correction), the sum of that and the
    correction, and the correction alone.

    Args:
        loop: loop of the axis, with its record.
        rows: rows of the record, of which the motion is taken.

    Returns:
        Motion and setpoints; None if too few setpoints were recorded, or yaw was not steered.
    """
    # The outputs of roll and pitch are angle and rate, the output of yaw is the rate alone.
    record = loop.record
    outputs = record.outputs[rows]
    if loop.axis == "yaw":
        return _replay_segment_of_yaw(loop, rows, outputs)
    columns = _interpolated_setpoints(
        loop, rows, [f"{loop.axis} setpoint", f"{loop.axis} rate setpoint"]
    )
    if columns is None:
        return None
    angle_setpoint, rate_setpoint = columns
    correction = loop.controller.angle_gain * (angle_setpoint - outputs[:, 0])
    feed_forward = np.gradient(angle_setpoint, record.dt)
    # The candidate without the correction comes first.
    candidates = (feed_forward, correction + feed_forward, correction)
    distances = [np.std(rate_setpoint - candidate) for candidate in candidates]
    lacks_correction = loop.controller.is_ardupilot and np.argmin(distances) == 0
    if not lacks_correction:
        rate_setpoint = rate_setpoint - correction
    return ReplaySegment(outputs, np.column_stack([angle_setpoint, rate_setpoint]))


def _replay_segment_of_yaw(loop: Loop, rows: slice, yaw_rate: Array) -> ReplaySegment | None:
    """Returns the yaw rate in some rows of a record, and the setpoint with which the twin can repeat it.

    Yaw is steered by its rate, so that the setpoint of its angle is 0.

    Args:
        loop: loop of yaw, with its record.
        rows: the T rows of the record.
        yaw_rate: recorded yaw rate (T, 1), rad/s.

    Returns:
        Motion and setpoints; None if too few setpoints were recorded, or the rate setpoint hardly changes beside the
        rate, so that the heading was only held.
    """
    columns = _interpolated_setpoints(loop, rows, ["yaw rate setpoint"])
    if columns is None:
        return None
    (rate_setpoint,) = columns
    is_steered = rate_setpoint.std() > MIN_YAW_SETPOINT_RATIO * yaw_rate.std()
    if not is_steered:
        return None
    angle_setpoint = np.zeros_like(rate_setpoint)
    return ReplaySegment(yaw_rate, np.column_stack([angle_setpoint, rate_setpoint]))


def _interpolated_setpoints(loop: Loop, rows: slice, names: Sequence[str]) -> list[Array] | None:
    """Returns setpoints of a record in some of its rows, interpolated between messages.

    Args:
        loop: loop of an axis, with its record.
        rows: the T rows of the record.
        names: names of the setpoints, such as "roll setpoint".

    Returns:
        Each setpoint (T,), in the order of the names. None if the record lacks one of them, or if all of them together
        were recorded in less than ``MIN_SETPOINT_SHARE`` of the rows.
    """
    record = loop.record
    if record.setpoints is None or not set(names) <= set(record.setpoint_names):
        return None
    columns = [record.setpoint_names.index(name) for name in names]
    recorded_setpoints = record.setpoints[rows, columns]
    is_finite = np.isfinite(recorded_setpoints).all(axis=1)
    if is_finite.mean() < MIN_SETPOINT_SHARE:
        return None
    samples = np.arange(len(recorded_setpoints))
    setpoints = []
    for recorded_setpoint in recorded_setpoints.T:
        # Rows without a value are filled first, so that messages can be told from the rows between them.
        filled_setpoint = np.interp(samples, samples[is_finite], recorded_setpoint[is_finite])
        setpoints.append(interpolated_setpoint(filled_setpoint))
    return setpoints


def compare_twin_with_flight(twin: Twin, loops: LoopsByAxis) -> dict[str, dict[str, list[float]]]:
    """Flies the twin on the setpoints of the recorded flight, and compares the two motions by figures.

    Only the spectrum of the wind in the recorded flight is known, not its time series. So the twin flies
    ``TWIN_FLIGHTS`` times, each in other random wind of that spectrum, and figures such as standard deviations are
    compared instead of time series.

    Args:
        twin: simulated vehicle with the identified loops, hover thrust, drag and wind.
        loops: identified loops by axis, with the records of the flight.

    Returns:
        By axis, the figures of :func:`motion_figures` by name and in its units; empty if no setpoints of roll were
        recorded.

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
    twin: Twin,
    loops: LoopsByAxis,
    segments: Mapping[str, ReplaySegment],
    seed: int = 0,
    *,
    is_estimated: bool = True,
) -> Array:
    """Flies the twin on the setpoints of a recorded flight, in random wind torque with the spectra of that flight.

    Axes without a segment have a setpoint of 0 and no wind torque.

    Args:
        twin: simulated vehicle with the identified loops, hover thrust, drag and wind.
        loops: identified loops by axis, with the spectra of the wind torque.
        segments: setpoints by axis, "roll" among them, at T samples each.
        seed: seed of the wind and of the sensors' noise.
        is_estimated: whether to return the autopilot's estimate of the motion, with the noise of its sensors, as in a
            log, instead of the true motion.

    Returns:
        Angles, rad, and rates, rad/s, of roll, pitch and yaw (T, 3, 2).

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
        return _simulated_motion(
            twin, loops["roll"].record.dt, setpoints, torque, seed, is_estimated=is_estimated
        )
    except ValueError as error:
        raise NotLearnable(TwinFact.CANNOT_FLY, reason=error) from None


def _simulated_motion(
    twin: Twin, dt: float, setpoints: Array, torque: Array, seed: int, *, is_estimated: bool
) -> Array:
    """Flies the twin in the simulator (``sitl_scenarios.replay.replay_setpoints``).

    The twin is passed as the text of the vehicle file that users get, so that this flight is the one that they would
    simulate.

    Args:
        twin: simulated vehicle with the identified loops, hover thrust, drag and wind.
        dt: time between samples, s.
        setpoints: setpoints of angle, rad, and rate, rad/s, of roll, pitch and yaw (T, 3, 2).
        torque: wind torque per moment of inertia about the three axes (T, 3), rad/s².
        seed: seed of the sensors' noise.
        is_estimated: whether to return the autopilot's estimate of the motion instead of the true one.

    Returns:
        Angles, rad, and rates, rad/s (T, 3, 2).

    Raises:
        ValueError: the simulator cannot fly it.
    """
    from mavdem.report.vehicle_files import vehicle_text
    from sitl_scenarios.files import scenario_from_table
    from sitl_scenarios.replay import replay_setpoints

    vehicle = tomllib.loads(vehicle_text(twin, ".toml", ""))
    scenario = scenario_from_table({**vehicle, "seed": seed})
    return replay_setpoints(scenario, dt, setpoints, torque, is_estimated=is_estimated)


def wind_torque_realisation(loop: Loop, samples: int, rng: np.random.Generator) -> Array:
    """Draws a random Gaussian wind torque with the spectral density that was identified with a loop.

    Independent normal Fourier coefficients of the right variance are transformed back to time. For n samples of step dt
    and a one-sided density S, real and imaginary part have the variance S n / (4 dt) each.

    Args:
        loop: loop of an axis, with its plant and the time step of its record.
        samples: number n of samples at the time step of the loop's record.
        rng: source of the random numbers.

    Returns:
        Wind torque per moment of inertia (n,), rad/s², with mean 0.
    """
    dt = loop.record.dt
    frequency = np.fft.rfftfreq(samples, dt).astype(np.float64)
    density = np.where(frequency > 0, wind_torque_density(loop.plant, frequency), 0.0)
    real, imaginary = rng.standard_normal((2, len(density)))
    amplitude = np.sqrt(density * samples / (4 * dt))
    return np.fft.irfft(amplitude * (real + 1j * imaginary), samples)


def motion_figures(
    loop: Loop, recorded_motion: Array, simulated_motions: Sequence[Array]
) -> dict[str, list[float]]:
    """Returns figures by which the recorded motion of an axis and simulated ones can be compared.

    Args:
        loop: loop of the axis, with the time step of its record.
        recorded_motion: recorded angle, rad, and rate, rad/s (T, 2); for yaw only the rate (T, 1).
        simulated_motions: simulated angles and rates, (T, 2) each, from flights in different wind.

    Returns:
        Figures by name. "levels" is the simulated power of the rate divided by the recorded one, in dB, in each of the
        ``RATE_BANDS``. The others have two values: of the recorded motion, and the mean of the simulated ones.
        "rate" is the standard deviation of the rate, deg/s. For roll and pitch, "lean" and "sway" are the mean and the
        standard deviation of the angle, degrees.
    """
    dt = loop.record.dt
    # Angle and rate or, for yaw, the rate alone: the last columns of the simulated motions.
    column_count = recorded_motion.shape[1]
    # Motions (M, T, columns): row 0 is the recorded one, the other rows are the simulated ones.
    motions = np.array(
        [recorded_motion, *[motion[:, -column_count:] for motion in simulated_motions]]
    )
    motions = motions[:, round(SETTLING_SECONDS / dt) :]
    rates = motions[..., -1]
    figures = {"rate": np.degrees(rates.std(axis=1))}
    if loop.axis != "yaw":
        angles = np.degrees(motions[..., 0])
        figures["lean"] = angles.mean(axis=1)
        figures["sway"] = angles.std(axis=1)
    compared_figures = {"levels": _simulated_levels(rates, dt)}
    for name, values in figures.items():
        compared_figures[name] = [values[0], values[1:].mean()]
    return compared_figures


def _simulated_levels(rates: Array, dt: float) -> list[float]:
    """Returns the power of simulated rates, relative to that of the recorded rate, in each of the ``RATE_BANDS``.

    Args:
        rates: rates in M motions (M, T), rad/s: the recorded one first, then the simulated ones.
        dt: time between samples, s.

    Returns:
        The mean power of the simulated rates over the recorded one in each band, dB.
    """
    # Importing scipy.signal takes half a second.
    from scipy.signal import detrend, welch

    window = int(min(SPECTRUM_WINDOW_SECONDS / dt, rates.shape[1] / 2))
    frequency, density = welch(rates, 1 / dt, nperseg=window, detrend=detrend)
    levels = []
    for low, high in pairwise(RATE_BANDS):
        is_in_band = (frequency >= low) & (frequency < high)
        recorded_power, *simulated_powers = density[:, is_in_band].mean(axis=1)
        power_ratio = np.mean(simulated_powers) / recorded_power
        levels.append(float(DECIBELS_PER_POWER_DECADE * np.log10(power_ratio)))
    return levels
