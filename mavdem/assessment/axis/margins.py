"""Stability margins of an axis, judged by facts (coded findings): its identified loop, or resonances in the log."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isfinite

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segments, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import LoopFact, ResponseFact, StepResponseFact
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import MAX_AT_LIMIT_SHARE
from mavdem.loops.attitude_response import predicted_attitude_response
from mavdem.loops.axis_loops import (
    MARGIN_TARGETS,
    Loop,
    identified_loops,
    margin_rating,
    margin_ratios,
)
from mavdem.loops.injected_signal import injected_loop
from mavdem.loops.loop_construction import at_limit_share
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.measured_response import MIN_RESPONSE_FIT
from mavdem.loops.rate_setpoint import has_rate_feedforward
from mavdem.loops.resonance import (
    MAX_LOOP_FREQUENCY,
    Resonance,
    setpoint_resonance,
    spectral_resonance,
)
from mavdem.loops.step_response import (
    StepResponse,
    attitude_step_response,
    rate_step_response,
)

LEAST_MARGINS = MARGIN_TARGETS["sharp"]
"""The smallest margins that are advised: a loop that surely has less is bad."""

USUAL_MARGINS = MARGIN_TARGETS["default"]
"""The usual margins: a loop that has less is to be watched."""

SETPOINT_WAS_LOGGED = (
    LoopFact.CROSSOVER_UNSEEN,
    LoopFact.LOOP_NOT_FOUND,
    LoopFact.MARGIN_UNCERTAIN,
    *ResponseFact,
)
"""Reasons why a loop is not identified although the log has a setpoint of the rate that excited the axis."""


@dataclass(frozen=True, eq=False)
class AxisMargins:
    """What is known of the stability margins of one axis."""

    axis: str
    loop: Loop | Fact | None
    """The identified loop, unless a measured response contradicts it; otherwise why it is not known."""
    response: Resonance | None
    """The largest response of the rate to its setpoint; None if it was not measured."""
    peak: Resonance | None
    """A peak of the rate's spectrum that the motors share; None without one."""
    injected: OpenLoop | None = None
    """The rate loop measured by an injected signal, without a model of the vehicle; None without a test."""
    contradiction: Fact | None = None
    """That the measured response of the rate differs from the one that the loop predicts; None if it does not, or that
    is not known."""
    attitude_contradiction: Fact | None = None
    """The same of the angle's response. The rate loop may be right nevertheless."""

    @property
    def is_loop_doubtful(self) -> bool:
        """Whether the loop is not known, or a measured response contradicts it, so that its margins may be wrong."""
        return not isinstance(self.loop, Loop) or self.contradiction is not None

    @cached_property
    def facts(self) -> Facts:
        """What is known of the stability margins: at most two facts, each good, to be watched or bad.

        One is about the margins themselves. The other, which is independent of it, is whether the measured response of
        the rate to its setpoint has a resonance. A fact of the level "unknown", whose interval contains the limit
        between good and bad, is left out.
        """
        facts = []
        if self._margin_fact is not None:
            facts.append(self._margin_fact)
        if self.response is not None:
            facts.append(resonance_fact(self.response))
        return tuple(fact for fact in facts if fact.level is not Level.UNKNOWN)

    @cached_property
    def margins_by_slow_log(self) -> Fact | None:
        """The fact about margins that the identified loop seems to have, but by a log that is too slow to be sure.

        None in other cases. Its level is "unknown", so that :attr:`facts` do not include it.
        """
        margin_fact = self._margin_fact
        if margin_fact is None or margin_fact.code is not MarginsLight.LOOP_MARGINS:
            return None
        return margin_fact if margin_fact.level is Level.UNKNOWN else None

    @cached_property
    def _margin_fact(self) -> Fact | None:
        """The fact on the margins from the best source that the log has; None if it has none.

        The best is the loop as measured by an injected signal, which needs no model. Then comes the identified loop,
        and last a peak in the spectrum of the rate, which may be an oscillation of the loop.
        """
        if self.injected is not None:
            return _injected_fact(self.axis, self.injected)
        if isinstance(self.loop, Loop):
            return _loop_fact(self.loop, self.contradiction)
        if self.peak is not None:
            return self._spectral_peak_fact(self.peak)
        return None

    def _spectral_peak_fact(self, peak: Resonance) -> Fact:
        """Returns the fact that the spectrum of the rate has a peak, for an axis whose loop was not identified.

        A loop is identified by its setpoint. So the sentence of this fact advises to log the setpoint, unless the fact
        has a ``reason``. The reason is given if the log has the setpoint already: why the loop was not identified.

        Args:
            peak: frequency and height of the spectral peak, with its interval.
        """
        # None stands for the usual level of this code, "watch".
        fact = _peak_fact(MarginsLight.RATE_STANDS_OUT, level=None, resonance=peak)
        # Without an identified loop, this is the fact that says why there is none.
        loop_or_reason = self.loop
        if isinstance(loop_or_reason, Fact) and loop_or_reason.code in SETPOINT_WAS_LOGGED:
            return fact.replace(reason=loop_or_reason)
        return fact


def stability_margins_by_axis(
    signals: Signals, segments: Segments, loops: Mapping[str, Loop | Fact]
) -> tuple[AxisMargins, ...]:
    """Returns the stability margins of roll, pitch and yaw, as far as they are known.

    There are four sources for each axis: the identified loop, the response of the rate to its setpoint, a peak in the
    spectrum of the rate, and the loop as measured by an injected signal.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segments: segments of settled flight in which responses are measured.
        loops: the identified loop of each axis, or why it is not known.

    Returns:
        The margins of each axis, roll first; sources that the log lacks are None.
    """
    margins = []
    for axis in AXES:
        axis_signals = signals.for_axis(axis)
        loop = _confirmed_loop(axis, loops)
        margins.append(
            AxisMargins(
                axis,
                loop,
                response=setpoint_resonance(axis_signals, segments),
                peak=spectral_resonance(axis_signals, segments),
                injected=injected_loop(axis_signals, recorded_spans(axis_signals)),
                contradiction=_contradicting_response(loop, axis_signals, segments),
                attitude_contradiction=_contradicting_attitude(loop, axis_signals, segments),
            )
        )
    return tuple(margins)


def axes_with_doubtful_loop(
    margins: Iterable[AxisMargins], loops: Mapping[str, Loop | Fact]
) -> frozenset[str]:
    """Selects the axes whose loop was identified but is contradicted by a measured response.

    Args:
        margins: stability margins of each axis, as far as they are known.
        loops: the identified loop of each axis, or why it is not known.

    Returns:
        Names of these axes.
    """
    axes_with_loop = identified_loops(loops).keys()
    doubtful_axes = set[str]()
    for axis_margins in margins:
        if axis_margins.axis in axes_with_loop and axis_margins.is_loop_doubtful:
            doubtful_axes.add(axis_margins.axis)
    return frozenset(doubtful_axes)


def _contradicting_response(
    loop: Loop | Fact | None, signals: Signals, segments: Segments
) -> Fact | None:
    """Returns the fact that the measured response of the rate to its setpoint contradicts a loop's prediction.

    The two are compared here only if the comparison of the identification, over all frequencies (:attr:`Loop.agrees`),
    did not decide whether they agree.

    Args:
        loop: the identified loop of the axis, or why it is not known.
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of settled flight in which responses are measured.

    Returns:
        The fact; None if the two agree, or cannot be compared.
    """
    # An unstable loop predicts no response.
    if not isinstance(loop, Loop) or loop.agrees is not None or not loop.rate.is_stable:
        return None
    measured_response = rate_step_response(signals, segments, loop)
    if isinstance(measured_response, Fact):
        return None
    comparison = response_comparison(
        measured_response, loop, loop.rate.frequency, loop.rate.closed_loop_of_estimate
    )
    if comparison is None or comparison.code is not StepResponseFact.PREDICTION_DOUBTED:
        return None
    return comparison


def _contradicting_attitude(
    loop: Loop | Fact | None, signals: Signals, segments: Segments
) -> Fact | None:
    """Returns the fact that the measured response of the angle to its setpoint differs from a loop's prediction.

    The two may differ although the rate's responses agree, if the attitude controller does other than its gain says. So
    this is a reason against a new gain of that controller, but not against gains of the rate.

    Args:
        loop: the identified loop of the axis, or why it is not known.
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of settled flight in which responses are measured.

    Returns:
        The fact, which doubts the prediction or the measurement; None if the two agree, or cannot be compared.
    """
    # An unstable loop predicts no response.
    if not isinstance(loop, Loop) or not loop.attitude.is_stable:
        return None
    measured_response = attitude_step_response(signals, segments)
    if isinstance(measured_response, Fact):
        return None
    has_feedforward = has_rate_feedforward(signals, segments, loop.controller)
    predicted_response = predicted_attitude_response(loop, has_feedforward=has_feedforward)
    comparison = response_comparison(
        measured_response, loop, loop.attitude.frequency, predicted_response
    )
    if comparison is None or comparison.is_good:
        return None
    return comparison


def response_comparison(
    measured_response: StepResponse, loop: Loop, frequency: Array, closed_loop: Complex
) -> Fact | None:
    """Returns the fact that a measured and a predicted response agree, or which of the two is doubtful.

    The gains |T| of both are compared at some frequencies. When the loop was identified, its prediction of the rate was
    compared with the measured rate at all frequencies (:attr:`Loop.agrees`, None if that could not be decided). So that
    no report calls the same loop right in one place and wrong in another, that comparison decides where the two
    contradict each other on the rate.

    Args:
        measured_response: response of rate or angle to its setpoint, measured in flight.
        loop: the identified loops of the axis.
        frequency: (F,) frequencies of the prediction, Hz.
        closed_loop: (F,) predicted frequency response of the closed loop.

    Returns:
        The fact; None if it would contradict the identification, or if the difference has another likely cause.
    """
    comparison = measured_response.comparison(frequency, closed_loop)
    if comparison.is_good:
        return None if loop.agrees is False else comparison
    if loop.agrees is False:
        # Both comparisons show that the loop is wrong.
        return comparison
    if loop.agrees is True and measured_response.loop == "rate":
        return None
    # The rate does not contradict the loop, but the response of an angle depends on the attitude controller too.
    return None if _has_other_cause_of_difference(loop) else comparison


def _has_other_cause_of_difference(loop: Loop) -> bool:
    """Returns whether the measured response of a loop may differ from its prediction although the loop is right.

    It may if a motor was at a limit too often, so that the response is not linear, or if gains changed in flight, so
    that the measured response mixes two loops.

    Args:
        loop: the identified loops of an axis.
    """
    if loop.measured is not None and loop.measured.reason is not None:
        if loop.measured.reason.code is ResponseFact.RESPONSE_LIMITED:
            return True
    return any(caution.code is LoopFact.PARAMETERS_CHANGED for caution in loop.cautions)


def _confirmed_loop(axis: str, loops: Mapping[str, Loop | Fact]) -> Loop | Fact | None:
    """Returns the identified loop of an axis, unless the measured response contradicts it.

    Each loop predicts the response of the rate to its setpoint, which is measured in flight too. If the two differ, the
    loop is rejected, for the reason ``Loop.disagreement``. If too little was measured to compare them, the other axes
    decide: if the response of one of them has less than half of the required fit, the vehicle did not fly with the
    gains or the mixer that its parameters state, and every loop computed from them is rejected.

    Args:
        axis: "roll", "pitch" or "yaw".
        loops: the identified loop of each axis, or the reason why it is not known.

    Returns:
        The loop; or the fact why it is not known or rejected; None if nothing is known of the axis.
    """
    loop = loops.get(axis)
    if not isinstance(loop, Loop) or loop.agrees:
        return loop
    if loop.disagreement:
        return loop.disagreement
    # Too little of this axis' response was measured, so that the other axes decide.
    for other_loop in identified_loops(loops).values():
        if other_loop.disagreement is None or other_loop.measured is None:
            continue
        # The response has less than half of the required fit.
        if other_loop.measured.agreement < MIN_RESPONSE_FIT / 2:
            return other_loop.disagreement
    return loop


def _loop_fact(loop: Loop, contradiction: Fact | None) -> Fact:
    """Judges the stability margins of an identified loop, as a fact: a code with a level and figures.

    The level is good if 95 % of the plants that agree with the flight have the usual margins, as in
    :func:`mavdem.loops.axis_loops.margin_rating`, which `mavdem tune` goes by, too: then the lower end of the 90 %
    interval has them. It is unknown if the log is too slow for that to be sure. It is bad if at most 10 % of the plants
    have the least margins to fly with, and otherwise "watch". The margins are those at the thrust of the flight; only
    advised gains must keep them with 20 % more or less.

    If a motor is at a limit for longer than ``MAX_AT_LIMIT_SHARE`` of the flight, the level is "watch" at best: the
    mixer then gives up a part of the demand, and no loop was compared with the truth in such flights.

    If a measured response contradicts the model, the level is "watch" in any case: the spread of the plants does not
    contain the error that the measurement shows.

    Args:
        loop: rate and attitude loop of the axis, with the plant that was identified in flight.
        contradiction: fact that the measured response differs from the predicted one; None if nothing shows that.

    Returns:
        A fact with the figures of the rating, its axis, whether the estimate of the plant is biased, and the
        contradiction as ``reason``.
    """
    rating = margin_rating(loop)
    fraction_at_limit = at_limit_share(loop.record, loop.controller)
    has_margins = rating.level in (Level.GOOD, Level.UNKNOWN)
    if has_margins and fraction_at_limit > MAX_AT_LIMIT_SHARE:
        rating = rating.replace(Level.WATCH)
    level = Level.WATCH
    if contradiction is None and rating.level in (Level.GOOD, Level.UNKNOWN):
        level = rating.level
    elif contradiction is None and loop.share_meeting(LEAST_MARGINS) <= 1 - CONFIDENCE_LEVEL:
        level = Level.BAD
    return Fact(
        MarginsLight.LOOP_MARGINS,
        level,
        subject=rating.subject,
        axis=loop.axis,
        rating=rating.level,
        # Only too low an effectiveness is reported: the true margins are then smaller than the estimated ones.
        is_biased=loop.plant.bias < 0,
        reason=contradiction,
        **rating.figures,
    )


def _injected_fact(axis: str, loop: OpenLoop) -> Fact:
    """Judges the stability margins of a rate loop that was measured by an injected signal, without a model.

    The level is good if all usual margins are met, bad if any of the least margins to fly with is missed, and otherwise
    "watch".

    Args:
        axis: "roll", "pitch" or "yaw".
        loop: the measured response of the open loop.

    Returns:
        A fact with the crossover ``frequency``, Hz, phase and gain margin, and the peak of the sensitivity ``ms``. The
        gain margin is None if the phase never crosses −180°.
    """
    # Each ratio is a measured margin over the required one, so that 1 just meets it.
    level = Level.GOOD
    if min(margin_ratios(LEAST_MARGINS, loop).values()) < 1:
        level = Level.BAD
    elif min(margin_ratios(USUAL_MARGINS, loop).values()) < 1:
        level = Level.WATCH
    return Fact(
        MarginsLight.LOOP_MEASURED,
        level,
        axis=axis,
        frequency=loop.crossover,
        phase_margin=loop.phase_margin,
        gain_margin=loop.gain_margin if isfinite(loop.gain_margin) else None,
        ms=loop.ms,
    )


def resonance_fact(resonance: Resonance) -> Fact:
    """Judges whether the response of a rate to its setpoint resonates, by the interval of its peak.

    A loop with small margins amplifies some frequencies. Ms is the peak of its sensitivity |1/(1 + L)|, and follows
    from the peak of the response with an interval. The loop resonates if all of the interval is above the Ms of the
    usual margins, and is bad if it is above the Ms of the least ones. It is good if all of it is below the usual Ms. An
    interval that contains the limit decides nothing, and the level is "unknown".

    Args:
        resonance: peak of the measured response, which must have an interval.

    Returns:
        The fact "resonates" or "no resonance", with its level. If it resonates, the fact has the interval of Ms with
        its frequency and the coherence there, and the Ms that it should not exceed.
    """
    assert resonance.ms_interval is not None
    lowest_ms, highest_ms = resonance.ms_interval
    code = MarginsLight.RESONATES
    level = Level.UNKNOWN
    if lowest_ms > USUAL_MARGINS.ms:
        level = Level.BAD if lowest_ms > LEAST_MARGINS.ms else Level.WATCH
    elif highest_ms < USUAL_MARGINS.ms:
        code = MarginsLight.NO_RESONANCE
        # A response that was measured only up to a low frequency may rise again where the rate loop crosses over.
        if resonance.rolls_off and resonance.max_frequency >= MAX_LOOP_FREQUENCY / 2:
            level = Level.GOOD
    fact = _peak_fact(code, level, resonance)
    if code is MarginsLight.NO_RESONANCE:
        return fact
    return fact.replace(
        ms_interval=resonance.ms_interval,
        needed=USUAL_MARGINS.ms,
        frequency=resonance.ms_frequency,
        coherence=resonance.ms_coherence,
    )


def _peak_fact(code: MarginsLight, level: Level | None, resonance: Resonance) -> Fact:
    """Returns a fact that states the height and the frequency of the peak of a response or spectrum.

    Args:
        code: code of the fact, by which reports find its sentence.
        level: its level; None for the usual level of the code.
        resonance: peak of a measured response or spectrum.

    Returns:
        A fact with the height of the peak as ``ratio``, its ``frequency`` in Hz, the ``coherence`` there, and as
        ``rate`` the highest frequency that was measured, Hz.
    """
    return Fact(
        code,
        level,
        axis=resonance.axis,
        ratio=resonance.peak,
        frequency=resonance.frequency,
        coherence=resonance.coherence,
        rate=resonance.max_frequency,
    )
