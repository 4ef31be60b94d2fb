"""Choice of new gains, in the order of manual tuning: first P and D of the rate, then the angle's gain, in small steps.

Stage 1 chooses P and D of the rate controller; I follows P in a fixed ratio. For each ratio of D to P that is near the
autopilot's own, the largest P is chosen with which the rate loop keeps its margins. Of the designs whose bandwidth is
nearly the highest, the one whose angle deviates least in wind is chosen. Stage 2 chooses the largest gain of the
attitude controller with which the attitude loop keeps its margins. The change from flight to flight is bounded.

ArduPilot's manual tuning, QuickTune and AutoTune (https://ardupilot.org/copter/docs/tuning.html) and PX4's guide
(https://docs.px4.io/main/en/config_mc/pid_tuning_guide_multicopter.html) proceed in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from math import ceil, inf, isnan, log
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import GainBound, GainFact
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import Loop, MarginTarget, margin_scores
from mavdem.loops.controllers import Controller
from mavdem.loops.demand_noise import GyroNoise, demand_deviation, gyro_noise
from mavdem.loops.margins import FrequencyGrid, OpenLoop


class Stage(IntEnum):
    """Which gains of an axis are tuned; the rate loop comes first, since the attitude loop is built around it."""

    RATE = 1
    """P and D of the rate controller, with I in a fixed ratio to P."""
    ANGLE = 2
    """The gain of the attitude controller."""


class GainRatios(NamedTuple):
    """Gains of a rate controller relative to its P."""

    integral: float
    """I over P, 1/s."""
    derivative: float
    """D divided by P, s; 0 if the autopilot's default has no D."""


class AxisDefaults(NamedTuple):
    """Default gains of an autopilot's axis, as far as advice keeps to them."""

    ratios: GainRatios
    """Ratios of the rate controller's gains."""
    angle_gain: float
    """Gain of the attitude controller, 1/s."""


_ARDUPILOT_TILT = AxisDefaults(GainRatios(1.0, 0.0036 / 0.135), 4.5)
_PX4_TILT = AxisDefaults(GainRatios(0.2 / 0.15, 0.003 / 0.15), 6.5)
ARDUPILOT_DEFAULTS = {
    "roll": _ARDUPILOT_TILT,
    "pitch": _ARDUPILOT_TILT,
    "yaw": AxisDefaults(GainRatios(0.018 / 0.18, 0.0), 4.5),
}
"""ArduCopter's defaults by axis: I equals P for roll and pitch, and is a tenth of it for yaw (``ATC_RAT_*``).

Its AutoTune and QuickTune keep these ratios too.
"""
PX4_DEFAULTS = {
    "roll": _PX4_TILT,
    "pitch": _PX4_TILT,
    "yaw": AxisDefaults(GainRatios(0.1 / 0.2, 0.0), 2.8),
}
"""PX4's defaults by axis (``MC_ROLLRATE_*``, ``MC_ROLL_P`` and the same of pitch and yaw)."""
MAX_RATIO_CHANGE = 2.0
"""Factor by which the ratio of D to P may differ from the autopilot's default, and the angle's gain exceed it.

A choice: ArduPilot's and PX4's own tuners stay within it on common vehicles. Logged gains outside keep their ratio.
"""
RATIO_TOLERANCE = 1.02
"""Factor by which gains that are rounded to three digits may exceed ``MAX_RATIO_CHANGE``."""
MAX_ANGLE_GAIN = {"roll": 12.0, "pitch": 12.0, "yaw": 5.0}
"""Largest gain of the attitude controller, 1/s, that PX4 takes; ArduPilot recommends at most 12 for all axes."""

MAX_GAIN_STEP = 1.5
"""Factor by which a gain grows or falls at most between two flights: tuners change a gain by a quarter to a half."""
STEP_EXPONENTS = (1.0, 0.75, 0.5, 0.25)
"""Exponents of the factors on the gains, tried one after another until a step costs no margin: a choice.

They are the parts of the largest step that are taken, by logarithms.
"""
MAX_DESIGN_FACTOR = 4.0
"""Factor by which P of the design may differ from the logged one, over several flights: a choice."""
GAIN_ROUNDING = 0.005
"""Largest relative error of a gain of three digits."""
STEP_COUNT_TOLERANCE = 0.02
"""Part of a step that does not count as another step. Rounding a gain to three digits adds up to 0.012 of a step."""
MIN_GAIN_CHANGE = 1.05
"""Factor from which on a gain is worth a change: less is within what batteries and weather do to the loop."""
EFFECTIVENESS_FACTORS = (1.0, 0.8, 1.2)
"""Factors on the flight's control effectiveness, with each of which gains must have their margins.

A full battery raises it by up to a fifth, an empty one or load lowers it.
"""
MAX_NOISE_RATIO = 1.25
"""Largest noise in the demand, relative to that with the flight's gains: a choice."""
NEARLY_AS_FAST = 0.9
"""Fraction of the highest bandwidth from which on wind decides between designs."""
MIN_BANDWIDTH_RATIO = 0.8
"""Least bandwidth of a design relative to the logged gains' bandwidth, if the logged gains already have the margins."""
MIN_BANDWIDTH_GAIN = 1.1
"""Factor by which a design must raise the rate bandwidth for a loop with enough margin to leave stage 2 for stage 1."""

SURE_SHARE = 0.9
"""Fraction of the models that must have the margins, for gains to be set as the final ones."""
SEARCH_MISS_SHARE = 0.05
"""Fraction of the search's models that may lack the margins.

Gains fit the models that chose them too well. With 0.05 of these, at most 0.1 of the other models lack the margins.
"""
SEARCH_DRAWS = 40
"""Number of draws of the plant that the gains are searched with: a choice, for speed."""
SEARCH_GRID = FrequencyGrid(0.05, 100.0, 60)
"""Frequencies that the gains are searched with: coarser than the result's, for speed."""
RATIO_COUNT = 7
"""Number of ratios of D to P that are tried."""
FACTORS = tuple(np.geomspace(MAX_DESIGN_FACTOR, 1 / MAX_DESIGN_FACTOR, 49).tolist())
"""Factors on the logged P, or the logged gain of the angle, that are tried, from the largest on: 6 % apart."""
MIN_SCORE = -1.0
"""Least score of margins that the search distinguishes: unstable loops have minus infinity."""


class GainStep(NamedTuple):
    """Gains of one stage for the next flight, and the design that they approach."""

    stage: Stage
    gains: Parameters
    """Gains to set for the next flight, by the autopilot's name."""
    design: Parameters
    """Gains at the end of the stage, as this flight shows them."""
    flights: int
    """Number of steps, with a flight after each, until the design is set; 0 if no gain changes."""
    notes: Facts
    """What is unusual about the gains, and why."""


NO_STEP = GainStep(Stage.RATE, {}, {}, 0, ())
"""The step of an axis that keeps its gains."""


class _RateDesign(NamedTuple):
    """Gains of the rate controller, with bandwidth and angle error, by which designs are compared."""

    derivative_ratio: float
    """D over P, s."""
    factors: tuple[float, ...]
    """Factors on the logged P: the largest with which the models of the search have the margins, then smaller ones."""
    bandwidth: float
    """Bandwidth of the rate loop by the estimated plant, Hz."""
    angle_deviation: float
    """Standard deviation of the angle in the flight's wind with the logged attitude gain, degrees; inf if unstable."""


@dataclass(frozen=True)
class GainSearch:
    """A grid search for new gains of one axis with which its loops have stability margins for many plant models.

    Designs are gains at the end of tuning. A plant model is one sample of the posterior of the identified plant.
    """

    loop: Loop
    """The loops with the logged gains."""
    target: MarginTarget
    """The margins to have."""

    @cached_property
    def defaults(self) -> AxisDefaults:
        """The autopilot's default gains of the axis."""
        is_ardupilot = self.loop.controller.is_ardupilot
        return (ARDUPILOT_DEFAULTS if is_ardupilot else PX4_DEFAULTS)[self.loop.axis]

    @cached_property
    def logged_gains(self) -> dict[str, float]:
        """The logged gains that may change, by the field of the controller: "p", "i", "d" and "angle_gain"."""
        names = self.loop.controller.parameter_names
        values = logged_gains(self.loop.controller)
        fields = ("p", "i", "d", "angle_gain")
        return {field: values[names[field]] for field in fields if names[field] in values}

    @cached_property
    def all_models(self) -> Loop:
        """The loops with all plant models by which gains are chosen, on a coarse grid of frequencies.

        The models are the first half of the draws from the plant's posterior, each with several control effectivenesses
        (``EFFECTIVENESS_FACTORS``). The second half of the draws judges the gains afterwards: with the models that they
        were chosen for, gains look better than they are.
        """
        # Row 0 of a loop is the estimated plant, and not a draw: ``with_draws`` adds it always.
        first_half_of_draws = slice(1, len(self.loop.effectiveness) // 2)
        return self.loop.with_draws(first_half_of_draws, EFFECTIVENESS_FACTORS, SEARCH_GRID)

    @cached_property
    def models(self) -> Loop:
        """The loops of at most ``SEARCH_DRAWS`` of the plants that choose gains, evenly spread: all would take long."""
        half = len(self.loop.effectiveness) // 2
        stride = ceil(half / SEARCH_DRAWS)
        evenly_spread_draws = slice(1, half, stride)
        return self.loop.with_draws(evenly_spread_draws, EFFECTIVENESS_FACTORS, SEARCH_GRID)

    @cached_property
    def gyro_noise(self) -> GyroNoise:
        """Spectral density of the gyro's noise in flight."""
        return gyro_noise(self.loop)

    @cached_property
    def max_demand_noise(self) -> float:
        """Largest standard deviation that the gyro's noise may cause in the demand."""
        return MAX_NOISE_RATIO * demand_deviation(self.loop.controller, self.gyro_noise)

    @property
    def highest_angle_gain(self) -> float:
        """Highest gain of the attitude controller that is tried, 1/s: the logged one where that is beyond the usual."""
        usual_limit = min(
            MAX_ANGLE_GAIN[self.loop.axis], MAX_RATIO_CHANGE * self.defaults.angle_gain
        )
        return max(self.logged_gains["angle_gain"], usual_limit)

    def step(self, stage: Stage, *, may_lower_bandwidth: bool = True) -> GainStep:
        """Returns the gains to set for the next flight in one stage of tuning, and the design that they lead to.

        The first stage tunes the rate controller (P, I and D), the second the gain of the attitude controller. The
        gains far from those of the logged flight are less certain. They are therefore reached in several flights, each
        of which changes a gain by a limited factor only.

        Args:
            stage: stage of tuning.
            may_lower_bandwidth: whether the rate loop may become much slower, because the logged gains lack margin.
                Where they have it, a design that is much slower than they are is not followed.

        Returns:
            The step; it has no gains if the logged ones should be kept.
        """
        if stage is Stage.RATE:
            design = self.rate_design()
            if self._is_much_slower(design) and not may_lower_bandwidth:
                return NO_STEP
        else:
            design = self.attitude_design()
        return self._step_towards(self._without_small_changes(design), stage)

    def _is_much_slower(self, design: Parameters) -> bool:
        """Returns whether the rate loop has less than ``MIN_BANDWIDTH_RATIO`` of its bandwidth with other gains.

        Args:
            design: the other gains of the rate controller, by the autopilot's name.
        """
        bandwidth = bandwidth_of_estimate(self.models.with_parameters(design).rate)
        logged_bandwidth = bandwidth_of_estimate(self.models.rate)
        return bandwidth < MIN_BANDWIDTH_RATIO * logged_bandwidth

    def _step_towards(self, design: Parameters, stage: Stage) -> GainStep:
        """Returns the step from the logged gains towards a design, with notes on what is unusual about it.

        Args:
            design: gains at the end of the stage, by the autopilot's name; empty to keep the logged ones.
            stage: stage of tuning.
        """
        gains = self._gains_for_next_flight(stage, design)
        bounds = self._bound_on_higher_gains(stage, design)
        notes = (*bounds, *self._notes_on_gains(stage, gains))
        return GainStep(stage, gains, design, self._flights_to(design), notes)

    def rate_design(self) -> Parameters:
        """Finds the P, I and D of the rate controller with a high bandwidth and enough stability margin.

        1. A grid is searched: ratios of D to P, and factors on the logged P. Gains that pass too much of the gyro's
           noise to the motors are skipped.
        2. For each ratio the largest P with which the rate loop has its margins is a design.
        3. Of the designs with at least ``NEARLY_AS_FAST`` times the highest bandwidth, the one whose angle deviates
           least in wind is chosen.

        Returns:
            The gains by the autopilot's name. If none have the margins, they are those that come closest; empty if all
            pass too much noise.
        """
        designs = []
        gains_without_margins = []
        for ratio in self._derivative_ratios():
            # The factors are descending: once the margins are kept, a smaller P would only be slower.
            for number, factor in enumerate(FACTORS):
                gains = self._rate_gains(factor, ratio)
                controller = self.models.controller.with_parameters(gains)
                if demand_deviation(controller, self.gyro_noise) > self.max_demand_noise:
                    continue
                loop = self.models.with_controller(controller)
                if self.has_margins(loop.rate):
                    designs.append(self._rate_design_of(loop, ratio, FACTORS[number:]))
                    break
                gains_without_margins.append(gains)
        if not designs:
            return self._closest_rate_gains(self.models, gains_without_margins)
        least_bandwidth = NEARLY_AS_FAST * max(design.bandwidth for design in designs)
        fast_designs = [design for design in designs if design.bandwidth >= least_bandwidth]
        steadiest_design = min(fast_designs, key=lambda design: design.angle_deviation)
        return self._gains_for_all_models(steadiest_design)

    def _rate_design_of(
        self, loop: Loop, derivative_ratio: float, factors: tuple[float, ...]
    ) -> _RateDesign:
        """Computes bandwidth and angle deviation in wind, by which designs of the rate controller are compared.

        Args:
            loop: loops with the gains of the design, for the plant models of the search.
            derivative_ratio: ratio of D to P of the design, s.
            factors: factor by which P of the design exceeds the logged P. The smaller factors of the search follow:
                they are tried if the loop lacks margin with this one, once it is checked with all plant models.

        Returns:
            The design with the bandwidth of its rate loop, Hz, and the standard deviation of the angle in wind,
            degrees, which is infinite if the attitude loop is unstable.
        """
        angle_deviation = inf
        if loop.attitude.is_stable:
            angle_deviation = loop.angle_deviation(self.models.wind)
        bandwidth = bandwidth_of_estimate(loop.rate)
        return _RateDesign(derivative_ratio, factors, bandwidth, angle_deviation)

    def _gains_for_all_models(self, design: _RateDesign) -> Parameters:
        """Lowers P, I and D of a design until the rate loop has its margins with all plant models of the choice.

        The search before it uses only some of these models, since it would take too long with all.

        Args:
            design: the design. Its factors on the logged P are tried in their order, from the largest on.

        Returns:
            The gains with the first factor that has the margins, by the autopilot's name. If none has them, those that
            come closest.
        """
        gains_without_margins = []
        for factor in design.factors:
            gains = self._rate_gains(factor, design.derivative_ratio)
            if self.has_margins(self.all_models.with_parameters(gains).rate):
                return gains
            gains_without_margins.append(gains)
        return self._closest_rate_gains(self.all_models, gains_without_margins)

    def _closest_rate_gains(self, models: Loop, candidates: Sequence[Parameters]) -> Parameters:
        """Returns the gains of the rate controller whose margins come closest to the target.

        Args:
            models: the loops with the plant models that judge the gains.
            candidates: gains by the autopilot's name.

        Returns:
            The first candidate with the highest :meth:`margin_score`; empty without candidates.
        """
        return max(
            candidates,
            key=lambda gains: self.margin_score(models.with_parameters(gains).rate),
            default={},
        )

    def attitude_design(
        self, rate_gains: Parameters | None = None, max_gain: float = inf
    ) -> Parameters:
        """Finds the largest gain of the attitude controller with which the attitude loop has its stability margins.

        The attitude controller makes the setpoint of the body rate from the error of the angle, by this gain. The
        logged gain times each of ``FACTORS`` is tried, from the largest on, and limited to the highest gain that is
        allowed.

        Args:
            rate_gains: gains of the rate controller, by the autopilot's name, where they differ from the logged ones;
                None if none does.
            max_gain: largest gain to return, 1/s, besides the limit of the vehicle.

        Returns:
            The gain, 1/s, by the autopilot's name. If none has the margins, it is the one that comes closest.
        """
        gain_name = self.loop.controller.parameter_names["angle_gain"]
        logged_gain = self.logged_gains["angle_gain"]
        highest_gain = min(self.highest_angle_gain, max_gain)
        loops = self.models.with_parameters(rate_gains or {})
        gains_without_margins: list[float] = []
        for factor in FACTORS:
            gain = round_gain(min(factor * logged_gain, highest_gain))
            if gain in gains_without_margins:
                # Several factors give the highest gain, and rounding may make others equal.
                continue
            attitude_loops = _attitude_loops_alone(loops.with_parameters({gain_name: gain}))
            if self.has_margins(attitude_loops):
                return {gain_name: gain}
            gains_without_margins.append(gain)
        closest_gain = max(
            gains_without_margins,
            key=lambda gain: self._attitude_score(loops.with_parameters({gain_name: gain})),
        )
        return {gain_name: closest_gain}

    def has_margins(self, open_loop: OpenLoop) -> bool:
        """Returns whether the loop has all its stability margins with nearly all plant models.

        All but the fraction ``SEARCH_MISS_SHARE`` of the models must reach a :meth:`margin_score` of 1. The maximum
        sensitivity Ms is checked first: it takes a tenth of the time of all margins, and most gains of a search fail by
        it.

        Args:
            open_loop: rate or attitude loop of all models, at each control effectiveness.
        """
        sensitivity_scores = scores_of_models(self.target.ms / open_loop.max_sensitivity)
        if np.quantile(sensitivity_scores, SEARCH_MISS_SHARE) < 1:
            return False
        return self.margin_score(open_loop) >= 1

    def margin_score(self, open_loop: OpenLoop) -> float:
        """Scores the margins of many plant models by a low quantile, so that a few bad models do not decide.

        The score of a plant is the least ratio of a margin to its target (:func:`margin_scores`): at 1 it just has all
        margins. Unstable loops, of score minus infinity, are set to ``MIN_SCORE``, so that the quantile stays finite.

        Args:
            open_loop: rate or attitude loop of all models, at each effectiveness.

        Returns:
            The score, without a unit, that all but ``SEARCH_MISS_SHARE`` of the models reach.
        """
        scores = scores_of_models(margin_scores(self.target, open_loop))
        return float(np.quantile(scores.clip(MIN_SCORE), SEARCH_MISS_SHARE))

    def _attitude_score(self, models: Loop) -> float:
        """Scores the attitude loops of all models, at each effectiveness, as :meth:`margin_score` does."""
        return self.margin_score(_attitude_loops_alone(models))

    def _derivative_ratios(self) -> list[float]:
        """Returns the ratios of D to P to try, s.

        They are spread around the autopilot's default, and extended to the logged ratio if that is outside. If the log
        or the default has no D, the only ratio is the logged one.

        Returns:
            Ratios, in ascending order and evenly spaced by their logarithms.
        """
        default_ratio = self.defaults.ratios.derivative
        logged_ratio = self.logged_gains.get("d", 0.0) / self.logged_gains["p"]
        if not (default_ratio and logged_ratio):
            return [logged_ratio]
        lowest_ratio = min(default_ratio / MAX_RATIO_CHANGE, logged_ratio)
        highest_ratio = max(default_ratio * MAX_RATIO_CHANGE, logged_ratio)
        ratios: list[float] = np.geomspace(lowest_ratio, highest_ratio, RATIO_COUNT).tolist()
        return ratios

    def _rate_gains(self, factor: float, derivative_ratio: float) -> Parameters:
        """Computes P, I and D of the rate controller from a factor on the logged P and the ratio of D to P.

        I is P times the autopilot's default ratio. Gains that the log does not have, or that are 0, are left out.

        Args:
            factor: factor on the logged P.
            derivative_ratio: ratio of D to P, s.

        Returns:
            The rounded gains by the autopilot's names.
        """
        names = self.loop.controller.parameter_names
        p = factor * self.logged_gains["p"]
        values = {"p": p, "i": self.defaults.ratios.integral * p, "d": derivative_ratio * p}
        gains = {}
        for field, value in values.items():
            if field in self.logged_gains:
                gains[names[field]] = round_gain(value)
        return gains

    def _without_small_changes(self, design: Parameters) -> Parameters:
        """Discards a design if none of its gains differs from the logged one by the factor ``MIN_GAIN_CHANGE`` or more.

        The integral gain is not counted, since it always follows P.

        Args:
            design: gains by the autopilot's name.

        Returns:
            The unchanged design; empty if it was discarded.
        """
        logged = self.loop.controller.parameters
        integral_name = self.loop.controller.parameter_names["i"]
        for name, value in design.items():
            is_large = _log_change(value, logged[name]) >= log(MIN_GAIN_CHANGE)
            if is_large and name != integral_name:
                return design
        return {}

    def _gains_for_next_flight(self, stage: Stage, design: Parameters) -> Parameters:
        """Returns the gains for the next flight: at most one step from the logged gains towards a design.

        In one step each gain is multiplied or divided by at most ``MAX_GAIN_STEP``. If gains of the rate controller
        change, neither the rate loop nor the attitude loop around it may lose margin that it needs: the step is made
        shorter, or the attitude gain lower, until that holds. A step of the attitude gain alone is taken as it is.

        Args:
            stage: stage of tuning, which decides whether the gains of the rate controller or the angle gain change.
            design: gains at the end of the stage, by the autopilot's name; empty to change none.

        Returns:
            Gains by the autopilot's name, rounded; empty if none change.
        """
        logged_gains = self.loop.controller.parameters
        step_factors = {}
        for name, designed_gain in design.items():
            factor_to_design = designed_gain / logged_gains[name]
            step_factors[name] = min(max(factor_to_design, 1 / MAX_GAIN_STEP), MAX_GAIN_STEP)
        changes_rate_gains = bool(design) and stage is not Stage.ANGLE
        if not changes_rate_gains:
            # With the exponent 1 the step is not made shorter.
            return self._multiplied_gains(step_factors, exponent=1.0)
        rate_gains = self._largest_step_with_rate_margins(step_factors)
        return self._with_attitude_margins(rate_gains)

    def _largest_step_with_rate_margins(self, factors: Parameters) -> Parameters:
        """Returns the gains after the largest step with which the rate loop loses no margin that it needs.

        Factors are limited one by one, so that some gains reach the design while others do not. Such gains do not match
        each other, and the rate loop may lose margin. All factors are then raised to a power below 1, which makes the
        step shorter.

        Args:
            factors: limited factor of each gain, by the autopilot's name.

        Returns:
            Gains by the autopilot's name, rounded; those of the shortest step if each step costs margin.
        """
        # A score of 1 means that the loop just has its margins. If it lacks margin already, the step need not improve
        # it, but must not make it worse.
        needed_score = min(1.0, self.margin_score(self.models.rate))
        gains: Parameters = {}
        for exponent in STEP_EXPONENTS:
            gains = self._multiplied_gains(factors, exponent)
            rate_loops = self.models.with_parameters(gains).rate
            if self.margin_score(rate_loops) >= needed_score:
                break
        return gains

    def _with_attitude_margins(self, rate_gains: Parameters) -> Parameters:
        """Adds a lower attitude gain to new gains of the rate controller, if the attitude loop needs it.

        It needs it if the new gains would give it less margin than its target and less than it has now. The gain then
        falls by at most one step, the factor ``MAX_GAIN_STEP``.

        Args:
            rate_gains: new gains of the rate controller, by the autopilot's name.

        Returns:
            The gains, with that of the attitude controller if it is lowered.
        """
        # A score of 1 means that the loop just has its margins.
        needed_score = min(1.0, self._attitude_score(self.models))
        new_score = self._attitude_score(self.models.with_parameters(rate_gains))
        if new_score >= needed_score:
            return rate_gains
        logged_gain = self.logged_gains["angle_gain"]
        lowest_gain = logged_gain / MAX_GAIN_STEP
        gains = dict(rate_gains)
        for name, gain in self.attitude_design(rate_gains, max_gain=logged_gain).items():
            gains[name] = round_gain(max(gain, lowest_gain))
        return gains

    def _multiplied_gains(self, factors: Parameters, exponent: float) -> Parameters:
        """Returns the logged gains, each multiplied by a power of its factor.

        Args:
            factors: factor of each gain, by the autopilot's name.
            exponent: exponent of the factors, 0 to 1. Below 1 it makes the step shorter.

        Returns:
            The rounded gains by the autopilot's name.
        """
        logged = self.loop.controller.parameters
        gains = {}
        for name, factor in factors.items():
            gains[name] = round_gain(logged[name] * factor**exponent)
        return gains

    def _flights_to(self, design: Parameters) -> int:
        """Returns how many steps of at most ``MAX_GAIN_STEP`` lead from the logged gains to a design."""
        logged = self.loop.controller.parameters
        log_changes = [_log_change(value, logged[name]) for name, value in design.items()]
        steps = max(log_changes, default=0.0) / log(MAX_GAIN_STEP)
        # Rounding of gains to three digits may make a change a little larger than a whole number of steps.
        return ceil(steps - STEP_COUNT_TOLERANCE)

    def _bound_on_higher_gains(self, stage: Stage, design: Parameters) -> Facts:
        """Determines what kept the search from higher gains: their range, the gyro's noise, or the stability margins.

        The gains are raised by one step of the search's factors, and compared with each bound of the search in turn.

        Args:
            stage: stage of tuning. Its main gain is P of the rate controller, or the gain of the attitude controller.
            design: gains that the search chose for the end of the stage, by the autopilot's name.

        Returns:
            A fact that names the first bound that the raised gains exceed. Empty if the design does not raise the main
            gain, so that the search stopped at no bound, or if the raised gains exceed none of them: they lie between
            two factors that the search tried.
        """
        main_gain = "p" if stage is Stage.RATE else "angle_gain"
        name = self.loop.controller.parameter_names[main_gain]
        logged = self.loop.controller.parameters
        raises_main_gain = design.get(name, 0.0) > logged.get(name, 0.0)
        if not raises_main_gain:
            return ()
        # Ratio of neighbouring factors of the search.
        factor = FACTORS[0] / FACTORS[1]
        higher_gains = {gain_name: factor * value for gain_name, value in design.items()}
        scores = []
        # The search rejects gains that lack margin with some of the models, or with all of them.
        for models in (self.models, self.all_models):
            loop = models.with_parameters(higher_gains)
            open_loop = loop.rate if stage is Stage.RATE else loop.attitude
            scores.append(self.margin_score(open_loop))
        noise = demand_deviation(
            self.models.controller.with_parameters(higher_gains), self.gyro_noise
        )
        if stage is Stage.RATE:
            highest = MAX_DESIGN_FACTOR * logged[name]
        else:
            highest = self.highest_angle_gain
        # The design is at the end of the range if it is its highest gain, up to the rounding of gains to three digits.
        is_at_end_of_range = higher_gains[name] > factor * round_gain(highest) * (1 - GAIN_ROUNDING)
        if is_at_end_of_range:
            bound = GainBound.RANGE
        elif stage is Stage.RATE and noise > self.max_demand_noise:
            bound = GainBound.NOISE
        elif min(scores) < 1:
            bound = GainBound.MARGINS
        else:
            return ()
        fact = Fact(
            GainFact.STEP_BOUND,
            bound=bound,
            stage=int(stage),
            flights=self._flights_to(design),
            largest_step=MAX_GAIN_STEP,
            largest_noise=MAX_NOISE_RATIO,
        )
        return (fact,)

    def _notes_on_gains(self, stage: Stage, gains: Parameters) -> Facts:
        """Lists what is unusual in new gains of the rate controller, for the user to check.

        Three things are unusual: the attitude gain must be lowered with them; the integral gain falls although P rises;
        or a ratio of I or D to P is far from the autopilot's default (:meth:`_notes_on_ratios`).

        Args:
            stage: stage of tuning, which decides the gains that change.
            gains: gains to set, by the autopilot's name.

        Returns:
            The notes as facts (coded findings of which reports make sentences); empty for the stage of the attitude
            controller.
        """
        if stage is not Stage.RATE or not gains:
            return ()
        parameter_names = self.loop.controller.parameter_names
        logged_gains = self.loop.controller.parameters
        p_name, i_name = parameter_names["p"], parameter_names["i"]
        notes = []
        if parameter_names["angle_gain"] in gains:
            notes.append(Fact(GainFact.ANGLE_FOLLOWS, name=parameter_names["angle_gain"]))
        integral_falls = i_name in gains and gains[i_name] < logged_gains[i_name]
        if integral_falls and gains[p_name] > logged_gains[p_name]:
            notes.append(Fact(GainFact.INTEGRAL_FALLS, name=i_name))
        return (*notes, *self._notes_on_ratios(gains))

    def _notes_on_ratios(self, gains: Parameters) -> Iterator[Fact]:
        """Yields a note for the user on each ratio of I or D to P that is far from the default of the autopilot.

        Far means a factor of more than ``MAX_RATIO_CHANGE`` above or below the default.

        Args:
            gains: gains of the rate controller to set, P among them, by the autopilot's name.

        Yields:
            The note, a coded finding with the new ratio and the logged one, both relative to the default.
        """
        names = self.loop.controller.parameter_names
        logged = self.loop.controller.parameters
        p_name = names["p"]
        default_ratios = {"i": self.defaults.ratios.integral, "d": self.defaults.ratios.derivative}
        for field, default_ratio in default_ratios.items():
            name = names[field]
            # A default of 0 has no ratio to compare with.
            if name not in gains or not default_ratio:
                continue
            relative_ratio = gains[name] / gains[p_name] / default_ratio
            factor = max(relative_ratio, 1 / relative_ratio)
            # Rounding of the gains must not cause a note.
            if factor > MAX_RATIO_CHANGE * RATIO_TOLERANCE:
                yield Fact(
                    GainFact.RATIO_UNUSUAL,
                    name=name,
                    ratio=relative_ratio,
                    logged_ratio=logged[name] / logged[p_name] / default_ratio,
                )


def logged_gains(controller: Controller) -> dict[str, float]:
    """Returns the logged gains that advice may change, by the autopilot's name.

    They are P, I and D of the rate controller and the gain of the attitude controller that the log has. A gain
    of 0 is left out: that term of the controller is switched off, and a factor does not change it.

    Args:
        controller: rate and attitude controller of one axis, by the parameters of the log.

    Returns:
        Gains in the autopilot's units, by the autopilot's name.
    """
    gains = {}
    for field in ("p", "i", "d", "angle_gain"):
        name = controller.parameter_names[field]
        if controller.parameters.get(name):
            gains[name] = controller.parameters[name]
    return gains


def scores_of_models(scores: Array) -> Array:
    """Returns the score of each model (M,): the least at all of the ``EFFECTIVENESS_FACTORS``.

    Args:
        scores: scores (E · M,) of all models at the first effectiveness, then of all at the second, and so on.
    """
    return scores.reshape(len(EFFECTIVENESS_FACTORS), -1).min(axis=0)


def round_gain(value: float) -> float:
    """Returns a gain with three digits, as a user would type it."""
    return float(f"{value:.3g}")


def bandwidth_of_estimate(open_loop: OpenLoop) -> float:
    """Returns the bandwidth of a loop by the estimated plant, Hz; the highest frequency if it is above all of them."""
    bandwidth = open_loop.bandwidth
    return float(open_loop.frequency[-1]) if isnan(bandwidth) else bandwidth


def _attitude_loops_alone(models: Loop) -> OpenLoop:
    """Returns the attitude loops of many plant models, judged as if the rate loops inside them were all stable.

    Around an unstable rate loop every attitude gain gives an unstable loop, so that the margins would not show whether
    the attitude gain itself is too high. The stability of the rate loops is judged separately.

    Args:
        models: rate and attitude loop of all models, at each control effectiveness.
    """
    return replace(models.attitude, is_inner_stable=None)


def _log_change(value: float, logged: float) -> float:
    """Returns the absolute natural logarithm of the factor between a gain and its logged value."""
    return abs(log(value / logged))
