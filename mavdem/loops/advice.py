"""Tuning advice: gains of one axis for the next flight, with which both loops keep given margins, and what to expect.

Margins come first, then bandwidth, then wind (``gain_design``). They hold in draws of the plant's posterior with more
and less control effectiveness than in the flight, as by a full and an empty battery, or load. Half of the draws choose
the gains, the others judge them. Nothing is sent to a vehicle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isclose
from typing import NamedTuple

import numpy as np

from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.containers import JsonValues
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.parameter_history import ParametersInFlight
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import GainFact, LoopAction
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
from mavdem.loops.demand_noise import DemandNoise, demand_noise
from mavdem.loops.gain_design import (
    EFFECTIVENESS_FACTORS,
    MAX_GAIN_STEP,
    MIN_BANDWIDTH_GAIN,
    NO_STEP,
    SURE_SHARE,
    GainSearch,
    GainStep,
    Stage,
    bandwidth_of_estimate,
    logged_gains,
    round_gain,
    scores_of_models,
)
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.loop_construction import at_limit_share
from mavdem.loops.measured_response import MIN_RESPONSE_FIT
from mavdem.plant.parameters import DRAWS, ESTIMATE, LAG

GAIN_REDUCTION = 2 / 3
"""Factor on the gains that make a vehicle oscillate: 3.5 dB less."""
MAX_AT_LIMIT_SHARE = 0.18
"""Largest share of a flight with a motor at a limit from which gains are advised.

Identification allows for limits. On the simulated flights of ``tools/validation/advice.py``, gains from 42 loops with
shares of 0.05 to 0.18 had their margins in the true plant in 41, and at 0.8 to 1.2 times its effectiveness in 36;
larger shares were not tried.
"""

CLEAR_RESPONSE_FIT = (MIN_RESPONSE_FIT + 100.0) / 2
"""Fit of the measured response, %, that clearly confirms a loop: its error is at most half of the accepted one."""

MIN_FOLLOWED_SHARE = 0.8
"""Least gain |T| of a rate loop at half its crossover frequency.

A loop that integrates there, as with little damping of the rate, has |L| = 2 and |T| = 2 / √5 = 0.89. Less shows that
damping leaves a lasting error, which the integral gain is too small to remove.
"""


class Gain(NamedTuple):
    """A gain of the autopilot before and after the advice, in its unit."""

    now: float
    """The value in the log."""
    set: float
    """The value to set."""


@dataclass(frozen=True, eq=False, repr=False)
class Advice(ImmutableResult):
    """Gains of one axis to set for the next flight, and what to expect of them."""

    target: MarginTarget
    """The margins to have."""
    rating: Fact
    """Whether the loops of the flight have these margins."""
    refusals: Facts
    """Why no gains are advised; empty if they are."""
    before: Loop
    """The loops with the gains of the log."""
    after: Loop
    """The loops with the gains to set, for draws of the plant that did not choose them."""
    gains: dict[str, Gain]
    """Each gain by the autopilot's name, changed or not."""
    sure: float
    """Fraction (0 to 1) of the plant models, drawn from their posterior, for which both loops have the margins with the
    gains to set, at all ``EFFECTIVENESS_FACTORS``."""
    noise: DemandNoise | None
    """Noise of the gyro in the demand; ``None`` if the log is too slow to show it."""
    stage: Stage | None
    """Which gains change; ``None`` if none do."""
    design: Parameters
    """Gains at the end of the stage, as this flight shows them; empty if no gains change."""
    flights: int
    """Number of steps, with a flight after each, until the design is set; 0 if no gains change."""
    notes: Facts
    """What is unusual about the gains, and why: the ratios of the rate controller's gains."""

    @property
    def parameters(self) -> Parameters:
        """The gains to set, by the autopilot's name, if they change."""
        return {name: gain.set for name, gain in self.gains.items() if gain.set != gain.now}

    @property
    def fraction_without_margins_before(self) -> float:
        """Fraction (0 to 1) of the plant models for which the loops lack the margins with the logged gains.

        The control effectiveness is that at the thrust of the flight.
        """
        return 1 - self.before.share_meeting(self.target)

    @property
    def is_sound(self) -> bool:
        """Whether the flight shows clearly enough that the gains should be changed.

        That is so if at least ``SURE_SHARE`` of the plant models have the margins with the new gains, or lack them with
        the logged ones. Otherwise the logged gains may be right as they are, and another flight is to show that first.
        """
        return max(self.sure, self.fraction_without_margins_before) >= SURE_SHARE

    @property
    def refuses_only_higher_gains(self) -> bool:
        """Whether the loop has its margins and keeps its gains, and only higher ones are refused."""
        codes = {reason.code for reason in self.refusals}
        return codes == {GainFact.LAG_UNRESOLVED}

    @property
    def weak_confirmation(self) -> Fact | None:
        """That the flight barely confirms the model of the loop, as a fact; None if it does so clearly, or not at all.

        The measured response of the rate then fits the predicted one little better than it must, and was compared only
        below the crossover frequency, at which the margins are.
        """
        loop = self.before
        if loop.measured is None or not loop.agrees:
            return None
        fit = loop.measured.agreement
        _, highest_frequency = loop.measured.band
        if fit >= CLEAR_RESPONSE_FIT or highest_frequency >= loop.crossover:
            return None
        return Fact(
            GainFact.FIT_BARELY_ENOUGH,
            share=fit / 100,
            needed=MIN_RESPONSE_FIT / 100,
            highest=highest_frequency,
            crossover=loop.crossover,
        )

    @property
    def flight_before_gains(self) -> Fact:
        """The advice to fly again before the gains are loaded, as a fact with the fractions of models behind it."""
        return Fact(
            LoopAction.FLY_BEFORE_GAINS,
            axis=self.before.axis,
            share=self.sure,
            share_lacking=self.fraction_without_margins_before,
            needed=SURE_SHARE,
            is_biased=self.before.has_biased_effectiveness,
        )

    @property
    def conclusion(self) -> Fact:
        """What to do with the gains: set them, keep them, take a step towards the margins, or why there is no advice.

        It is a :class:`Fact`, a code with figures, from which reports and documents make one sentence. The models are
        draws of the plant from its posterior. The figures are:

        - ``share``: fraction of the models with the margins at all ``EFFECTIVENESS_FACTORS``, with the new gains.
        - ``share_as_flown``: the same at the thrust of the flight alone.
        - ``share_lacking``: fraction of the models that lack the margins with the logged gains, at that thrust.
        - ``is_sound``: whether the flight is a basis for changing gains (:attr:`is_sound`).
        - ``has_room``: whether the logged gains surely have the margins already.
        - ``can_go_on``: whether gains of loops with enough margin may be raised further.
        - ``stage`` of tuning, number of ``flights`` that it still needs, and ``largest_step``, the factor by which a
          gain changes at most between two of them.
        - ``bandwidth`` and ``crossover`` of the rate loop, Hz, before and after.
        - ``expected``: rating of the loops with the new gains.
        - ``sluggish``: that the rate hardly follows its setpoint (:attr:`rate_sluggish`), or None.
        - The margins of the target, each under its own name.
        """
        if self.refusals:
            return Fact(GainFact.NO_GAINS_ADVISED, reasons=self.refusals)
        return Fact(
            self._code_of_conclusion,
            share=self.sure,
            share_as_flown=self.after.share_meeting(self.target),
            share_lacking=self.fraction_without_margins_before,
            is_sound=self.is_sound,
            has_room=self.rating.is_good,
            can_go_on=not reasons_for_no_gains(self.before, for_higher_gains=True),
            stage=int(self.stage or 0),
            flights=self.flights,
            largest_step=MAX_GAIN_STEP,
            bandwidth=(
                bandwidth_of_estimate(self.before.rate),
                bandwidth_of_estimate(self.after.rate),
            ),
            crossover=(self.before.rate.crossover, self.after.rate.crossover),
            expected=margin_rating(self.after, self.target),
            sluggish=self.rate_sluggish,
            **self.target._asdict(),
        )

    @property
    def rate_sluggish(self) -> Fact | None:
        """That the rate follows too little of a slow setpoint with the logged gains, as a fact; None if it does not.

        The fact has the followed ``share``, which is the gain |T| of the estimated loop at half its crossover
        frequency, that ``frequency`` in Hz, and the ``name`` and ``value`` of the rate's integral gain.
        """
        rate = self.before.rate
        controller = self.before.controller
        frequency = rate.crossover / 2
        share = float(np.interp(frequency, rate.frequency, abs(rate.closed_loop_of_estimate)))
        # A loop without a crossover (NaN) is not judged.
        if not share < MIN_FOLLOWED_SHARE:
            return None
        integral_name = controller.parameter_names["i"]
        return Fact(
            GainFact.RATE_SLUGGISH,
            share=share,
            frequency=frequency,
            name=integral_name,
            value=logged_gains(controller)[integral_name],
        )

    @property
    def _code_of_conclusion(self) -> GainFact:
        """The code of :attr:`conclusion` for gains that are known: keep them, set new ones, or go a step towards them.

        New gains are final (``SET_GAINS``) only if both loops have their margins with them in at least ``SURE_SHARE``
        of the models. Otherwise they are a step towards the margins.
        """
        changes_gains = bool(self.parameters)
        if not changes_gains:
            return GainFact.KEEP_GAINS
        if self.sure >= SURE_SHARE:
            return GainFact.SET_GAINS
        return GainFact.STEP_TOWARDS_MARGINS


AdviceByAxis = dict[str, Advice | Fact]
"""The advice by axis, or why there is none."""


def advised_parameters(advice_by_axis: AdviceByAxis) -> Parameters:
    """Returns the gains of all axes that are to be changed, by the autopilot's name."""
    parameters = dict[str, float]()
    for advice in advice_by_axis.values():
        if isinstance(advice, Advice):
            parameters |= advice.parameters
    return parameters


def advise(
    loop: Loop,
    tune: str = "default",
    doubts: Sequence[Fact] = (),
    *,
    attitude_doubt: Fact | None = None,
    raises_sound_gains: bool = False,
) -> Advice:
    """Returns gains of one axis for the next flight, as a step towards the fastest loops that have given margins.

    If the estimated loop has these margins, its gains are not changed unless ``raises_sound_gains``. So gains that were
    advised once and have been flown since are not changed again. What is tuned is determined by the loops: the rate
    loop while it lacks margin, and the attitude loop after that.

    No gains are advised if there are ``doubts`` about the flight or one of the :func:`reasons_for_no_gains`. With an
    ``attitude_doubt`` the gain of the attitude controller stays, while gains of the rate may change.

    The gains are chosen with half of the draws from the plant's posterior, and judged with the other half. Judged with
    the first half they would seem better than they are.

    Args:
        loop: rate and attitude loop of one axis, with N draws of the plant.
        tune: name of the required margins, a key of ``MARGIN_TARGETS``.
        doubts: reasons why the flight shows too little for advice, such as an oscillation; if there is any, no gains
            are advised.
        attitude_doubt: that the measured response of the angle differs from the predicted one; None if it does not.
        raises_sound_gains: whether the gains of a loop that has its margins are raised, to make it faster.

    Returns:
        The gains to set, or the reasons for none, with the loops before and after.
    """
    target = MARGIN_TARGETS[tune]
    rating = margin_rating(loop, target)
    may_change = raises_sound_gains or rating.is_bad
    refusals = tuple(doubts) or reasons_for_no_gains(
        loop, for_higher_gains=raises_sound_gains and not rating.is_bad
    )
    gains: dict[str, float] = {}
    step = NO_STEP
    if not refusals:
        gains = logged_gains(loop.controller)
        if gains and may_change:
            step = _next_step(loop, target)
        changes_angle_gain = bool(step.gains) and step.stage is Stage.ANGLE
        if attitude_doubt is not None and changes_angle_gain:
            refusals = (attitude_doubt,)
            gains, step = {}, NO_STEP
        gains |= step.gains
    # ``with_draws`` always keeps the estimated plant. The first half of the draws chose the gains.
    judging_draws = slice(len(loop.effectiveness) // 2, None)
    loop_after = loop.with_draws(judging_draws).with_parameters(gains)
    judging_loop = loop_after.with_draws(DRAWS, EFFECTIVENESS_FACTORS)
    scores = margin_scores(target, judging_loop.rate, judging_loop.attitude)
    present_gains = loop.controller.parameters
    return Advice(
        target=target,
        rating=rating,
        refusals=refusals,
        before=loop,
        after=loop_after,
        gains={name: Gain(present_gains[name], value) for name, value in gains.items()},
        sure=float(np.mean(scores_of_models(scores) >= 1)),
        noise=demand_noise(loop, loop_after.controller),
        stage=step.stage if step.gains else None,
        design=step.design,
        flights=step.flights,
        notes=step.notes,
    )


def _next_step(loop: Loop, target: MarginTarget) -> GainStep:
    """Designs the gains for the next flight, in the stage of tuning that the loop has reached.

    While the rate loop lacks margin, that is stage 1; while only the attitude loop does, stage 2. If both have enough
    margin, and gains are to be raised, it is stage 1 as long as the rate loop lacks margin at some effectiveness, or
    can become faster by more than ``MIN_BANDWIDTH_GAIN``, and then stage 2.

    Args:
        loop: the loops with the logged gains.
        target: phase margin, gain margin and maximum sensitivity that both loops should have.

    Returns:
        The gains with their stage; no gains if none are worth changing.
    """
    search = GainSearch(loop, target)
    rate_score = margin_scores(target, loop.rate)[ESTIMATE]
    attitude_score = margin_scores(target, loop.attitude)[ESTIMATE]
    if rate_score < 1:
        return search.step(Stage.RATE)
    if attitude_score < 1:
        return search.step(Stage.ANGLE)
    # The estimated plant has the margins; with 20 % more or less effectiveness they may still be missing.
    has_margins = search.margin_score(search.all_models.rate) >= 1
    step = search.step(Stage.RATE, may_lower_bandwidth=not has_margins)
    if step.gains:
        designed_rate = loop.with_parameters(step.design).rate
        bandwidth_ratio = bandwidth_of_estimate(designed_rate) / bandwidth_of_estimate(loop.rate)
        if bandwidth_ratio > MIN_BANDWIDTH_GAIN or not has_margins:
            return step
    return search.step(Stage.ANGLE)


def reasons_for_no_gains(loop: Loop, *, for_higher_gains: bool = False) -> Facts:
    """Returns the reasons why no gains can be advised for a loop.

    Only the first reason is returned: changed gains, motors at their limits, an unstable loop, a loop that the measured
    response contradicts, margins that may be all or none (:func:`_unknown_stability`), or, if gains are to be raised, a
    motor lag that the flight does not show. A biased control effectiveness is no reason: the spread of the plant's
    draws includes its possible error, and gains must have their margins in nearly all of them.

    Args:
        loop: rate and attitude loop of one axis.
        for_higher_gains: whether the loop has its margins, and gains are to be raised.

    Returns:
        The reasons as facts, from each of which reports make a sentence; empty if gains can be advised.
    """
    record = loop.record
    changed_parameters = parameters_changed_in_flight(record, loop.controller)
    if changed_parameters:
        return (Fact(GainFact.GAINS_CHANGED, names=sorted(changed_parameters)),)
    limited_share = at_limit_share(record, loop.controller)
    if limited_share > MAX_AT_LIMIT_SHARE:
        return (Fact(GainFact.MOTOR_AT_LIMIT, share=limited_share),)
    if not (loop.rate.is_stable and loop.attitude.is_stable):
        return (Fact(GainFact.LOOP_UNSTABLE),)
    if loop.disagreement:
        return (loop.disagreement,)
    unknown_stability = _unknown_stability(loop)
    if unknown_stability is not None:
        return (unknown_stability,)
    if for_higher_gains and not _shows_lag(loop):
        return (Fact(GainFact.LAG_UNRESOLVED, time_step=record.dt),)
    return ()


def _unknown_stability(loop: Loop) -> Fact | None:
    """Returns the reason not to design gains that the identified plant leaves open whether the loop is stable.

    The plant is known with an uncertainty, given as random draws from its posterior. The loop was stable in flight. So
    if many draws are unstable, while many others have all margins, the intervals of the margins mean nothing.

    Args:
        loop: rate and attitude loop of one axis, with draws of the plant from its posterior.

    Returns:
        A fact (coded finding) with the fractions of unstable draws and of draws with all margins, if both are above
        5 %. None otherwise: the loop is surely stable, or its margins are surely too small.
    """
    # The score of a draw is 1 if it just has all margins, and −∞ if it is unstable.
    scores = margin_scores(MARGIN_TARGETS["default"], loop.rate, loop.attitude)[DRAWS]
    unstable_fraction = float(np.mean(np.isneginf(scores)))
    fraction_with_margins = float(np.mean(scores >= 1))
    # The probability beyond one end of a 90 % interval: 5 %.
    tail_probability = 1 - INTERVAL_QUANTILES[1]
    if unstable_fraction <= tail_probability or fraction_with_margins <= tail_probability:
        return None
    return Fact(
        GainFact.STABILITY_UNKNOWN,
        subject=loop.axis,
        unstable_share=unstable_fraction,
        sound_share=fraction_with_margins,
    )


def _shows_lag(loop: Loop) -> bool:
    """Returns whether a flight shows the motors' lag well enough for gains to be raised.

    Without the rate setpoint, a plant is identified by the motors' outputs and the motion alone. A motor lag shorter
    than a sample then cannot be distinguished from the delay, so that predicted margins of higher gains may be too
    large. (For simulated vehicles with a lag of 6 ms and a delay of 7 to 12 ms, gain margins were overestimated by 2 to
    5 dB at 100 Hz.) Lower gains do not need that prediction.

    Args:
        loop: rate and attitude loop of one axis.

    Returns:
        True if the plant was identified with the rate setpoint, or the lag is at least one sample.
    """
    # A plant that was identified without the rate setpoint contains the gyro's filters.
    is_identified_in_loop = not loop.plant.filtered
    # The motor lag of the estimated plant, without the gyro's filters.
    lag = loop.dynamics[ESTIMATE, LAG]
    return is_identified_in_loop or bool(lag >= loop.record.dt)


GainChange = tuple[str, float, float]
"""Name of a gain, and its values before and after a change."""


class GainReduction(NamedTuple):
    """How to make gains a third lower than they were in a flight, by the values that the vehicle has now."""

    changes: Sequence[GainChange]
    """Gains to lower: name, value at the end of the log, and value to set."""
    changed: Facts
    """A fact on each gain that was lowered after the flight already, or that changed in it."""

    @property
    def figures(self) -> JsonValues:
        """The figures of a fact (coded finding) that advises this: ``changes`` and, if there are any, ``changed``."""
        figures: JsonValues = {"changes": self.changes}
        if self.changed:
            figures["changed"] = self.changed
        return figures


def gains_to_lower(names: Iterable[str], parameters: ParametersInFlight) -> GainReduction:
    """Returns how to make gains a third lower than they were in a flight.

    The pilot may have changed them since. So each new value is a fraction of the value in the flight, and the value
    that it replaces is that at the end of the log. Gains are lowered together, in one ratio: if one had several values
    in the flight, none gets a new one. If one was lowered so far already, the others stay: the next flight shows
    whether that is enough.

    Args:
        names: names of the gains of one loop.
        parameters: parameters of the autopilot in the flight. Gains that it has not reported are left out, and so are
            gains of 0, which are switched off.
    """
    advised_changes: list[GainChange] = []
    facts_on_past_changes = []
    must_others_stay = False
    for name in names:
        if name in parameters.changed_names:
            must_others_stay = True
            facts_on_past_changes.append(Fact(GainFact.GAIN_CHANGED_IN_FLIGHT, subject=name))
            continue
        value_in_flight = parameters.values.get(name)
        if not value_in_flight:
            continue
        advised_value = round_gain(GAIN_REDUCTION * value_in_flight)
        value_at_end = parameters.last_values.get(name, value_in_flight)
        # Logs have single precision, so that a gain that was set to the advised value may be larger by a rounding.
        if round_gain(value_at_end) > advised_value:
            advised_changes.append((name, value_at_end, advised_value))
        else:
            must_others_stay = True
            lowered_since = Fact(
                GainFact.GAIN_LOWERED_SINCE,
                subject=name,
                value_in_flight=value_in_flight,
                present_value=value_at_end,
            )
            facts_on_past_changes.append(lowered_since)
    if must_others_stay:
        advised_changes = []
    return GainReduction(advised_changes, changed=tuple(facts_on_past_changes))


def gain_reduction_advice(oscillation: Oscillation, parameters: ParametersInFlight) -> Fact:
    """Returns the advice to lower some gains by a third if a vehicle oscillates in a limit cycle.

    In a limit cycle, a loop oscillates with an amplitude that the motors' limits bound. A fast cycle is caused by P and
    D of the rate controller, a slow one by gains that add phase lag at low frequencies: the attitude gain and the
    integral gain I. Each of these two adds much lag only up to its corner frequency, rad/s, which is the attitude gain
    itself, and I / P. So each with a corner above half of the oscillation's frequency is lowered. If there is none, P
    and D are, and I with them: all three together lower the gain of the rate loop without more phase lag.

    Args:
        oscillation: oscillation of the axis with the largest body rate, with the oscillations of the other axes.
        parameters: parameters of the autopilot while it oscillated. If they describe no known controller, no values
            are advised.

    Returns:
        The advice as a fact, from which reports make a sentence. Its figure ``changes`` has name, value and new value
        of each gain to lower, and ``changed`` has facts on gains that were changed already. If the gains of an axis
        that does not oscillate are lowered too, ``alike_axis`` is its name, "roll" or "pitch".
    """
    advised_changes: list[GainChange] = []
    facts_on_past_changes: list[Fact] = []
    figures_on_alike_axis: JsonValues = {}
    for oscillation_of_axis in (oscillation, *oscillation.other_axes):
        # Without a known controller of the axis, no gains are named.
        with suppress(NotLearnable):
            # Only the gains are used, so the mixer has no effect, and the mixer of a single motor is given.
            single_motor_mixer = (1.0,)
            controller = controller_from_parameters(
                parameters.any_values, oscillation_of_axis.axis, single_motor_mixer
            )
            fields = _gains_behind_oscillation(controller, oscillation_of_axis.frequency)
            names = [controller.parameter_names[field] for field in fields]
            alike_controller = None
            if not oscillation.other_axes:
                alike_controller = _tilt_controller_with_same_gains(controller, fields, parameters)
            if alike_controller is not None:
                names += [alike_controller.parameter_names[field] for field in fields]
                figures_on_alike_axis = {"alike_axis": alike_controller.axis}
            reduction_of_axis = gains_to_lower(names, parameters)
            advised_changes += reduction_of_axis.changes
            facts_on_past_changes += reduction_of_axis.changed
    reduction = GainReduction(advised_changes, changed=tuple(facts_on_past_changes))
    return Fact(
        GainFact.LOWER_GAINS, **reduction.figures, **oscillation.figures, **figures_on_alike_axis
    )


def _tilt_controller_with_same_gains(
    controller: Controller, fields: Sequence[str], parameters: ParametersInFlight
) -> Controller | None:
    """Returns the controller of pitch for that of roll, or of roll for that of pitch, if some of their gains are equal.

    Args:
        controller: the controller of one axis.
        fields: the gains to compare, as a controller names them, such as "p" and "d".
        parameters: parameters of the autopilot in the flight.

    Returns:
        The controller of the other axis; None if one of these gains differs or is not known, or for yaw.
    """
    if controller.axis not in TILT_AXES:
        return None
    [other_axis] = [axis for axis in TILT_AXES if axis != controller.axis]
    try:
        other_controller = controller_from_parameters(
            parameters.any_values, other_axis, controller.motor_weights
        )
    except NotLearnable:
        return None
    for field in fields:
        if not isclose(getattr(other_controller, field), getattr(controller, field), rel_tol=1e-5):
            return None
    return other_controller


def _gains_behind_oscillation(controller: Controller, frequency: float | None) -> Sequence[str]:
    """Names the gains that most likely cause a limit cycle.

    By the rule of :func:`gain_reduction_advice` they are the attitude gain and I, if their corner frequencies are above
    half of the oscillation's frequency, or P, I and D if neither is.

    Args:
        controller: the controller of the axis.
        frequency: frequency of the oscillation, Hz; None, if it is not known, is treated as a high one.

    Returns:
        Names of the controller's fields: "angle_gain" and "i", one of them, or "p", "i" and "d".
    """
    angular_frequency = np.inf if frequency is None else 2 * np.pi * frequency
    # Without P the controller is an integrator at all frequencies.
    integral_corner = controller.i / controller.p if controller.p else np.inf
    lagging_gains = []
    if controller.angle_gain > angular_frequency / 2:
        lagging_gains.append("angle_gain")
    if integral_corner > angular_frequency / 2:
        lagging_gains.append("i")
    return lagging_gains or ["p", "i", "d"]
