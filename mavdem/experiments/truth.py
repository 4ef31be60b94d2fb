"""The true parameters and wind torque of a simulated flight, compared with those that a model has learned."""

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES
from mavdem.dem import Learned
from mavdem.errors import Unreadable, error_message
from mavdem.facts.forecasts import ComparedWithTruth, ForecastFact
from mavdem.facts.identifiability import Status
from mavdem.files import PathName
from mavdem.flight import Flight
from mavdem.ingest.motors import name_without_place
from mavdem.plant import Physical, WindTorque

MAX_RATE_DIFFERENCE = 0.3
"""Largest difference of a flight's rate from its truth file's, root mean square over standard deviation. It is
0.01 in simulated flights of 100 Hz, and 1.4 with the truth of another flight."""

MOTOR_UNIT = "µs"
"""Unit of the motor outputs that a truth file is written for."""


class ComparedParameter(NamedTuple):
    """An estimated physical parameter and its truth."""

    name: str
    unit: str
    """Unit of estimate, half width and truth."""
    estimate: float
    half_width: float
    """Half width of the 90 % interval of the estimate; NaN where it is not identifiable."""
    truth: float
    status: Status = Status.REPORTED

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; ``None`` where there is no interval."""
        if isnan(self.half_width):
            return None
        return bool(abs(self.estimate - self.truth) <= self.half_width)


class ComparedWind(NamedTuple):
    """The estimated wind torque and its truth, rad/s²."""

    correlation: float
    """Correlation of the two torques over time; NaN where one of them is constant."""
    sd: float
    """Standard deviation of the estimate."""
    true_sd: float
    """Standard deviation of the truth."""
    inside: float
    """Share of samples whose truth is in the 90 % band."""
    resolved: bool
    """Whether the estimate is larger than its expected errors."""
    mean: ComparedParameter
    """The steady part."""


class TruthComparison(NamedTuple):
    """The estimates of a simulated flight and their truth."""

    source: str
    """Name of the truth file."""
    parameters: tuple[ComparedParameter, ...]
    """Physical parameters; empty where there are none."""
    wind: ComparedWind | None
    """The wind torque; ``None`` where it was not estimated."""


class Truth(NamedTuple):
    """One axis of a truth file of ``mavdem fly``: N rows, r motors."""

    source: str
    """Name of the file."""
    time: Array
    """(N,) times of the rows, s on the boot clock."""
    rate: Array
    """(N,) body rate as the autopilot measured it, rad/s."""
    disturbance: Array
    """(N,) wind torque, rad/s²."""
    after_failure: Array
    """(N,) 1 after a motor failed, else 0."""
    effect: Array
    """(r,) angular acceleration by each motor, rad/s² per µs."""
    effect_after_failure: Array
    """(r,) the same after a motor failed."""
    damping: float
    """Rate damping, 1/s."""
    lag: float
    """Motor time constant, s."""
    delay: float
    """Delay of the commands, s."""

    def effect_at(self, time: Array) -> Array:
        """Returns the effect of the motors in a part of the flight, with the failure if it lasted for most of it.

        Args:
            time: (T,) times of the part's samples, s.

        Returns:
            (r,) effect of each input on the axis.
        """
        # ``after_failure`` is 0 or 1. Interpolated and compared with one half, it has the value of the nearer sample.
        is_after_failure = np.interp(time, self.time, self.after_failure) >= 0.5
        if is_after_failure.mean() >= 0.5:
            return self.effect_after_failure
        return self.effect


def read_truth(path: PathName, axis: str) -> Truth:
    """Reads one axis of a truth file: the simulator's own parameters and wind torque, written by ``mavdem fly``.

    A truth file is a NumPy archive (``.npz``). It has the effects of the motors on the axis, before and after the
    failure of a motor. If the simulation had no failure, the second ones are missing, and are set to the first ones.

    Args:
        path: path of the file.
        axis: "roll", "pitch" or "yaw".

    Returns:
        Parameters, and disturbance over the time of the simulation, of that axis.

    Raises:
        Unreadable: ``path`` is not a truth file, or cannot be read.
    """
    name = Path(path).name or str(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            effect = file[f"{axis}_effect"]
            truth = Truth(
                source=name,
                time=file["time"],
                rate=file["known_rates"][:, AXES.index(axis)],
                disturbance=file[f"{axis}_disturbance"],
                after_failure=file["weak"],
                effect=effect,
                effect_after_failure=file.get(f"{axis}_effect_weak", effect),
                # The rate is the last state of the simulator's A, and decays at −A's last diagonal entry.
                damping=-float(file[f"{axis}_A"][-1, -1]),
                lag=float(file["lag"][0]),
                delay=float(file["delay"]),
            )
        _require_equal_lengths(truth)
        return truth
    except OSError as error:
        cause = error_message(error)
    except (LookupError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        # The file is not an archive of arrays, or not of these arrays.
        cause = ""
    raise Unreadable(ForecastFact.NO_TRUTH_FILE, name=name, error=cause)


def _require_equal_lengths(truth: Truth) -> None:
    """Raises ``ValueError`` where columns of a truth file have other lengths than its times, or effects differ."""
    # Both functions raise this error themselves when they are given arrays that do not fit together.
    for column in (truth.rate, truth.disturbance, truth.after_failure):
        np.interp(0.0, truth.time, column)
    np.stack([truth.effect, truth.effect_after_failure])


def read_truth_of_flight(flights: Sequence[Flight], path: PathName) -> Truth:
    """Reads the truth of a simulated flight, and checks that it belongs to this flight.

    The truth file contains the rate that the simulated autopilot measured. In its own flight that is the recorded rate,
    up to resampling. A root mean square difference of ``MAX_RATE_DIFFERENCE`` standard deviations shows another flight.

    Args:
        flights: segments of one flight, with the times of their samples on the boot clock, s. The last output is the
            rate of the axis, rad/s, by whose name, such as "roll rate", the axis is chosen.
        path: path of the truth file.

    Returns:
        The truth of that axis, for the whole simulated flight.

    Raises:
        Unreadable: the file is not a truth file, or belongs to another flight.
        ValueError: the last output is not the rate of an axis.
    """
    name = flights[0].output_names[-1]
    axis = name.split(" ")[0]
    if axis not in AXES:
        raise ValueError(f"the last output must be the rate of roll, pitch or yaw, not {name}")
    truth = read_truth(path, axis)
    for segment in flights:
        time = segment.time
        rate = segment.outputs[:, -1]
        # Before and after the truth file the rate is NaN, which makes the difference NaN.
        true_rate = np.interp(time, truth.time, truth.rate, np.nan, np.nan)
        difference = np.sqrt(np.mean((rate - true_rate) ** 2)) / rate.std()
        # A NaN, where the truth file does not cover the segment, is no small difference either.
        if not difference < MAX_RATE_DIFFERENCE:
            raise Unreadable(
                ForecastFact.TRUTH_OF_ANOTHER_FLIGHT,
                time=time[0],
                end_time=time[-1],
                subject=name,
                name=truth.source,
            )
    return truth


def compare_with_truth(
    learned: Learned, flights: Sequence[Flight], truth: Truth
) -> TruthComparison:
    """Compares a learned model with the simulator's truth: physical parameters and wind torque, each side by side.

    Args:
        learned: the model of one axis. Physical parameters or wind torque that it lacks are not compared.
        flights: the segments that it was trained on, at whose times the wind torque is compared.
        truth: truth of these flights, as :func:`read_truth_of_flight` returns it.

    Returns:
        Each parameter and the wind torque as learned and in truth, with their errors.

    Raises:
        ValueError: ``flights`` are not what ``learned`` was trained on.
    """
    if sum(len(flight) for flight in flights) != len(learned.record):
        raise ValueError("flights must be what the model was trained on")
    time = np.concatenate([segment.time for segment in flights])
    parameters: tuple[ComparedParameter, ...] = ()
    if learned.physical is not None:
        effects = compared_effects(learned.physical, flights[0], truth, time)
        parameters = (*effects, *compared_dynamics(learned.physical, truth))
    wind = None
    if learned.wind_torque is not None:
        wind = compared_wind(learned.wind_torque, truth, time)
    return TruthComparison(truth.source, parameters, wind)


def compared_effects(
    physical: Physical, flight: Flight, truth: Truth, time: Array
) -> Iterator[ComparedParameter]:
    """Yields the control effectiveness of each motor and the mean of their magnitudes, with the true values.

    The effectiveness is the angular acceleration by a change of a motor's output, rad/s² per µs of pulse width.

    Args:
        physical: estimated control effectiveness, damping, time constant and delay.
        flight: a segment, for the names and units of its inputs.
        truth: the simulator's own parameters and wind torque of the flight.
        time: (T,) times of all samples of the flight, s. The effect that held for most of them counts: it changes when
            a motor fails.

    Yields:
        r motors and their mean; nothing if the inputs are not the motors' outputs in µs, but for example the
        controller's demand.
    """
    if flight.input_units != (MOTOR_UNIT,) * truth.effect.size:
        return
    unit = f"rad/s² per {MOTOR_UNIT}"
    status = physical.status["effect"]
    true_effect = truth.effect_at(time)
    # Half widths (r,) of the 90 % intervals of the effects.
    half_widths = physical.interval().effect
    for motor, input_name in enumerate(flight.input_names):
        yield ComparedParameter(
            f"{ComparedWithTruth.EFFECT_OF} {name_without_place(input_name)}",
            unit=unit,
            estimate=float(physical.effect[motor]),
            half_width=float(half_widths[motor]),
            truth=float(true_effect[motor]),
            status=status,
        )
    mean_effect, mean_half_width = physical.mean_effect()
    true_mean = float(abs(true_effect).mean())
    yield ComparedParameter(
        ComparedWithTruth.MEAN_EFFECT,
        unit=unit,
        estimate=mean_effect,
        half_width=mean_half_width,
        truth=true_mean,
        status=status,
    )


def compared_dynamics(physical: Physical, truth: Truth) -> Iterator[ComparedParameter]:
    """Yields the rate damping (1/s), the motor time constant (s) and the delay (s), each with its true value.

    Args:
        physical: the estimated parameters, with the half widths of their 90 % intervals. The status of each is
            reported, biased (by closed-loop control), or not identifiable.
        truth: the values with which the flight was simulated.

    Yields:
        Estimate with half width, and truth, of each of the three parameters.
    """
    _, damping_half_width, lag_half_width, delay_half_width = physical.interval()
    lag_status = physical.status["lag"]
    yield ComparedParameter(
        ComparedWithTruth.DAMPING,
        unit="1/s",
        estimate=physical.damping,
        half_width=damping_half_width,
        truth=truth.damping,
        status=physical.status["damping"],
    )
    yield ComparedParameter(
        ComparedWithTruth.LAG_OF_THE_MOTORS,
        unit="s",
        estimate=physical.lag,
        half_width=lag_half_width,
        truth=truth.lag,
        status=lag_status,
    )
    # The delay has no status of its own: it is identified together with the motor time constant.
    yield ComparedParameter(
        ComparedWithTruth.DELAY,
        unit="s",
        estimate=physical.delay,
        half_width=delay_half_width,
        truth=truth.delay,
        status=lag_status,
    )


def compared_wind(wind: WindTorque, truth: Truth, time: Array) -> ComparedWind:
    """Compares the estimated wind torque with the one that the simulator applied.

    The wind torque is the angular acceleration that the motors do not cause, rad/s².

    Args:
        wind: the estimate at T samples, with the half widths of its 90 % band and its steady part.
        truth: the simulated torque, at times of its own.
        time: (T,) times of the estimate's samples on the boot clock, s.

    Returns:
        Correlation, standard deviations and the share of the truth inside the band; and the steady part beside its
        truth, which is the mean over these samples.
    """
    # The simulator has its own sampling step.
    true_torque = np.interp(time, truth.time, truth.disturbance)
    # A constant torque, such as in calm air, has no correlation.
    correlation = nan
    if true_torque.std() and wind.torque.std():
        correlation = float(np.corrcoef(wind.torque, true_torque)[0, 1])
    is_in_band = abs(wind.torque - true_torque) <= wind.band
    steady_part = ComparedParameter(
        ComparedWithTruth.STEADY_PART,
        unit="rad/s²",
        estimate=wind.mean,
        half_width=wind.mean_band,
        truth=float(true_torque.mean()),
    )
    return ComparedWind(
        correlation=correlation,
        sd=wind.sd,
        true_sd=float(true_torque.std()),
        inside=float(np.mean(is_in_band)),
        resolved=wind.resolved,
        mean=steady_part,
    )
