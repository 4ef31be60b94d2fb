"""Learnability: can a model of one axis be learned from a log; if not, why; if so, what makes it less reliable."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavdem.dataset import phases, quality
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.axes import MAX_BODY_RATE, TILT_AXES
from mavdem.dataset.motor_outputs import (
    DEMAND_MESSAGE,
    RECORD_A_FLIGHT,
    MotorOutputs,
    motor_outputs_or_obstacle,
)
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.segments import Segment, Segments, settled_segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals, rate_between_outages
from mavdem.facts import Fact, Facts
from mavdem.facts.learnability import Caution, MotorObstacle, Reason, Remedy
from mavdem.flight import Flight
from mavdem.ingest import Component
from mavdem.ingest.motors import MULTIROTORS, POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.unit_errors import RATE_INTEGRATION_SPAN

NEVER_ARMED = Fact(Reason.NEVER_ARMED, remedy=RECORD_A_FLIGHT)
MIN_SNR = 1.0
MIN_TRUSTED_SNR = 20.0
"""Variance over that of its rounding, of the motors' command and of the outputs' changes. Rounding what something is
learned from can shrink what is learned to SNR/(1 + SNR) of the truth: to half at 1, by 5 % at 20."""
MIN_CONSISTENCY = 0.5
MIN_TRUSTED_CONSISTENCY = 0.8
"""Share of the angle's changes over ``RATE_INTEGRATION_SPAN`` that the integrated rates explain. Both measure one
motion; where they disagree, the rate is an alias, noise, or in another unit: some of it, or most."""
STILL_RATE = np.radians(1.0)  # rad/s, standard deviation: twice the noise of a gyroscope in flight
DOUBTFUL_LOSS = 0.05  # Share of a stream's messages left out as damaged: the rest may be too
MIN_SEGMENT_DURATION = 5.0
"""Seconds: a few swings of an axis that moves at 1 Hz, and a few hundred samples for a few tens of parameters."""
MOST_JUDGED = 100
"""Segments, the longest: of thousands, between clocks that jump, none is better."""
REFUSED_IMPOSSIBLE = 0.01
"""Share of messages with an angle or a rate that cannot be: too many for odd ones, so they are in another unit."""
MAX_STEP_RATIO = 1.25
"""Mean step of a segment's messages, over that of the longest segment, up to which both are sampled alike: a link that
loses a fifth of the messages makes it so, as in ``MINIMUM_RATE``."""


@dataclass(frozen=True)
class Learnability:
    """Whether a model of ``axis`` can be learned."""

    axis: str
    learnable: bool
    reason: Fact
    """The figures that decided, and what to change."""
    cautions: Facts = ()
    """What makes a model less reliable."""
    segment: Segment | None = None
    """The one to learn from or, when refused, the longest; None when there is none."""
    figures: QualityFigures = field(default_factory=QualityFigures)
    """Measured on the segment."""
    flight: Flight | None = field(default=None, repr=False, compare=False)
    """The aligned segment, if there is one."""
    segments: Segments = field(default=(), repr=False)
    """All of settled flight, the longest first."""

    @property
    def remedy(self) -> str:
        """What to change, with the command where there is one; empty when learnable."""
        return self.reason.remedy


def learnability_of(signals: Signals, components: Sequence[Component] = ()) -> Learnability:
    """Returns the longest settled segment that can be learned from, or why the longest cannot.

    The ``components`` of the log may ask for other rates.
    """
    return next(segment_learnabilities(signals, components))


def segment_learnabilities(
    signals: Signals, components: Sequence[Component] = (), least_rate: float = MIN_STREAM_RATE
) -> Iterator[Learnability]:
    """Yields what :func:`learnability_of` returns and, if that is learnable, each other segment that is long enough.

    Both streams need ``least_rate``, Hz. All flights have the sampling step of the first; a segment too slow for that
    (``MAX_STEP_RATIO``) is refused.
    """
    if (reason := _unusable(signals, components)) is not None:
        yield Learnability(signals.axis, False, reason)
        return
    attitude, drive = signals.attitude_and_inputs
    segments = settled_segments(signals)
    figures = quality.log_quality(signals, len(segments))
    log = _Evidence(signals, attitude, drive, components, figures, segments, least_rate)
    if figures.armed == 0:
        reason = NEVER_ARMED
    elif figures.airborne == 0:
        reason = _grounded(signals, figures)
    elif not segments:
        reason = log.slow_or_short(figures)
    if reason is not None:
        yield Learnability(signals.axis, False, reason, figures=figures)
        return
    # Of the segments too short the longest only, if there is no other.
    long = [part for part in segments if part.duration >= MIN_SEGMENT_DURATION] or segments[:1]
    judged = []
    for segment in long[:MOST_JUDGED]:
        judged.append(log.judge(segment))
        if judged[-1].learnable:
            break
    first = judged[-1] if judged[-1].learnable else judged[0]
    yield first
    if first.learnable and first.flight is not None:
        for segment in long:
            if segment != first.segment:
                yield log.judge(segment, first.flight.dt)


def _unusable(signals: Signals, components: Sequence[Component]) -> Fact | None:
    """Why no flight need be looked for in a log, if that is so."""
    telemetry = signals.telemetry
    attitude = signals.attitude
    recorder = telemetry.translated_from
    if telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        other = next((each for each in components if each.kind in MULTIROTORS), None)
        return Fact(
            Reason.NO_MULTIROTOR,
            recorder=recorder,
            kind=telemetry.vehicle,
            other=other and f"{other.system}:{other.component}",
            other_kind=other and other.kind,
        )
    if attitude is None:
        return Fact(Reason.NO_ATTITUDE, recorder=recorder, remedy=rate_advice(telemetry))
    if signals.model_inputs is None:
        never = signals.armed is not None and not signals.armed.values.any()
        return NEVER_ARMED if never else _without_drive(signals)
    name = telemetry.name_in_source(attitude.message)
    if attitude.impossible_count > REFUSED_IMPOSSIBLE * attitude.sent_count:
        return _impossible(Reason.ATTITUDE_UNIT, attitude, name).but(recorder=recorder)
    if not len(attitude.time):
        return Fact(Reason.ATTITUDE_NOT_FINITE, name=name, axis=signals.axis)
    return None


def _impossible(code: Reason | Caution, attitude: Attitude, name: str) -> Fact:
    return Fact(
        code,
        count=attitude.impossible_count,
        sent=attitude.sent_count,
        name=name,
        body_rate=MAX_BODY_RATE,
    )


def _without_drive(signals: Signals) -> Fact:
    telemetry = signals.telemetry
    if signals.inputs == "demand":
        recorded = DEMAND_MESSAGE in telemetry.messages
        return Fact(
            Reason.DEMAND_CONSTANT if recorded else Reason.NO_DEMAND,
            axis=signals.axis,
            name=telemetry.name_in_source(DEMAND_MESSAGE),
            recorder=telemetry.translated_from,
        )
    obstacle = motor_outputs_or_obstacle(telemetry)
    assert isinstance(obstacle, Fact)
    slow = obstacle.code is MotorObstacle.NO_MOTOR_MESSAGE
    return obstacle.but(remedy=rate_advice(telemetry)) if slow else obstacle


@dataclass(frozen=True, eq=False)
class _Evidence:
    """The evidence: signals, the streams among them that decide, and the figures of the whole log."""

    signals: Signals
    attitude: Attitude
    drive: MotorOutputs
    components: Sequence[Component]
    figures: QualityFigures
    segments: Segments
    least_rate: float  # Hz, that both streams need

    def name(self, stream: Attitude | MotorOutputs) -> str:
        return self.signals.telemetry.name_in_source(stream.message)

    def judge(self, segment: Segment, dt: float | None = None) -> Learnability:
        """Whether a ``segment`` can be learned from, in steps of ``dt``, s, or its own."""
        signals = self.signals
        flight = aligned_flight(signals, segment, dt)
        figures = quality.segment_quality(signals, segment, flight, self.figures)
        reason = self.objection(figures)
        slower = slower_stream_rate(figures)
        if reason is None and slower * flight.dt * MAX_STEP_RATIO < 1:
            reason = Fact(
                Reason.SLOWER_THAN_LONGEST,
                rate=slower,
                least_rate=1 / flight.dt,
                remedy=self.ask_for_rate(),
            )
        learnable = reason is None
        if reason is None:
            reason = Fact(
                Reason.LEARNABLE,
                axis=signals.axis,
                duration=segment.duration,
                attitude_rate=figures.attitude_rate,
                motor_rate=figures.motor_rate,
                # Attitude may be interpolated at PX4's body rates, whose rate is then no attitude's.
                body_rates=self.name(self.attitude) == "vehicle_angular_velocity",
                demand=self.drive.message == DEMAND_MESSAGE,
            )
        cautions = tuple(segment_cautions(signals, figures)) if learnable else ()
        return Learnability(
            signals.axis, learnable, reason, cautions, segment, figures, flight, self.segments
        )

    def objection(self, figures: QualityFigures) -> Fact | None:
        """Why a segment of these ``figures`` cannot be learned from, if that is so."""
        axis = self.signals.axis
        tilts = axis in TILT_AXES
        short = (figures.duration or 0.0) < MIN_SEGMENT_DURATION
        # A short segment of a slow stream may be fast; it is still the rate of the stream that should change.
        if short:
            return self.slow_or_short(self.figures, figures.duration)
        if reason := self.too_slow(figures) or self.repeated(figures):
            return reason
        if not figures.rate_sd or not (figures.angle_sd or not tilts):
            return Fact(Reason.OUTPUT_CONSTANT, axis=axis)
        if figures.output_snr is not None and figures.output_snr < MIN_SNR:
            return Fact(
                Reason.OUTPUT_ROUNDED,
                axis=axis,
                span=RATE_INTEGRATION_SPAN,
                angle_step=figures.angle_step,
                rate_step=figures.rate_step,
            )
        if figures.consistency is not None and figures.consistency < MIN_CONSISTENCY:
            return Fact(
                Reason.RATE_CONTRADICTS_ANGLE,
                axis=axis,
                consistency=figures.consistency,
                span=RATE_INTEGRATION_SPAN,
                still=tilts and figures.rate_sd < STILL_RATE,
                remedy=rate_advice(self.signals.telemetry, rate=200),
            )
        if figures.input_snr is not None and figures.input_snr < MIN_SNR:
            return Fact(
                Reason.COMMAND_ROUNDED,
                axis=axis,
                command=figures.input_sd,
                command_step=figures.input_step,
                unit=self.drive.scale.unit,
            )
        return None

    def slow_or_short(self, figures: QualityFigures, duration: float | None = None) -> Fact:
        """Which rate of the log leaves no segment that is long enough, or else its ``duration``, s."""
        is_logged = self.signals.telemetry.translated_from in ("DataFlash", "ULog")
        return self.too_slow(figures) or Fact(
            Reason.TOO_SHORT,
            duration=duration,
            least_duration=MIN_SEGMENT_DURATION,
            airborne=figures.airborne,
            recorder="logger" if is_logged else "link",
        )

    def too_slow(self, figures: QualityFigures) -> Fact | None:
        """Whether a stream comes too slowly."""
        attitude_rate = figures.attitude_rate or 0.0
        rates = {
            self.name(self.attitude): attitude_rate,
            self.name(self.drive): figures.motor_rate or 0.0,
        }
        slow = slow_streams(rates, self.signals.axis, self.least_rate)
        return slow and slow.but(remedy=self.for_faster(attitude_rate >= MIN_STREAM_RATE))

    def repeated(self, figures: QualityFigures) -> Fact | None:
        """Whether a stream repeats old values under new stamps."""
        for stream, rate, fresh in (
            (self.attitude, figures.attitude_rate, figures.attitude_fresh or 0.0),
            (self.drive, figures.motor_rate, figures.motor_fresh or 0.0),
        ):
            if fresh < self.least_rate:
                return Fact(
                    Reason.VALUES_REPEATED,
                    name=self.name(stream),
                    rate=rate,
                    fresh_rate=fresh,
                    least_rate=self.least_rate,
                    axis=self.signals.axis,
                    remedy=rate_advice(self.signals.telemetry),
                )
        return None

    def for_faster(self, attitude_is_fast: bool) -> Fact:
        """What makes streams come faster that come too slowly, or do without."""
        signals = self.signals
        demand = signals.demand if signals.inputs == "motors" and attitude_is_fast else None
        if demand is not None and (rate := rate_between_outages(demand)) >= MIN_STREAM_RATE:
            return Fact(Remedy.LEAVE_OUT_MOTORS, axis=signals.axis, rate=rate)
        return self.ask_for_rate()

    def ask_for_rate(self) -> Fact:
        return rate_advice(self.signals.telemetry, components=self.components)


def slower_stream_rate(figures: QualityFigures) -> float:
    """Returns the rate of the slower stream of a segment, Hz; 0 where one is missing."""
    return min(figures.attitude_rate or 0.0, figures.motor_rate or 0.0)


def slow_streams(rates: Parameters, axis: str, least: float = MIN_STREAM_RATE) -> Fact | None:
    """Returns all messages slower than ``least``, of ``rates`` in Hz by name; None if none is."""
    slow = {name: rate for name, rate in rates.items() if rate < least}
    return (
        Fact(
            Reason.STREAMS_TOO_SLOW,
            names=tuple(slow),
            rates=tuple(slow.values()),
            least_rate=least,
            axis=axis,
        )
        if slow
        else None
    )


def _grounded(signals: Signals, figures: QualityFigures) -> Fact:
    """On a vehicle that was armed and did not fly: what shows that, if anything does."""
    name = signals.telemetry.name_in_source("EXTENDED_SYS_STATE")
    attitude, _ = signals.attitude_and_inputs
    held = any(phases.airborne_intervals(signals, int(boot)) for boot in np.unique(attitude.boot))
    by_collective = not held and signals.landed_state is None
    if by_collective and signals.collective is None:
        return Fact(Reason.NO_EVIDENCE_OF_FLIGHT, name=name, remedy=rate_advice(signals.telemetry))
    return Fact(
        Reason.NEVER_AIRBORNE,
        armed=figures.armed,
        name=name,
        climb_rate=phases.MIN_LIFT_OFF_SPEED if held else None,
        collective=phases.max_collective(signals) if by_collective else None,
        least_collective=phases.min_airborne_collective(signals.telemetry.parameters),
        remedy=RECORD_A_FLIGHT,
    )


def segment_cautions(signals: Signals, figures: QualityFigures) -> Iterator[Fact]:
    """Yields what was left out of attitude and inputs, what was assumed, and what a segment of ``figures`` lacks."""
    axis = signals.axis
    attitude, drive = signals.attitude_and_inputs
    called = signals.telemetry.name_in_source
    if attitude.impossible_count:
        name = called(attitude.message)
        yield _impossible(Caution.IMPOSSIBLE_ATTITUDE, attitude, name)
    for stream in (attitude, drive):
        if stream.unused_count > DOUBTFUL_LOSS * stream.sent_count:
            yield Fact(
                Caution.MESSAGES_LEFT_OUT,
                count=stream.unused_count,
                sent=stream.sent_count,
                name=called(stream.message),
            )
    if drive.message == DEMAND_MESSAGE:
        yield Fact(
            Caution.DEMAND_IS_INPUT,
            axis=axis,
            motor_rate=0.0 if signals.motors is None else rate_between_outages(signals.motors),
            least_rate=MIN_STREAM_RATE,
        )
    if signals.telemetry.vehicle == "UNKNOWN":
        yield Fact(Caution.VEHICLE_ASSUMED)
    if drive.geometry.assumed:
        yield Fact(Caution.MIXER_ASSUMED, basis=drive.geometry.basis)
    if figures.output_snr is not None and figures.output_snr < MIN_TRUSTED_SNR:
        yield Fact(
            Caution.NEAR_RESOLUTION,
            axis=axis,
            angle_step=figures.angle_step,
            rate_step=figures.rate_step,
            share=min(1.0, 1 / (1 + figures.output_snr)),
        )
    if figures.consistency is not None and figures.consistency < MIN_TRUSTED_CONSISTENCY:
        yield Fact(Caution.RATE_EXPLAINS_LITTLE, consistency=figures.consistency)
