"""Tuning advice: PID gains of one axis with which wind moves the vehicle least, among those with given margins.

P, I and D of the rate controller and the gain of the attitude controller are each free, within a bounded step. The
margins hold in draws of the plant's posterior with more and less control effectiveness than in the flight, as by a
full and an empty battery, or load. Half of the draws choose the gains, the others judge them. Nothing is sent to a
vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import Gains, Loops
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import (
    MARGIN_TARGETS,
    Loop,
    MarginTarget,
    margin_rating,
    margin_scores,
    parameters_changed_in_flight,
)
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation
from mavdem.loops.margins import MAX_FREQUENCY_RATIO, FrequencyGrid, controller_response

ADVISED_GAINS = ("p", "i", "d", "angle_gain")
"""The gains of a controller that are free, by the names of its fields."""
MAX_GAIN_STEP = 3.0
"""Factor by which a gain grows or falls at most; with 2 instead, wind leans simulated vehicles a tenth more."""
EFFECTIVENESS_FACTORS = (1.0, 0.8, 1.2)
"""Factors on the flight's control effectiveness, with each of which gains must have their margins.

A full battery raises it by up to a fifth, an empty one or load lowers it.
"""
MAX_ANGLE_GAIN = {"roll": 12.0, "pitch": 12.0, "yaw": 5.0}
"""Largest gain of the attitude controller, 1/s, that PX4 takes; ArduPilot recommends at most 12 for all axes."""
MAX_NOISE_RATIO = 1.25
"""Largest noise in the demand, relative to that with the flight's gains: a choice."""
MIN_BANDWIDTH_RATIO = 0.9
"""Least bandwidth of either loop, relative to that with the flight's gains: a choice. Margins come first."""

SEARCH_DRAWS = 20
"""Number of draws of the plant that the gains are searched with: a choice, for speed."""
SEARCH_GRID = FrequencyGrid(0.05, 100.0, 60)
"""Frequencies that the gains are searched with: coarser than those of the result, for speed."""
SEARCH_MISS_SHARE = 0.035
"""Fraction of the search's draws that may lack the margins.

Gains fit the draws that chose them too well. With 0.035 of these, at most 0.05 of the other draws lack the margins.
"""
MARGIN_PENALTY = 30.0
"""Cost of margins that are too small, per relative shortfall, in units of the logarithm of the lean."""
NOISE_PENALTY = 30.0
"""Cost of noise that is too large, per relative excess."""
BANDWIDTH_PENALTY = 1.0
"""Cost of each bandwidth that is too small, per relative shortfall."""
START_STEPS = (-1.0, -0.4, 0.6)
"""Logarithms of the factors that each gain starts with: the search begins at the best of all combinations."""
MIN_SCORE = -1.0
"""Least score of margins that the search distinguishes: unstable loops have minus infinity."""
AIM_TOLERANCE = 0.99
"""Fraction of its aim from which on a pass of the search counts as having reached it."""
AIM_RESERVE = 1.005
"""Score of margins that the gains shall have in all draws that choose them: just above 1, the target itself."""


class SearchPass(NamedTuple):
    """One run of the simplex search."""

    first_step: float
    """Size of the simplex, as logarithm of the gains' factors."""
    evaluations: int
    """How many sets of gains it tries."""


SEARCH_PASSES = (
    SearchPass(0.4, 80),
    SearchPass(-0.4, 80),
    SearchPass(0.3, 80),
    SearchPass(-0.1, 60),
)
"""The runs of the search, each from where the last one ended."""

SURE_SHARE = INTERVAL_QUANTILES[1]
"""Fraction of the draws that must have the margins, 0.95, for gains to be set as the final ones."""

GAIN_REDUCTION = 2 / 3
"""Factor on the gains that make a vehicle oscillate: 3.5 dB less."""
MIN_NOISE_CROSSOVER_RATIO = 3.0
"""Lowest frequency at which the gyro shows noise and no motion, relative to the crossover."""
MIN_NOISE_FREQUENCY = 10.0
"""Lowest such frequency of slow loops, Hz."""
NOISE_WINDOW = 256
"""Largest number of samples in a window of the noise's spectrum."""


class Gain(NamedTuple):
    """A gain of the autopilot before and after the advice, in its unit."""

    now: float
    """The value in the log."""
    set: float
    """The value to set."""


class DemandNoise(NamedTuple):
    """Noise of the gyro in the demand, as standard deviations; a demand of 1 is all that the mixer takes."""

    lowest: float
    """Lowest frequency that counts as noise, Hz."""
    highest: float
    """Highest frequency that the log shows, Hz."""
    before: float
    """Noise with the gains of the log."""
    after: float
    """Noise with the gains to set."""
    by_d: float
    """Noise of the D term alone, with the gains of the log."""
    heat: float
    """Factor by which fast commands heat the motors more: it grows with the square of the noise."""


@dataclass(frozen=True, eq=False, repr=False)
class Advice(ImmutableResult):
    """Gains of one axis to set, and what to expect of them."""

    target: MarginTarget
    """The margins to have."""
    rating: Fact
    """Whether the loops of the flight have these margins."""
    refusals: Facts
    """Why no gains are advised; empty where they are."""
    before: Loop
    """The loops with the gains of the log."""
    after: Loop
    """The loops with the gains to set, for draws of the plant that did not choose them."""
    gains: dict[str, Gain]
    """Each gain by the autopilot's name, changed or not."""
    sure: float
    """Fraction of the draws and ``EFFECTIVENESS_FACTORS`` with which both loops have the margins, 0 to 1."""
    noise: DemandNoise | None
    """Noise of the gyro in the demand; ``None`` where the log is too slow to show it."""

    @property
    def parameters(self) -> Parameters:
        """The gains to set, by the autopilot's name, where they change."""
        return {name: gain.set for name, gain in self.gains.items() if gain.set != gain.now}

    @property
    def sentence(self) -> Fact:
        """The fact that states what to do with the gains: set them, keep them, or why there is no advice.

        New gains are to be set as the final ones only if both loops have the margins with them in ``SURE_SHARE`` of the
        draws from the plant's posterior. Else they are called a step towards the margins: set them, fly, and ask again.

        The figures of the fact are ``share``, the fraction of these draws with the margins; ``has_room``, whether the
        logged gains surely have the margins already; and the margins of the target, each under its own name.
        """
        if self.refusals:
            return Fact(Gains.NO_GAINS_ADVISED, reasons=self.refusals)
        code = Gains.STEP_TOWARDS_MARGINS
        if not self.parameters:
            code = Gains.KEEP_GAINS
        elif self.sure >= SURE_SHARE:
            code = Gains.SET_GAINS
        return Fact(
            code,
            share=self.sure,
            has_room=self.rating.is_good,
            **self.target._asdict(),
        )


AdviceByAxis = dict[str, Advice | Fact]
"""The advice by axis, or why there is none."""


def advise(
    loop: Loop, tune: str = "default", doubts: Sequence[Fact] = (), *, more: bool = False
) -> Advice:
    """Returns PID gains of one axis with which both loops have given margins and wind moves the vehicle least.

    A loop whose estimate has these margins keeps its gains unless ``more`` is true. So gains that were advised and then
    flown are not changed again.

    There is no advice where gains must not follow from this flight: because of ``doubts`` about it, gains that changed,
    motors at their limits, or a loop that is unstable or that the flight contradicts. Neither is there where wind makes
    the effectiveness seem low by more than ``EFFECTIVENESS_FACTORS`` allow, unless the loop surely lacks the least
    margins: such a vehicle must not fly the movements that would show more.

    Half of the draws from the plant's posterior choose the gains. The other half judges them, because gains fit the
    draws that chose them too well.

    Args:
        loop: rate and attitude loop of one axis, with N draws of the plant.
        tune: name of the margins to have, a key of ``MARGIN_TARGETS``.
        doubts: reasons not to trust the flight; with any of them no gains are advised.
        more: whether gains are changed even though the loop has its margins.

    Returns:
        The gains to set, or the reasons for none, with the loops before and after.
    """
    target = MARGIN_TARGETS[tune]
    rating = margin_rating(loop, target)
    may_change = more or rating.is_bad
    refusals = tuple(doubts) or _refusals(loop, may_change)
    new_gains: dict[str, float] = {}
    if not refusals:
        new_gains = _logged_gains(loop)
        if new_gains and may_change:
            new_gains |= _GainSearch(loop, target).best_gains()
    judging_draws = slice(len(loop.effectiveness) // 2, None)
    after = loop.with_draws(judging_draws).with_parameters(new_gains)
    # `with_draws` adds the estimated plant, row 0, by itself: so all rows but that are asked for.
    all_draws = slice(1, None)
    judging_loop = after.with_draws(all_draws, EFFECTIVENESS_FACTORS)
    return Advice(
        target=target,
        rating=rating,
        refusals=refusals,
        before=loop,
        after=after,
        gains={
            name: Gain(loop.controller.parameters[name], value) for name, value in new_gains.items()
        },
        sure=judging_loop.share_meeting(target),
        noise=_demand_noise(loop, after.controller),
    )


@dataclass(frozen=True)
class _GainSearch:
    """A search for the gains of least lean in wind that keep the margins or, if none do, come closest to them.

    A set of G gains is represented by the logarithms (G,) of its factors to the logged gains. Its cost is the logarithm
    of the lean plus an exact penalty for each limit that is exceeded: margins, noise in the demand, and two bandwidths.
    """

    loop: Loop
    """The loops with the logged gains."""
    target: MarginTarget
    """The margins to have."""

    @cached_property
    def logged_gains(self) -> dict[str, float]:
        """The G logged gains that may change, by the autopilot's name."""
        return _logged_gains(self.loop)

    @cached_property
    def upper_limits(self) -> list[float]:
        """Largest value that the search may give each of the G gains, in their units.

        Only the gain of the attitude controller is bounded (``MAX_ANGLE_GAIN``). A logged gain above its bound may
        stay, but not grow.
        """
        angle_gain_name = self.loop.controller.parameter_names["angle_gain"]
        limits = {angle_gain_name: MAX_ANGLE_GAIN[self.loop.axis]}
        return [max(value, limits.get(name, np.inf)) for name, value in self.logged_gains.items()]

    @cached_property
    def choosing_loop(self) -> Loop:
        """The loops of all draws of the plant that choose gains, on a coarse grid of frequencies.

        These are the first half of the posterior's draws; the second half judges the result. Each draw appears once
        for every factor of ``EFFECTIVENESS_FACTORS``.
        """
        # Row 0 is the estimated plant and no draw; `with_draws` adds it by itself.
        half = len(self.loop.effectiveness) // 2
        choosing_draws = slice(1, half)
        return self.loop.with_draws(choosing_draws, EFFECTIVENESS_FACTORS, SEARCH_GRID)

    @cached_property
    def search_loop(self) -> Loop:
        """The loops of at most ``SEARCH_DRAWS`` of the draws that choose gains, evenly spread.

        The cost is evaluated hundreds of times with these loops, and all draws would take too long.
        """
        half = len(self.loop.effectiveness) // 2
        stride = ceil(half / SEARCH_DRAWS)
        every_stride_th_draw = slice(1, half, stride)
        return self.loop.with_draws(every_stride_th_draw, EFFECTIVENESS_FACTORS, SEARCH_GRID)

    @cached_property
    def gyro_noise(self) -> _GyroNoise:
        """Spectral density of the gyro's noise in flight."""
        return _gyro_noise(self.loop)

    @cached_property
    def max_demand_noise(self) -> float:
        """Largest standard deviation that the gyro's noise may cause in the demand: a multiple of the present one."""
        return MAX_NOISE_RATIO * _demand_deviation(self.loop.controller, self.gyro_noise)

    @cached_property
    def min_bandwidths(self) -> list[float]:
        """Least bandwidths of the rate loop and of the attitude loop, Hz: a fraction of those with the logged gains."""
        loops = (self.search_loop.rate, self.search_loop.attitude)
        return [MIN_BANDWIDTH_RATIO * loop.bandwidth for loop in loops]

    def gains(self, log_factors: Array) -> dict[str, float]:
        """Returns the gains that a point of the search stands for, within their limits.

        Args:
            log_factors: (G,) logarithms of the factors to the logged gains. The simplex search knows no bounds, so
                factors beyond ``MAX_GAIN_STEP`` are clipped here.

        Returns:
            Gains by the autopilot's name, rounded to four digits, as somebody would type them.
        """
        factors = np.exp(log_factors).clip(1 / MAX_GAIN_STEP, MAX_GAIN_STEP)
        values = np.minimum(factors * list(self.logged_gains.values()), self.upper_limits)
        return {
            name: float(f"{value:.4g}")
            for name, value in zip(self.logged_gains, values, strict=True)
        }

    def margin_score(self, loop: Loop) -> float:
        """Returns the score of margins that all but ``SEARCH_MISS_SHARE`` of a loop's draws reach.

        The score of a draw is the least ratio of a margin to its target (:func:`margin_scores`): at 1 it just has all
        margins. Unstable loops, of score minus infinity, are set to ``MIN_SCORE``, so that the quantile stays finite.
        """
        scores = margin_scores(self.target, loop.rate, loop.attitude)
        return np.quantile(scores.clip(MIN_SCORE), SEARCH_MISS_SHARE)

    def cost(self, log_factors: Array, aim: float) -> float:
        """Returns the cost of a set of gains, which the search minimises.

        It is the logarithm of the lean in wind, plus a penalty for each limit that is exceeded, in proportion to the
        relative excess. The penalties are steep enough for the minimum to keep the limits (exact penalty method).

        Args:
            log_factors: (G,) logarithms of the factors to the logged gains.
            aim: the score of margins to reach, 1 for those of the target.
        """
        loop = self.search_loop.with_parameters(self.gains(log_factors))
        noise_ratio = _demand_deviation(loop.controller, self.gyro_noise) / self.max_demand_noise
        bandwidths = np.array([loop.rate.bandwidth, loop.attitude.bandwidth])
        # A bandwidth beyond all frequencies is NaN, and large enough.
        bandwidth_ratios = np.nan_to_num(bandwidths / self.min_bandwidths, nan=1.0)
        # By how much each limit is exceeded, as a fraction of it; negative within the limit.
        excesses = [
            1 - self.margin_score(loop) / aim,
            noise_ratio - 1,
            *(1 - bandwidth_ratios),
        ]
        penalties = np.array([MARGIN_PENALTY, NOISE_PENALTY, BANDWIDTH_PENALTY, BANDWIDTH_PENALTY])
        lean = loop.angle_deviation(self.search_loop.wind)
        return np.log(lean) + np.maximum(excesses, 0.0) @ penalties

    def best_gains(self) -> dict[str, float]:
        """Returns the gains of least cost by the autopilot's name, found by the simplex method of Nelder and Mead.

        The search begins at the best of a grid of starts, and runs once for each of ``SEARCH_PASSES``. Each pass starts
        anew from the last result with another simplex, since a simplex may collapse before the minimum.

        For speed, a pass evaluates only about ``SEARCH_DRAWS`` draws of the plant, which by chance may be easier to
        control than most. So each pass has an aim: the score of margins to reach with these few draws, 1 at first. If
        a pass reaches its aim, the score is computed with all draws that choose gains. If that score is below
        ``AIM_RESERVE``, the next aim is higher by the factor ``AIM_RESERVE`` over the score.
        """
        # Importing scipy.optimize takes half a second.
        from scipy.optimize import minimize

        # The cost has several minima, for example one with less I, and one with more I and less P. So the search starts
        # from the best of a grid.
        count = len(self.logged_gains)
        starts = [np.array(start) for start in product(START_STEPS, repeat=count)]
        log_factors = min(starts, key=lambda start: self.cost(start, 1.0))
        aim = 1.0
        for search_pass in SEARCH_PASSES:
            # G + 1 corners: the last result, and one step away from it along each gain.
            simplex = np.vstack([log_factors, log_factors + search_pass.first_step * np.eye(count)])
            log_factors = minimize(
                self.cost,
                log_factors,
                (aim,),
                "Nelder-Mead",
                options={"maxfev": search_pass.evaluations, "initial_simplex": simplex},
            ).x
            gains = self.gains(log_factors)
            # Where the few draws do not reach the aim, a higher aim would not help.
            if self.margin_score(self.search_loop.with_parameters(gains)) >= AIM_TOLERANCE * aim:
                score = self.margin_score(self.choosing_loop.with_parameters(gains))
                aim *= AIM_RESERVE / min(score, AIM_RESERVE)
        return gains


def _logged_gains(loop: Loop) -> dict[str, float]:
    """Returns the logged gains that advice may change, by the autopilot's name.

    These are ``ADVISED_GAINS`` as far as the log has them. A gain of 0 is left out: that term of the controller is
    switched off, and no factor changes 0.
    """
    parameters = loop.controller.parameters
    gains = {}
    for field in ADVISED_GAINS:
        name = loop.controller.parameter_names[field]
        if parameters.get(name):
            gains[name] = parameters[name]
    return gains


def _refusals(loop: Loop, may_change: bool) -> Facts:
    """Returns why no gains can be advised for a loop, by its flight; empty where they can.

    Only the first reason is given: changed gains, motors at their limits, an unstable loop, a loop that the measured
    response contradicts, or a control effectiveness that may be estimated too low, so that gains would be raised too
    far. A loop that surely lacks even the least margins gets advice in spite of the last reason: it must not fly the
    movements that would show the effectiveness.

    Args:
        loop: rate and attitude loop of one axis.
        may_change: whether gains are to be changed; gains that are kept need no trust in the effectiveness.
    """
    record = loop.record
    changed = parameters_changed_in_flight(record, loop.controller)
    if changed:
        return (Fact(Gains.GAINS_CHANGED, names=sorted(changed)),)
    limited_share = 0.0
    # Where the range of the inputs is known, they are scaled from 0 to 1.
    if len(record.input_range) == 2:
        low, high = record.input_range
        limited_share = loop.controller.outputs_at_limit(
            (record.inputs - low) / (high - low)
        ).mean()
    if limited_share > MIN_AT_LIMIT_SHARE:
        return (Fact(Gains.MOTOR_AT_LIMIT, share=limited_share),)
    # Row 0 is the estimated plant.
    if not (loop.rate.stable[0] and loop.attitude.stable[0]):
        return (Fact(Gains.LOOP_UNSTABLE),)
    if loop.disagreement:
        return (loop.disagreement,)
    is_effectiveness_low = loop.plant.bias < 0
    if not may_change or not is_effectiveness_low:
        return ()
    surely_lacks_margins = loop.share_meeting(MARGIN_TARGETS["sharp"]) <= 1 - CONFIDENCE_LEVEL
    if surely_lacks_margins:
        return ()
    return tuple(caution for caution in loop.cautions if caution.code is Loops.EFFECT_BIASED)


class _GyroNoise(NamedTuple):
    """Noise of the gyro in flight, at frequencies above the motion of the vehicle."""

    frequency: Array
    """Frequencies (F,), Hz."""
    density: Array
    """Spectral density (F,) of the rate behind the gyro's filters, (rad/s)²/Hz."""
    is_measured: bool
    """Whether the log shows the noise; where it is too slow for that, white noise is assumed."""


def _gyro_noise(loop: Loop) -> _GyroNoise:
    """Estimates the spectral density of the gyro's noise in a flight, by Welch's method.

    Below about the crossover the rate is motion of the vehicle. So noise counts from ``MIN_NOISE_CROSSOVER_RATIO``
    times the crossover on. Where the log does not reach an octave beyond that, white noise of density 1 is assumed, up
    to the highest frequency of the loop: with it, the noise of two controllers can still be compared.

    Args:
        loop: the loops with the logged gains; its record has the measured rate.
    """
    # Importing scipy.signal takes half a second.
    from scipy.signal import welch

    record = loop.record
    highest = MAX_FREQUENCY_RATIO / record.dt
    lowest = max(MIN_NOISE_CROSSOVER_RATIO * loop.rate.crossover, MIN_NOISE_FREQUENCY)
    reaches_an_octave = 2 * lowest < highest
    if not reaches_an_octave:
        loop_highest = MAX_FREQUENCY_RATIO / loop.controller.loop_period
        assumed_frequency = np.linspace(lowest, loop_highest)
        return _GyroNoise(assumed_frequency, np.ones(len(assumed_frequency)), is_measured=False)
    # The last output of an axis is its body rate, rad/s.
    rate = record.outputs[:, -1]
    window = min(NOISE_WINDOW, len(record))
    frequency, density = welch(rate, 1 / record.dt, nperseg=window)
    is_noise = (frequency >= lowest) & (frequency <= highest)
    return _GyroNoise(frequency[is_noise], density[is_noise], is_measured=True)


def _demand_noise(loop: Loop, new_controller: Controller) -> DemandNoise | None:
    """Returns how much noise of the gyro reaches the demand, with the logged gains and with new ones.

    Args:
        loop: the loops with the logged gains, and the flight that shows the noise.
        new_controller: the controller with the gains to set.

    Returns:
        The noise in the demand; ``None`` where the log is too slow to show that of the gyro.
    """
    noise = _gyro_noise(loop)
    if not noise.is_measured:
        return None
    controller = loop.controller
    # The noise is behind the gyro's filters, so only the controller is between it and the demand.
    before = _demand_deviation(controller, noise)
    after = _demand_deviation(new_controller, noise)
    # The response of the D term is that of the controller less that of one without D.
    by_d = _demand_deviation(controller, noise, subtracted=replace(controller, d=0.0))
    return DemandNoise(
        lowest=noise.frequency[0],
        highest=noise.frequency[-1],
        before=before,
        after=after,
        by_d=by_d,
        heat=(after / before) ** 2,
    )


def _demand_deviation(
    controller: Controller, noise: _GyroNoise, subtracted: Controller | None = None
) -> float:
    """Returns the standard deviation σ that the gyro's noise causes in the demand: σ² = ∫ |C(jω)|² S df.

    C is the controller's response from the rate to the demand, and S the density of the noise. The integral is computed
    by the trapezoidal rule.

    Args:
        controller: the controller, with the response C.
        noise: the noise of the rate, with its density S in (rad/s)²/Hz.
        subtracted: a controller whose response is subtracted from C, so that σ is that of one term of the controller.

    Returns:
        σ, as a fraction of the largest demand that the mixer takes.
    """
    response = controller_response(controller, noise.frequency).from_rate
    if subtracted is not None:
        response = response - controller_response(subtracted, noise.frequency).from_rate
    power = np.abs(response) ** 2 * noise.density
    return float(np.sqrt(np.trapezoid(power, noise.frequency)))


def gain_reduction_advice(oscillation: Oscillation, parameters: Parameters) -> Fact:
    """Returns which gains to lower by a third where a vehicle oscillates in a limit cycle.

    In a limit cycle, a loop oscillates with an amplitude that the motors' limits bound. A fast one comes from the rate
    controller's P and D. A slow one comes from what adds phase lag at low frequencies: the attitude controller's gain
    or the integral gain I. Each adds much lag only up to its corner frequency, rad/s, which is the attitude gain
    itself, and I / P. So of these two, those with a corner above half of the oscillation's frequency are lowered; if
    there are none, P and D are.

    Args:
        oscillation: the oscillation of the axis that turns fastest, which also has those of all other axes.
        parameters: parameters of the autopilot, by name; where they have no known controller, no values are advised.

    Returns:
        A fact with ``changes``: name, value and new value of each gain to lower.
    """
    changes = []
    for cycle in (oscillation, *oscillation.other_axes):
        # An axis without a known controller has no gains to lower.
        with suppress(NotLearnable):
            # Only gains are of interest, so the mixer of one motor stands for any.
            controller = controller_from_parameters(parameters, cycle.axis, (1.0,))
            # A frequency that is not known is taken for a high one.
            angular_frequency = 2 * np.pi * (cycle.frequency or np.inf)
            corner_frequencies = {
                "angle_gain": controller.angle_gain,
                "i": controller.i / controller.p,
            }
            lagging_gains = [
                gain
                for gain, corner in corner_frequencies.items()
                if corner > angular_frequency / 2
            ]
            for gain in lagging_gains or ("p", "d"):
                name = controller.parameter_names[gain]
                value = parameters[name]
                if value:
                    changes.append((name, value, GAIN_REDUCTION * value))
    return Fact(Gains.LOWER_GAINS, changes=changes, **oscillation.figures)


def reasons_for_no_gains(loop: Loop, tune: str = "default", *, more: bool = False) -> Facts:
    """Returns why :func:`advise` gives no gains for a loop, without the search for gains; empty where it gives some.

    Args:
        loop: rate and attitude loop of one axis.
        tune: name of the margins to have, a key of ``MARGIN_TARGETS``.
        more: whether gains are changed even though the loop has its margins.
    """
    may_change = more or margin_rating(loop, MARGIN_TARGETS[tune]).is_bad
    return _refusals(loop, may_change)
