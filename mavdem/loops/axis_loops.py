"""Rate and attitude loop of one axis, whether they have enough stability margin, and the same loops with other gains.

Margins are of the estimated plant and of draws from its posterior; ``advice`` looks for gains that keep them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.dem.record import Record
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import LoopFact, ResponseFact
from mavdem.facts.model import ModelName
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.controllers import Controller
from mavdem.loops.margins import (
    FINE_GRID,
    AttitudeLoop,
    FrequencyGrid,
    Margins,
    OpenLoop,
    PlantResponse,
    RateLoop,
    attitude_loop,
    plant_response,
    rate_loop,
)
from mavdem.loops.measured_response import MeasuredResponse
from mavdem.plant import Physical
from mavdem.plant.parameters import ESTIMATE, wind_torque_density

if TYPE_CHECKING:
    from mavdem.loops.advice import Advice


class MarginTarget(NamedTuple):
    """Margins that a loop should have."""

    phase_margin: float
    """Least phase margin, degrees."""
    gain_margin: float
    """Least gain margin, dB."""
    ms: float
    """Largest maximum sensitivity."""

    @property
    def largest_gain_at_crossover(self) -> float:
        """Largest gain |L| at a phase of −180° that leaves the gain margin, such as 0.5 for a margin of 6 dB."""
        return float(10 ** (-self.gain_margin / DECIBELS_PER_DECADE))


MARGIN_TARGETS = {
    "soft": MarginTarget(55.0, 8.0, 1.7),
    "default": MarginTarget(45.0, 6.0, 2.0),
    "sharp": MarginTarget(40.0, 5.0, 2.3),
}
"""Targets by the name that ``mavdem tune --margins`` takes.

A phase margin of 45°, a gain margin of 6 dB and Ms of 2 are the usual ones (K. J. Åström and R. M. Murray, Feedback
Systems, 2nd ed., sec. 10.3).
"""
LOWEST_SCORE = -1.0
"""Least score of margins that a fact reports: unstable loops have minus infinity."""
LARGEST_REPORTED_GAIN_MARGIN = 99.0
"""Gain margin that is reported in the place of an infinite end of an interval, dB."""
SLOW_LOG = (LoopFact.CROSSOVER_FAST, LoopFact.GAIN_MARGIN_EXTRAPOLATED)
"""Cautions that the log hardly shows frequencies that the margins rest on; each states the ``least_rate`` that does."""
DECIBELS_PER_DECADE = 20.0
"""Decibels in a factor of ten of an amplitude."""
AXIS_PARAMETER_PREFIXES = ("ATC_RAT_", "ATC_ANG_", "MC_ROLL", "MC_PITCH", "MC_YAW")
"""Beginnings of the names of parameters that belong to one axis; others concern all axes."""


@dataclass(frozen=True, eq=False, repr=False)
class Loop(Margins):
    """Rate and attitude loop of one axis, of the estimated plant and of draws from its posterior.

    Its characteristics, such as ``phase_margin``, are those of the rate loop.
    """

    axis: str
    """"roll", "pitch" or "yaw"."""
    plant: Physical
    """The plant, identified from the ``record``."""
    record: Record
    """The flight that the plant was identified from."""
    controller: Controller
    """The autopilot's controller of the axis."""
    effectiveness: Array
    """Angular acceleration per demand (N,), rad/s²: of the estimated plant first, then of each draw."""
    dynamics: Array
    """Damping, 1/s, motor lag, s, and delay, s, of each plant (N, 3), without the gyro's filters, in the same order."""
    cautions: Facts = ()
    """What limits how far the margins can be relied on, such as a log that is slow for the loop."""
    measured: MeasuredResponse | None = None
    """The response of the rate in flight, if the log has setpoints."""
    grid: FrequencyGrid = FINE_GRID
    """Frequencies of the responses."""
    shared_plant_response: PlantResponse | None = None
    """Response of the plants, taken from a loop with the same plants, grid and gyro filters; None to compute it."""
    refusal: ClassVar[None] = None
    """Always None: the loops are known. A fact that states why they are not may take the place of a loop."""

    @property
    def model(self) -> ModelName:
        """Name of the model that the plant was identified by."""
        return self.plant.model

    @property
    def has_biased_effectiveness(self) -> bool:
        """Whether wind biases the estimated control effectiveness. The intervals of the margins allow for that."""
        return any(caution.code is LoopFact.EFFECT_BIASED for caution in self.cautions)

    @property
    def is_steered_slowly(self) -> bool:
        """Whether the setpoints end below the rate loop's crossover. The intervals of the margins allow for that."""
        return any(caution.code is LoopFact.STEERING_SLOW for caution in self.cautions)

    @property
    def least_log_rate(self) -> float | None:
        """Rate of the log, Hz, from which on it would show all frequencies of the margins; None if it shows them."""
        rates = [
            caution.figures["least_rate"] for caution in self.cautions if caution.code in SLOW_LOG
        ]
        return max(rates, default=None)

    def is_logged_too_slowly(self, target: MarginTarget) -> bool:
        """Returns whether the log is too slow to be sure that the loops have their margins.

        There are two cases, in which even narrow intervals of the margins do not help:

        - The rate loop crosses over so near to the rate of the log that few samples show the phase there.
        - Its phase reaches −180° beyond the Nyquist frequency, and the gain there may exceed what the gain margin
          permits. The phase is not known beyond that frequency. But if the gain is nowhere larger than permitted, the
          loop has the gain margin at any phase.

        Args:
            target: margins to reach.
        """
        codes = {caution.code for caution in self.cautions}
        if LoopFact.CROSSOVER_FAST in codes:
            return True
        return (
            LoopFact.GAIN_MARGIN_EXTRAPOLATED in codes
            and self._largest_gain_beyond_nyquist > target.largest_gain_at_crossover
        )

    @property
    def _largest_gain_beyond_nyquist(self) -> float:
        """Largest gain |L| of the rate loop above the Nyquist frequency of the record (95 % quantile of its draws)."""
        is_unseen = self.rate.frequency >= 0.5 / self.record.dt
        largest_gains = np.abs(self.rate.response[:, is_unseen]).max(axis=1, initial=0.0)
        return float(np.quantile(largest_gains, INTERVAL_QUANTILES[1]))

    @property
    def advice(self) -> Advice:
        """Gains to set, with what to expect, or why there are none; :func:`mavdem.loops.advice.advise`."""
        from mavdem.loops.advice import advise

        return advise(self)

    @cached_property
    def plant_response(self) -> PlantResponse:
        """The frequency responses of all plants, after the gyro's filters."""
        if self.shared_plant_response is not None:
            return self.shared_plant_response
        return plant_response(self.controller, self.effectiveness, self.dynamics, self.grid)

    @cached_property
    def rate(self) -> RateLoop:
        """The rate loop."""
        return rate_loop(self.controller, self.plant_response)

    @cached_property
    def attitude(self) -> AttitudeLoop:
        """The attitude loop, with the rate loop closed."""
        return attitude_loop(self.controller, self.rate)

    def open_loop(self, name: str) -> RateLoop | AttitudeLoop:
        """Returns one of the two loops by its name, "rate" or "attitude"."""
        return self.attitude if name == "attitude" else self.rate

    @property
    def characteristics(self) -> Mapping[str, Array]:
        """Values (N,) of each characteristic of the rate loop, such as "phase_margin", by its name."""
        return self.rate.characteristics

    def __repr__(self) -> str:
        margins = f"phase_margin={self.phase_margin:.0f}, gain_margin={self.gain_margin:.1f}"
        return f"<Loop {self.axis}: crossover={self.crossover:.2f}, {margins}>"

    def with_parameters(self, parameters: Parameters) -> Loop:
        """Returns the same plant in a loop whose controller has other values of some parameters.

        The response that was measured in flight belongs to the old values, and is left out.

        Args:
            parameters: new values by the autopilot's name.

        Returns:
            A copy of the loop.

        Raises:
            NotLearnable: a value is impossible.
        """
        return self.with_controller(self.controller.with_parameters(parameters))

    def with_controller(self, controller: Controller) -> Loop:
        """Returns the same plant in a loop with another controller, without the response measured in flight.

        Args:
            controller: the controller of the axis.

        Returns:
            A copy of the loop. If the gyro filters are the same, it shares the plant response of this loop, which saves
            time: a search for gains tries hundreds of controllers with one plant.
        """
        has_same_filters = controller.gyro_path == self.controller.gyro_path
        return replace(
            self,
            controller=controller,
            measured=None,
            shared_plant_response=self.plant_response if has_same_filters else None,
        )

    def with_draws(
        self,
        draws: slice,
        effectiveness_factors: Sequence[float] = (1.0,),
        grid: FrequencyGrid = FINE_GRID,
    ) -> Loop:
        """Returns the loop with the estimated plant and some of the draws, each at several control effectivenesses.

        The N plants of a loop are the estimate, in row ``ESTIMATE``, and N - 1 draws from its posterior, which show how
        uncertain it is. Search and judgement of gains use different draws. Scaling the control effectiveness (angular
        acceleration per demand) shows whether margins also hold with a fuller or emptier battery, or a load.

        Args:
            draws: which of the N plants to use. The estimate is placed before them, and repeated if they contain it.
            effectiveness_factors: E factors, by each of which the effectiveness of every plant is multiplied. The first
                should be 1, so that row ``ESTIMATE`` remains the estimate.
            grid: frequencies at which the loop's responses are computed.

        Returns:
            The loop with E · P plants, where P is one more than the number of ``draws``: all plants with the first
            factor, then all with the second, and so on.
        """
        # The estimate must come first again, since the margins of a loop are taken from row ``ESTIMATE``.
        plant_rows = np.append(ESTIMATE, np.arange(len(self.effectiveness))[draws])
        effectiveness = np.outer(effectiveness_factors, self.effectiveness[plant_rows]).ravel()
        # Damping, lag and delay do not depend on the factor: their rows are repeated in the same order.
        dynamics = np.tile(self.dynamics[plant_rows], (len(effectiveness_factors), 1))
        # The shared plant response belongs to this loop's plants and frequencies. Without it, the new loop computes its
        # own.
        return replace(
            self,
            effectiveness=effectiveness,
            dynamics=dynamics,
            grid=grid,
            shared_plant_response=None,
        )

    @property
    def agrees(self) -> bool | None:
        """Whether the rate response measured in flight agrees with the one that the model of the loop predicts.

        None if that is not known: without setpoints in the log, if they explain too little of the rate, or if motors
        were at a limit.
        """
        if self.measured is None:
            return None
        reason = self.measured.reason
        unknown_codes = (ResponseFact.RESPONSE_UNEXPLAINED, ResponseFact.RESPONSE_LIMITED)
        if reason is not None and reason.code in unknown_codes:
            return None
        return reason is None

    @property
    def disagreement(self) -> Fact | None:
        """How the measured response differs from the predicted one; ``None`` if it does not, or is not known."""
        if self.measured is None or self.agrees is not False:
            return None
        return self.measured.reason

    def share_meeting(self, target: MarginTarget) -> float:
        """Returns the fraction of the plants, from 0 to 1, with which rate and attitude loop have the target's margins.

        Args:
            target: margins to reach.
        """
        return float(np.mean(margin_scores(target, self.rate, self.attitude) >= 1))

    @cached_property
    def wind(self) -> Array:
        """Spectral density (F,) of the flight's wind torque at the frequencies of the loop, (rad/s²)²/Hz."""
        return wind_torque_density(self.plant, self.rate.frequency)

    @property
    def lean_in_wind(self) -> float:
        """Standard deviation of the angle about its mean, degrees, in the wind of the flight."""
        return self.angle_deviation(self.wind)

    def angle_deviation(self, torque_density: Array) -> float:
        """Returns the standard deviation σ of the angle that a wind torque causes.

        Its square is σ² = ∫ |G(jω)|² S df, by the trapezoidal rule, with the response G of the closed attitude loop of
        the estimated plant from the wind torque to the angle.

        Args:
            torque_density: density S (F,) of the wind torque at the loop's frequencies, (rad/s²)²/Hz.

        Returns:
            The standard deviation σ, degrees.
        """
        power = np.abs(self.attitude.disturbance[ESTIMATE]) ** 2 * torque_density
        return float(np.degrees(np.sqrt(np.trapezoid(power, self.rate.frequency))))


LOOP_NAMES = ("rate", "attitude")
"""Names of the two loops of an axis, the inner one first."""

LoopsByAxis = dict[str, Loop]
"""Loops by "roll", "pitch" and "yaw"."""


def identified_loops(loops: Mapping[str, object]) -> LoopsByAxis:
    """Returns the loops of the axes on which they are known.

    Args:
        loops: loops by axis, or in place of a loop the reason why it is not known, a ``Fact``.

    Returns:
        The loops by axis; empty if none is known.
    """
    return {axis: loop for axis, loop in loops.items() if isinstance(loop, Loop)}


def margin_rating(loop: Loop, target: MarginTarget = MARGIN_TARGETS["default"]) -> Fact:
    """Returns a rating of whether the rate loop and the attitude loop of an axis have enough stability margin.

    The rating is a fact: a code, a level such as good or bad, and figures, from which reports make a sentence.

    Each margin is divided by its target, and the smallest of these ratios is the score of a loop
    (:func:`margin_scores`). If it is at least 1, the loop has all margins. There is one score for the estimated plant
    and one for each draw from its posterior. The level is "good" if at least 95 % of the scores are at least 1, so that
    the margins are certain; "unknown" if they are, but by a log that is too slow to show them
    (:meth:`Loop.is_logged_too_slowly`); "watch" if fewer are, but the estimate's is; and "bad" otherwise. This is the
    only judgement of margins by a model: lights, decisions, advice and reports all go by it.

    Args:
        loop: rate and attitude loop of one axis.
        target: the smallest phase margin and gain margin, and the largest maximum sensitivity Ms.

    Returns:
        A fact with the margins and 90 % intervals of the weaker of the two loops. ``subject`` names that loop, "rate"
        or "attitude"; ``lacking`` names its margin with the smallest ratio, "phase_margin", "gain_margin" or "ms";
        ``share`` is the lower score of both loops with the estimated plant. ``is_log_slow`` is whether the log is too
        slow for the level "good", and ``unseen_from`` the frequency, Hz, beyond which the gain margin is extrapolated,
        or None.
    """
    # The weaker loop is chosen by the estimated plant.
    rate_score = margin_scores(target, loop.rate)[ESTIMATE]
    attitude_score = margin_scores(target, loop.attitude)[ESTIMATE]
    weaker_name = "rate"
    weaker_loop: OpenLoop = loop.rate
    # The peak of a rate loop that is close to an oscillation may lift the gain of the attitude loop above 1 once more.
    # The margins there are none of the attitude: it is the rate loop that lacks margin.
    is_peak_of_rate = rate_score < 1 and not loop.attitude.has_one_crossover
    if attitude_score < rate_score and not is_peak_of_rate:
        weaker_name = "attitude"
        weaker_loop = loop.attitude
    scores = margin_scores(target, loop.rate, loop.attitude)
    level = Level.BAD
    # If the 5 % quantile of the scores is at least 1, then so are the scores of 95 % of the plants. The method "lower"
    # returns one of the scores. Interpolation with minus infinity, the score of an unstable loop, would give NaN.
    low_probability = 1 - INTERVAL_QUANTILES[1]
    is_log_slow = loop.is_logged_too_slowly(target)
    if np.quantile(scores, low_probability, method="lower") >= 1:
        level = Level.UNKNOWN if is_log_slow else Level.GOOD
    elif scores[ESTIMATE] >= 1:
        level = Level.WATCH
    ratios = margin_ratios(target, weaker_loop)
    # A loop that no gain makes unstable has an infinite gain margin, and reports cannot contain infinity.
    gain_margin_interval = np.minimum(
        weaker_loop.gain_margin_interval, LARGEST_REPORTED_GAIN_MARGIN
    )
    return Fact(
        LoopFact.MARGIN_RATING,
        level,
        subject=weaker_name,
        lacking=min(ratios, key=lambda margin: ratios[margin][ESTIMATE]),
        share=max(scores[ESTIMATE], LOWEST_SCORE),
        phase_margin=weaker_loop.phase_margin,
        # Of unstable loops a margin may be minus infinity, and of a gain that never reaches 1 infinity.
        phase_margin_interval=np.clip(weaker_loop.phase_margin_interval, -180.0, 180.0),
        gain_margin=weaker_loop.gain_margin if isfinite(weaker_loop.gain_margin) else None,
        gain_margin_interval=gain_margin_interval,
        ms=weaker_loop.ms,
        ms_interval=weaker_loop.ms_interval,
        is_log_slow=is_log_slow,
        unseen_from=_nyquist_frequency_below_gain_margin(loop) if weaker_name == "rate" else None,
    )


def _nyquist_frequency_below_gain_margin(loop: Loop) -> float | None:
    """Returns the Nyquist frequency of the record, Hz, if the rate loop reaches −180° only above it; otherwise None.

    The gain margin is read at −180°, so that it is then extrapolated by the model of the loop.
    """
    for caution in loop.cautions:
        if caution.code is LoopFact.GAIN_MARGIN_EXTRAPOLATED:
            return float(caution.figures["rate"])
    return None


def margin_scores(target: MarginTarget, *loops: OpenLoop) -> Array:
    """Returns a score of stability margins for each plant: the least ratio of a margin to its target, over all loops.

    The least ratio is used because a single margin that is too small makes a loop too close to instability.

    Args:
        target: least phase margin and gain margin, largest maximum sensitivity.
        loops: open loops of the same N plants, such as the rate loop and the attitude loop.

    Returns:
        Scores (N,), one for each plant. At 1 or more, every loop has every margin. The score is minus infinity if a
        loop is unstable, since margins mean nothing then.
    """
    least_ratios = []
    for loop in loops:
        ratios = list(margin_ratios(target, loop).values())
        least_ratio = np.min(ratios, axis=0)
        least_ratios.append(np.where(loop.stable, least_ratio, -np.inf))
    return np.min(least_ratios, axis=0)


def margin_ratios(target: MarginTarget, loop: OpenLoop) -> dict[str, Array]:
    """Returns each stability margin of an open loop relative to its target.

    The target is met if the ratio is 1 or more. As the target of the maximum sensitivity Ms is an upper limit, its
    ratio is inverted: the target over the value.

    Args:
        target: phase margin, gain margin and maximum sensitivity that the loop should have.
        loop: the open loop, of N plants.

    Returns:
        Ratios (N,) by the name of the margin: "phase_margin", "gain_margin" and "ms".
    """
    margins = loop.open_loop_characteristics
    return {
        "phase_margin": margins["phase_margin"] / target.phase_margin,
        "gain_margin": margins["gain_margin"] / target.gain_margin,
        "ms": target.ms / margins["ms"],
    }


def parameters_changed_in_flight(record: Record, controller: Controller) -> Parameters:
    """Returns the parameters of the axis' controller that changed during a flight, with their earlier values.

    A loop is computed with the last values. If values changed in flight, it was not this loop that flew all the time.
    Parameters of other axes do not affect it; parameters of all axes, such as the gyro's filters, do.

    Args:
        record: the flight, with the earlier value of each parameter that changed.
        controller: the controller of the axis.

    Returns:
        Earlier values by the autopilot's name.
    """
    # All parameters of the axis' rate controller begin like its P gain, such as "ATC_RAT_RLL_P", without the P.
    rate_prefix = controller.parameter_names["p"].removesuffix("P")
    earlier_values = {}
    for name, value in record.earlier.items():
        is_of_axis = name in controller.parameter_names.values() or name.startswith(rate_prefix)
        is_of_all_axes = not name.startswith(AXIS_PARAMETER_PREFIXES)
        if is_of_axis or is_of_all_axes:
            earlier_values[name] = value
    return earlier_values
