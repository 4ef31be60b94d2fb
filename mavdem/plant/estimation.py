"""Estimation of physical parameters from a whole flight, cut into windows of about 7 s (docs/physical.md).

Effect, damping and lag are the same in all windows; trim and the level of the wind are each window's own.
"""

from contextlib import suppress

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.confidence import STRONG_EVIDENCE_NATS
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, inverse, one_thread
from mavdem.dem.forecast.joint import axis_mixer
from mavdem.dem.record import MIN_MOTORS, Record, TrainingData
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPhysical
from mavdem.immutable import freeze
from mavdem.plant.closed_loop.spectra import ComplexArray
from mavdem.plant.fitting import WINDS, GrayBoxFit, directed, fitted
from mavdem.plant.identifiability import (
    PARAMETERS,
    IdentifiabilityFigures,
    NotIdentifiable,
    OmissionErrors,
    identifiability,
)
from mavdem.plant.likelihood import REFINEMENTS, FlightWindows, Parameters
from mavdem.plant.parameters import Physical, WindComponent, slopes_of, updated, windows_of
from mavdem.unit_errors import suspected_unit_error

CHOOSING_WINDOWS = 10  # of which the wind's spectrum and the refinements are chosen
# of the roll motion
MOTION_BAND_HZ = (0.4, 6.0)


def physical(train: TrainingData, prior: Physical | None = None) -> Physical | NotIdentifiable:
    """Estimates the motors' effect, damping and lag from all that is given.

    >>> str(mavdem.dem.physical(mavdem.read_flight("flight.tlog")[:2000]).status["effect"])
    'biased'

    The rate, rad/s, is the output of ``train``, a ``Flight`` or segments of one, that is the derivative of another, or
    the only one. A ``prior`` is of an earlier flight of the vehicle: what this one does not identify stays, but for
    what changes between flights; one of other inputs, or that the flight contradicts, counts for nothing. Returns the
    parameters, each with its status; or the reason why there are none: units, no output is the rate of another, too few
    samples, no motor moves, or no likelihood.
    """
    record = Record.from_flights(train)
    if slip := suspected_unit_error(record.outputs, record.dt):
        return NotIdentifiable(slip)
    try:
        # what overflows is not finite, and no step goes there
        with one_thread(), np.errstate(all="ignore"):
            return _estimated(windows_of(record), _mixer(record), prior)
    except NotLearnable as error:
        return NotIdentifiable(error.fact)
    except ValueError:  # LinAlgError is one
        return NotIdentifiable(Fact(NoPhysical.NO_LIKELIHOOD))


def _mixer(record: Record) -> Array | None:
    """(r,) effect directions, as known or those of the X or plus that the joint model finds; else ``None``."""
    if record.effect_directions is not None or record.inputs.shape[1] < MIN_MOTORS:
        return record.effect_directions
    turning = axis_mixer(record)[:, 0]
    sizes = abs(turning[turning != 0])
    return turning if np.ptp(sizes) < ROUNDING_TOLERANCE else None


def _estimated(
    windows: FlightWindows, directions: Array | None, prior: Physical | None
) -> Physical:
    fits, refined = _chosen(windows, directions)
    whole = (
        fitted(refined.parameters, windows, refined.theta)
        if len(windows.rate) > CHOOSING_WINDOWS
        else refined
    )
    by_spectrum = [_logarithms(_values(fit.parameters, fit.theta, windows.dt)) for fit in fits]
    plant = _physical(whole, np.ptp(by_spectrum, axis=0), windows)
    return plant if prior is None else updated(plant, prior)


def _chosen(
    windows: FlightWindows, directions: Array | None
) -> tuple[list[GrayBoxFit], GrayBoxFit]:
    """A fit for each wind that has one, and the most probable one with the refinements that it bears out."""
    count = len(windows.rate)
    some = windows.some(np.linspace(0, count - 1, min(count, CHOOSING_WINDOWS)).round().astype(int))
    plain, start = directed(some, directions)
    fits = []
    for wind in WINDS:
        parameters = plain._replace(wind=wind)
        first = parameters.prior[0]
        first[: len(start) - 1] = start[:-1]
        first[-1] = start[-1]
        try:
            fits.append(fitted(parameters, some, first))
            start = fits[-1].theta
        except LinAlgError:
            continue
    chosen = max(fits, key=lambda fit: fit.evidence)
    for name in REFINEMENTS:
        parameters = chosen.parameters._replace(refinements=(*chosen.parameters.refinements, name))
        with suppress(LinAlgError):
            refined = fitted(parameters, some, np.append(chosen.theta, 0.0), STRONG_EVIDENCE_NATS)
            chosen = max(chosen, refined, key=lambda fit: fit.evidence)
    return fits, chosen


def _values(parameters: Parameters, theta: Array, dt: float) -> Array:
    """(r + 3,) effects, damping, lag and delay."""
    effect = parameters.effect(theta)
    return np.array(
        [
            *effect,
            parameters.damping(theta),
            parameters.lag(theta, dt),
            theta[parameters.motors + 3],
        ]
    )


def _logarithms(values: Array) -> Array:
    """(3,) of mean effect, damping and lag."""
    return np.log([abs(values[:-3]).mean(), *values[-3:-1]])


def _physical(whole: GrayBoxFit, spectrum_range: Array, windows: FlightWindows) -> Physical:
    """In the units of the flight, with what the model leaves out."""
    parameters = whole.parameters
    theta = whole.theta
    errors = OmissionErrors

    def values_at(theta: Array) -> Array:
        return _values(parameters, theta, windows.dt)

    values = values_at(theta)
    r = parameters.motors
    effect = values[:r]
    damping, lag, delay = values[r:].tolist()
    slopes = slopes_of(values_at, theta, values).T
    covariance = slopes @ inverse(whole.curvature) @ slopes.T
    relative = np.zeros((3, r + 3))
    relative[0, :r] = np.sign(effect) / abs(effect).sum()
    relative[1, r] = 1 / damping
    relative[2, r + 1] = 1 / lag
    sd = errors.own * np.sqrt(np.diag(relative @ covariance @ relative.T))
    figures = IdentifiabilityFigures(
        wind_share=_wind_share(parameters, theta, windows, whole.levels),
        alias_share=_alias_share(parameters, theta, windows),
        sd=dict(zip(PARAMETERS, sd.tolist(), strict=True)),
        spectrum_range=dict(zip(PARAMETERS, spectrum_range.tolist(), strict=True)),
        lag=np.exp(theta[r + 2]),
        dt=windows.dt,
    )
    status, reasons = identifiability(figures)
    # The wind's spectrum is as wrong for all motors.
    alike = np.eye(r + 3)
    alike[:r, :r] = np.outer(effect, relative[0, :r])
    covariance += (errors.own**2 - 1) * alike @ covariance @ alike.T
    # The range of three values is 3/√π of their standard deviations in the mean (Tippett 1925).
    varied = np.pi * np.square(spectrum_range / 3)
    bias = 0.0
    if status["effect"] == Status.BIASED:
        bias = errors.lag_bias if figures.quick else errors.wind_bias
    common = varied[0] + errors.effect**2 + bias**2
    if status["effect"] == Status.NOT_IDENTIFIABLE:
        common += errors.unknown_effect**2
    covariance[:r, :r] += np.outer(effect, effect) * common
    damped = errors.lag_damping if figures.quick else errors.damping
    own = [
        *(effect * errors.motor) ** 2,
        damping**2 * varied[1] + damped**2,
        lag**2 * (varied[2] + errors.lag**2),
        errors.delay**2,
    ]
    covariance += np.diag(own)
    scale = np.append(np.full(r, 1 / windows.unit), np.ones(3))
    level = np.sqrt(np.mean(whole.levels**2))
    sizes = level * parameters.sizes(theta)
    refined = zip(parameters.refinements, theta[parameters.noise_index + 1 :].tolist(), strict=True)
    estimate = Physical(
        effect=effect / windows.unit,
        damping=damping,
        lag=lag,
        delay=max(delay, 0.0),
        covariance=covariance * np.outer(scale, scale),
        status=status,
        reasons=reasons,
        bias=bias,
        wind_share=figures.wind_share,
        components=tuple(
            map(WindComponent, parameters.wind, sizes.tolist(), parameters.times(theta).tolist())
        ),
        noise=level * float(parameters.noise(theta)),
        refinements=dict(refined),
        windows=len(windows.rate),
    )
    return freeze(estimate)


def _wind_share(
    parameters: Parameters,
    theta: Array,
    windows: FlightWindows,
    levels: Array,
) -> float:
    """Of the variance of wind and motors together, in the band of the motion; windows count as they do in the fit."""
    turn = windows.turn[1:-1]
    band = (2 * np.pi * MOTION_BAND_HZ[0] <= turn) & (turn <= 2 * np.pi * MOTION_BAND_HZ[1])
    motors = parameters.driven(theta[None], windows)[0]
    turning = np.hypot(turn, parameters.damping(theta)) * band
    wind_power, motor_power = (
        float(np.mean(np.sum(abs(turning * _tapered(part)) ** 2, axis=1) / levels**2))
        for part in (windows.rate - motors, motors)
    )
    return wind_power / (wind_power + motor_power)


def _alias_share(parameters: Parameters, theta: Array, windows: FlightWindows) -> float:
    """The share of the commands' variance above half of the Nyquist frequency, each window without its mean."""
    commands = np.einsum("crwf,r->wf", windows.inputs[:2], parameters.effect(theta))
    power = abs(_tapered(commands)) ** 2
    return power[:, power.shape[1] // 2 :].sum() / power.sum()


def _tapered(transform: ComplexArray) -> ComplexArray:
    """Twice a transform (W, F) under Hann's window, but for its ends."""
    return transform[:, 1:-1] - (transform[:, :-2] + transform[:, 2:]) / 2
