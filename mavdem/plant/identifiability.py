"""Identifiability: whether a flight determines effect, damping and lag, and if not, why.

All limits and model errors of the gray-box model stand here. They were chosen on simulated flights of three vehicles in
seven winds, steered in four ways and not at all, and validated on as many others (``tools/validation/physical.py``;
docs/physical.md).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.facts import Fact, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt

PARAMETERS = ("effect", "damping", "lag")
"""Names of the physical parameters whose identifiability is judged; the delay goes with the lag."""


class Limits(NamedTuple):
    """Two limits of a measure of error, such as the relative standard deviation, that decide a parameter's status."""

    reported: float
    """Largest error with which a parameter is reported."""

    biased: float
    """Largest error with which a parameter is reported as biased; beyond it is not identifiable."""

    def status(self, error: float) -> Status:
        """Returns whether a parameter with this error is reported, reported as biased, or not identifiable.

        Args:
            error: measure of the parameter's error, in the unit of the limits.

        Returns:
            REPORTED, BIASED or NOT_IDENTIFIABLE.
        """
        if error <= self.reported:
            return Status.REPORTED
        if error <= self.biased:
            return Status.BIASED
        return Status.NOT_IDENTIFIABLE


WIND_SHARE = Limits(reported=0.20, biased=0.29)
"""Limits of the wind torque's share of the variance of all torque, in the band of the motion."""

QUICK_FREQUENCY = 2.0
"""Frequency above which motors turn a multirotor by quick inputs, and hardly in answer to the wind, Hz: a choice."""

MIN_QUICK_SHARE = 0.1
"""Least share of the motors' torque above ``QUICK_FREQUENCY``, unless there is little wind (``MAX_SLOW_WIND_SHARE``).

In simulated flights, axes with doublets, multisines or sticks had 0.3 or more, axes that nobody steered up to 0.06
(docs/evidence/parameters.md). Side steps of the position have less too: where there is wind, right values are withheld.
"""

MAX_SLOW_WIND_SHARE = 0.5
"""Largest share of the wind, if it were as strong as below the band, with which slow inputs determine the effect.

Smooth gusts, the autopilot's answer to them and the motion are all correlated, so that the fit counts most of the
wind's torque as the motors': their share then hides it, and the effect comes out up to 50 % too low. Below the band
the motors cannot follow, so that the wind's torque is seen there, and turbulence is no stronger above. In the same
flights this share was up to 0.1 about yaw, which wind hardly turns, and 1.1 or more where effects were 30 % too low.
"""

RELATIVE_SD = {
    "effect": Limits(reported=0.08, biased=0.20),
    "damping": Limits(reported=0.75, biased=0.75),
    "lag": Limits(reported=0.25, biased=0.35),
}
"""Limits of the relative standard deviation of each parameter."""

SPECTRUM_RANGE = {
    "effect": Limits(reported=0.06, biased=0.30),
    "damping": Limits(reported=0.60, biased=0.90),
    "lag": Limits(reported=0.40, biased=0.40),
}
"""Limits of the range of the logarithm of each estimate over the assumed spectra of the wind torque.

In closed loop the inputs are correlated with the wind torque, so a wrong spectrum biases the estimates.
"""

MAX_ALIAS_SHARE = 0.12
"""Largest share of the commands' variance above half of the Nyquist frequency: beyond, samples miss commands."""

MIN_RESOLVED_RATE = 80.0
"""Rate of the samples, Hz, below which what the commands do between samples matters."""

RESOLVED_LAG = 0.5
"""Shortest motor lag, in time steps of the samples, that can be distinguished from a delay."""

SEPARABLE_LAG = 5 * RESOLVED_LAG
"""Shortest motor lag, in time steps, that samples slower than ``MIN_RESOLVED_RATE`` separate from delay and damping."""


class OmissionErrors:
    """Errors of the estimates by what the model leaves out, as standard deviations unless stated otherwise.

    Simulated flights of nonlinear vehicles differ by so much from the same vehicle linearised and sampled at every
    cycle of its controller: the effect changes with the tilt in wind, and rotors spin up faster than they slow down.
    """

    likelihood_factor = 3.0
    """Factor on the likelihood's standard deviation, as the wind torque's spectrum differs from the model's."""

    effect = 0.02
    """Error common to the effects of all motors, relative to the effect."""

    motor = 0.015
    """Separate error of the effect of each motor, relative to the effect."""

    damping = 0.3
    """Error of the damping, 1/s."""

    lag = 0.08
    """Error of the lag, relative to the lag."""

    delay = 0.002
    """Error of the delay, s, besides that by a lag that is taken for it."""

    unpredicted_effect = 0.25
    """Error common to the effects by commands that nothing predicts, for each unit of their share of the variance.

    Noise of the gyro that a high gain turns into commands lasts for one cycle of the controller, and a log that has
    only some of the cycles cannot tell. The fit takes such commands to last for a whole step. This value, and that of
    the lag, were chosen on half of the simulated flights of ``tools/validation/parameter_coverage.py``.
    """

    unpredicted_lag = 1.0
    """Relative error of the lag for each unit of that share."""

    thrust_curve = 3**-0.5
    """Error common to the effects for each unit of their relative change over one standard deviation of the commands.

    An effect that changes with the command is known for the commands of the flight. At which of them it is meant, one
    fit cannot tell: anywhere within one standard deviation, as likely at each, which has 1/√3 standard deviations.
    """

    thrust_curve_damping = 11.0
    """Error of the damping for each unit of that change of the effect, 1/s.

    An effect that changes with the command turns quick commands into slow torque, which a fit takes for damping. This
    was chosen on half A of the flights of ``tools/validation/parameter_coverage.py`` with motors at their limits.
    """

    unidentified_effect = 0.4
    """Error of an effect that is not identifiable, relative to the effect."""

    wind_bias = -0.15
    """Likely bias of an effect with much wind torque, relative to the effect; its error is as large."""

    lag_bias = 0.1
    """Probable bias of an effect if the lag is not resolved, relative to the effect; its error is as large.

    A delay of the rate, such as a gyro filter's, is then estimated as motor lag.
    """

    unresolved_lag_damping = 1.2
    """Error of the damping if the lag is not resolved, 1/s."""

    between_flights = 0.1
    """Change of the effect from flight to flight by battery voltage and load, relative to the effect."""

    wind = 0.15
    """Error of the wind torque's course by drag and cross-coupling, relative to its standard deviation."""

    wind_sd = 0.1
    """Error of the wind torque's standard deviation and of its mean, relative to its standard deviation."""


class NotIdentifiable(NamedTuple):
    """The result for a flight that has no physical parameters."""

    reason: Fact
    """Reason why there are no physical parameters."""

    refusal: Fact | None = None
    """Reason why there are also none of the plant in its closed loop, if these were requested."""


class IdentifiabilityMeasures(NamedTuple):
    """Measures of a fit that decide whether its parameters are identifiable; dictionaries by parameter name."""

    wind_share: float
    """Share of the wind torque in the variance of its sum with the motors' torque, in the band of the motion."""

    alias_share: float
    """Share of the commands' variance above half of the Nyquist frequency."""

    sd: dict[str, float]
    """Relative standard deviation of each estimate, with ``OmissionErrors.likelihood_factor``.

    That of the damping has its error by the thrust curve, too.
    """

    spectrum_range: dict[str, float]
    """Range of the logarithm of each estimate over the assumed spectra of the wind torque."""

    lag: float
    """Estimated lag without its lower bound, s."""

    dt: float
    """Time step of the samples, s."""

    unpredicted_share: float = 0.0
    """Share of the commands' variance that the samples before do not predict."""

    quick_share: float = 1.0
    """Share of the motors' torque, in the band of the motion, that lies above ``QUICK_FREQUENCY``."""

    slow_wind_share: float = 0.0
    """Power of the wind torque over all torque's, if the wind is as strong in the band as below it; may exceed 1."""

    thrust_curve: float = 0.0
    """Relative change of the effect for one standard deviation of the inputs; 0 if the model has none."""

    motor_deviation: float = 0.0
    """Largest deviation of a motor's effect from the mixer's direction, relative to the mean effect."""

    motor_deviation_sd: float = 1.0
    """Prior standard deviation of that deviation, relative to the mean effect."""

    @property
    def lag_unresolved(self) -> bool:
        """Whether the motors are quicker than one step of samples that are fast enough (``MIN_RESOLVED_RATE``)."""
        return self.lag < self.dt <= 1 / MIN_RESOLVED_RATE

    @property
    def thrust_curve_damping_error(self) -> float:
        """Error of the damping by the change of the effect with the command, 1/s; negative if the effect falls."""
        return OmissionErrors.thrust_curve_damping * self.thrust_curve


class _Check(NamedTuple):
    """Result of one check whether a parameter is identified."""

    status: Status
    """Status that the parameter has by this check alone; REPORTED if it passes."""

    doubt: Fact
    """The reason, if the check fails."""


class Identifiability(NamedTuple):
    """What a flight identifies of a plant: by the name of the parameter, "effect", "damping" or "lag"."""

    statuses: dict[str, Status]
    """Status of each parameter."""

    reasons: dict[str, Fact | None]
    """Reason of each status; None for a parameter that is reported."""


def identifiability(
    measures: IdentifiabilityMeasures,
) -> Identifiability:
    """Judges which of effect, damping and lag a flight identifies.

    A parameter may fail several checks, such as the check of how much of the torque is wind; the worst of them decides.
    Damping and lag get no better status than the effect, because a fit compensates a wrong effect by a wrong lag.

    Args:
        measures: measures of the fit that are compared with the limits of this module.

    Returns:
        Status by parameter name; and reason by parameter name, None for a parameter that is reported.
    """
    statuses = dict[str, Status]()
    reasons = dict[str, Fact | None]()
    # The effect comes first in PARAMETERS, so that its status is known when damping and lag are judged.
    effect_status = Status.REPORTED
    for name in PARAMETERS:
        failed_checks = []
        for check in _checks_of_parameter(name, measures):
            if check.status != Status.REPORTED:
                failed_checks.append(check)
        failed_statuses = [check.status for check in failed_checks]
        if effect_status != Status.REPORTED and effect_status not in failed_statuses:
            doubt = Fact(ParameterDoubt.FOLLOWS_FROM_EFFECT, status=effect_status)
            failed_checks.append(_Check(effect_status, doubt))
        statuses[name], reasons[name] = _worst_status(failed_checks)
        if name == "effect":
            effect_status = statuses[name]
    return Identifiability(statuses, reasons)


def _worst_status(failed_checks: list[_Check]) -> tuple[Status, Fact | None]:
    """Returns the status of a parameter by the worst of the checks that it failed, and the reason for it.

    If the parameter is not identifiable by any check, the reason states only these checks, and none by which
    it is merely biased.

    Args:
        failed_checks: failed checks of one parameter, each BIASED or NOT_IDENTIFIABLE; empty if it passed all.

    Returns:
        The status; and the reason, as one fact also for several checks, or None if the parameter is
        reported.
    """
    if not failed_checks:
        return Status.REPORTED, None
    status = Status.BIASED
    level = Level.WATCH
    if any(check.status == Status.NOT_IDENTIFIABLE for check in failed_checks):
        status = Status.NOT_IDENTIFIABLE
        level = Level.UNKNOWN
    doubts = [check.doubt for check in failed_checks if check.status == status]
    if len(doubts) == 1:
        return status, doubts[0].replace(level)
    return status, Fact(ParameterDoubt.SEVERAL_DOUBTS, level, reason=doubts)


def _checks_of_parameter(name: str, measures: IdentifiabilityMeasures) -> Iterator[_Check]:
    """Compares the measures of a fit with their limits, and yields the result of each check for one parameter.

    Args:
        name: the parameter, "effect", "damping" or "lag".
        measures: measures of the fit.

    Yields:
        Each check, with the status REPORTED if it is passed. Some checks are omitted if they cannot fail.
    """
    rate = 1 / measures.dt
    yield _check_of_wind(name, measures)

    # Without quick inputs the motors answer slow wind only, and its torque cannot be told from theirs.
    is_slow_motion = measures.quick_share < MIN_QUICK_SHARE
    has_wind = measures.slow_wind_share > MAX_SLOW_WIND_SHARE
    if name == "effect" and is_slow_motion and has_wind:
        only_slow_inputs = Fact(
            ParameterDoubt.INPUTS_TOO_SLOW, share=measures.quick_share, frequency=QUICK_FREQUENCY
        )
        yield _Check(Status.NOT_IDENTIFIABLE, only_slow_inputs)

    if measures.alias_share > MAX_ALIAS_SHARE:
        yield _failed_check_of_command_speed(measures.alias_share, rate)

    # Random error of the estimate.
    relative_sd = measures.sd[name]
    uncertain_estimate = Fact(ParameterDoubt.ESTIMATE_UNCERTAIN, share=relative_sd)
    yield _Check(RELATIVE_SD[name].status(relative_sd), uncertain_estimate)

    yield _check_of_spectrum(name, measures.spectrum_range[name])

    if name == "effect":
        yield _check_of_effect(measures)

    # A lag shorter than RESOLVED_LAG time steps cannot be distinguished from a delay.
    if name == "lag" and measures.lag < RESOLVED_LAG * measures.dt:
        too_short_lag = Fact(ParameterDoubt.LAG_TOO_SHORT, time_step=measures.dt)
        yield _Check(Status.NOT_IDENTIFIABLE, too_short_lag)

    # At a low sampling rate a short motor lag cannot be distinguished from the delay, nor damping from both.
    is_slow = rate < MIN_RESOLVED_RATE
    if name != "effect" and is_slow and measures.lag < SEPARABLE_LAG * measures.dt:
        mixed = Fact(ParameterDoubt.MIXED_WITH_DELAY, rate=rate, least_rate=MIN_RESOLVED_RATE)
        yield _Check(Status.BIASED, mixed)


def _check_of_wind(name: str, measures: IdentifiabilityMeasures) -> _Check:
    """Returns the check whether the wind moved the vehicle too much for one parameter to be identified.

    Args:
        name: the parameter, "effect", "damping" or "lag".
        measures: measures of the fit, with the share of the wind in the torque that moved the vehicle.
    """
    wind_status = WIND_SHARE.status(measures.wind_share)
    # Autopilots counteract the wind, so the motors seem to have less effect than they have, and the effect is estimated
    # too low.
    has_known_bias = wind_status == Status.BIASED and name == "effect"
    wind_doubt = Fact(
        ParameterDoubt.WIND_SHARE_HIGH,
        share=measures.wind_share,
        share_limit=WIND_SHARE.reported,
        bias=OmissionErrors.wind_bias if has_known_bias else None,
    )
    return _Check(wind_status, wind_doubt)


def _failed_check_of_command_speed(alias_share: float, rate: float) -> _Check:
    """Returns the failed check of commands that change faster than the sampling rate.

    Neither they nor the motion that they cause are completely recorded.

    Args:
        alias_share: share of the commands' variance above half of the Nyquist frequency.
        rate: sampling rate, Hz.
    """
    # The log does not show how fast they are. So the advice is the rate from which on it hardly matters what they do
    # between samples, or, for a log that has this rate, all cycles of the controller.
    least_rate = MIN_RESOLVED_RATE if rate < MIN_RESOLVED_RATE else None
    too_fast_commands = Fact(
        ParameterDoubt.COMMANDS_TOO_FAST, share=alias_share, rate=rate, least_rate=least_rate
    )
    return _Check(Status.NOT_IDENTIFIABLE, too_fast_commands)


def _check_of_spectrum(name: str, spectrum_range: float) -> _Check:
    """Returns the check whether the estimate of one parameter depends on the spectrum of the wind, which is assumed.

    Args:
        name: the parameter, "effect", "damping" or "lag".
        spectrum_range: range of the logarithm of the estimate over the assumed spectra.
    """
    # The fact states the range of the logarithm as a relative change; beyond a factor of e it contains no number.
    relative_change = np.expm1(spectrum_range) if spectrum_range < 1 else None
    depends_on_spectrum = Fact(ParameterDoubt.DEPENDS_ON_WIND_SPECTRUM, share=relative_change)
    return _Check(SPECTRUM_RANGE[name].status(spectrum_range), depends_on_spectrum)


def _check_of_effect(measures: IdentifiabilityMeasures) -> _Check:
    """Returns the check whether the effect of the motors is biased, by filters of the gyro or by a motor that differs.

    If the motor lag is too short to be resolved, delays by gyro filters are estimated as motor lag, which biases the
    effect. Such an effect contradicts the mixer, the prior of the motors' effects, and shows nothing about the motors.

    Where a flight contradicts the mixer otherwise, a motor does not answer its command, or the model does not describe
    the axis: neither single effects nor their errors are right.

    Args:
        measures: measures of the fit.
    """
    if measures.lag_unresolved:
        filter_as_lag = Fact(ParameterDoubt.FILTER_TAKEN_FOR_LAG, bias=OmissionErrors.lag_bias)
        return _Check(Status.BIASED, filter_as_lag)
    is_contradicted = measures.motor_deviation > SIGNIFICANT_SIGMAS * measures.motor_deviation_sd
    motors_differ = Fact(ParameterDoubt.MOTORS_DIFFER, share=measures.motor_deviation)
    return _Check(Status.BIASED if is_contradicted else Status.REPORTED, motors_differ)
