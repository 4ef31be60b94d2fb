"""Whether a model can be learned from a segment of a log: checks, each of which returns the reason if it cannot.

A reason is a fact: a coded finding with its figures, from which a sentence for the user is made. Its ``remedy`` says
what the user should change.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.axes import MAX_BODY_RATE, TILT_AXES
from mavdem.dataset.motor_outputs import (
    DEMAND_MESSAGE,
    MotorOutputs,
)
from mavdem.dataset.quality import QualityFigures, segment_quality
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals, rate_between_outages
from mavdem.facts import Fact, Facts
from mavdem.facts.learnability import Caution, NotLearnableReason, Remedy
from mavdem.flight import Flight
from mavdem.ingest import Component
from mavdem.unit_errors import RATE_INTEGRATION_SPAN

MIN_SNR = 1.0
"""Signal-to-noise ratio of the inputs' command or of the outputs' changes, below which a log is refused.

The noise comes from rounding. Rounding can shrink what is learned to SNR / (1 + SNR) of the truth: to half at 1.
"""

MIN_TRUSTED_SNR = 20.0
"""The same ratio, below which a model comes with a caution: at 20 rounding can shrink what is learned by 5 %."""

MIN_CONSISTENCY = 0.5
"""Share of the angle's changes that the integrated rates explain, below which a log is refused.

Both measure one motion, over ``RATE_INTEGRATION_SPAN``. Where they disagree, most of the rate is an alias, noise, or in
another unit. A choice.
"""

MIN_TRUSTED_CONSISTENCY = 0.8
"""The same share, below which a model comes with a caution; a choice."""

MAX_STILL_RATE = np.radians(1.0)
"""Standard deviation, rad/s, of the body rate of a vehicle that hardly moves: twice a gyroscope's noise in flight."""

MAX_UNUSED_SHARE = 0.05
"""Share of a stream's messages that were damaged, above which a model comes with a caution: the rest may be too."""

MAX_IMPOSSIBLE_SHARE = 0.01
"""Share of messages with an impossible angle or rate, above which they have another unit and no damage; a choice."""

MIN_SEGMENT_DURATION = 5.0
"""Shortest segment, s, that is learned from.

It has a few oscillations of an axis that moves at 1 Hz, and a few hundred samples for a few tens of parameters.
"""

MAX_STEP_RATIO = 1.25
"""Ratio of the mean steps of messages in a segment and in the longest one, up to which both are sampled alike.

A link that loses a fifth of the messages has this ratio.
"""

LOGGERS = ("DataFlash", "ULog")
"""Recorders on board of the vehicle, in ``Telemetry.translated_from``; any other log was received over a link."""

ADVISED_RATE = 200
"""Rate, Hz, to record at where the rates contradict the angles, so that less of the motion is aliased; a choice."""


@dataclass(frozen=True)
class Learnability:
    """Whether a model of one axis can be learned from a segment or, without a segment, from a log."""

    axis: str
    """Axis of the model: "roll", "pitch" or "yaw"."""
    learnable: bool
    """Whether it can."""
    reason: Fact
    """Figures that decided, and what to change."""
    cautions: Facts = ()
    """What makes a model less reliable."""
    segment: Segment | None = None
    """Segment to learn from or, when refused, the longest one; None where there is none."""
    figures: QualityFigures = field(default_factory=QualityFigures)
    """Quality of that segment."""
    flight: Flight | None = field(default=None, repr=False, compare=False)
    """That segment, aligned."""
    segments: Segments = field(default=(), repr=False)
    """All segments of settled flight in the log, the longest first."""

    @property
    def remedy(self) -> str:
        """What to change, with the command where there is one; empty when learnable."""
        return self.reason.remedy


def segment_cautions(signals: Signals, quality: QualityFigures) -> Iterator[Fact]:
    """Yields cautions: facts about what makes a model of a segment less reliable.

    Args:
        signals: Logged time series of the vehicle, with angle, rate and setpoints of an axis.
        quality: Quality of the segment.

    Yields:
        Facts (``Caution``): on impossible attitudes and other messages that could not be used; on the controller's
        demand in the place of motor outputs; on an assumed vehicle or mixer; on rounded angles and rates; and on body
        rates that do not match the angles.
    """
    axis = signals.axis
    telemetry = signals.telemetry
    attitude, inputs = signals.attitude_and_inputs
    if attitude.impossible_count:
        yield impossible_attitude(signals, Caution.IMPOSSIBLE_ATTITUDE)
    for stream in (attitude, inputs):
        if stream.unused_count > MAX_UNUSED_SHARE * stream.sent_count:
            yield Fact(
                Caution.MESSAGES_LEFT_OUT,
                count=stream.unused_count,
                sent=stream.sent_count,
                name=telemetry.name_in_source(stream.message),
            )
    if inputs.message == DEMAND_MESSAGE:
        motors = signals.motors
        yield Fact(
            Caution.DEMAND_IS_INPUT,
            axis=axis,
            motor_rate=rate_between_outages(motors) if motors is not None else 0.0,
            least_rate=MIN_STREAM_RATE,
        )
    if telemetry.vehicle == "UNKNOWN":
        yield Fact(Caution.VEHICLE_ASSUMED)
    if inputs.geometry.assumed:
        yield Fact(Caution.MIXER_ASSUMED, basis=inputs.geometry.basis)
    if quality.output_snr is not None and quality.output_snr < MIN_TRUSTED_SNR:
        # Noise in a regressor shrinks its coefficient by the noise's share of the regressor's variance (attenuation
        # bias), noise / (signal + noise). An estimated signal variance below 0 would make it more than all.
        noise_share = min(1.0, 1 / (1 + quality.output_snr))
        yield Fact(
            Caution.NEAR_RESOLUTION,
            axis=axis,
            angle_step=quality.angle_step,
            rate_step=quality.rate_step,
            share=noise_share,
        )
    if quality.consistency is not None and quality.consistency < MIN_TRUSTED_CONSISTENCY:
        # The integral of the recorded body rates explains too little of the changes of the angle.
        yield Fact(
            Caution.RATE_EXPLAINS_LITTLE,
            consistency=quality.consistency,
            span=RATE_INTEGRATION_SPAN,
        )


def slower_stream_rate(quality: QualityFigures) -> float:
    """Returns the rate, Hz, of the slower one of attitude and model inputs; 0 where one is missing."""
    return min(quality.attitude_rate or 0.0, quality.motor_rate or 0.0)


def slow_streams(
    rates: Mapping[str, float], axis: str, min_rate: float = MIN_STREAM_RATE
) -> Fact | None:
    """Returns the reason to refuse streams of messages that come too slowly.

    Args:
        rates: Rate of each stream, Hz, by the name of its message.
        axis: "roll", "pitch" or "yaw": the axis of which a model is to be learned.
        min_rate: Rate, Hz, that each stream needs.

    Returns:
        The reason, with the names and rates of the slow streams; None if all are fast enough.
    """
    slow = {name: rate for name, rate in rates.items() if rate < min_rate}
    if not slow:
        return None
    return Fact(
        NotLearnableReason.STREAMS_TOO_SLOW,
        names=tuple(slow),
        rates=tuple(slow.values()),
        least_rate=min_rate,
        axis=axis,
    )


@dataclass(frozen=True, eq=False)
class SegmentJudge:
    """Judges for each segment of one log whether a model can be learned from it."""

    signals: Signals
    """Signals of the vehicle for an axis."""
    attitude: Attitude
    """Attitude of that axis."""
    inputs: MotorOutputs
    """Model inputs."""
    components: Sequence[Component]
    """All components in the log, for the advice on rates."""
    log_quality: QualityFigures
    """Quality of the whole log."""
    segments: Segments
    """All its segments of settled flight, the longest first."""
    min_rate: float
    """Rate, Hz, that attitude and inputs need."""

    def learnability(self, segment: Segment, dt: float | None = None) -> Learnability:
        """Decides whether a segment can be learned from.

        The segment's streams are first put on one grid of time. Its quality is then measured and checked, and last
        whether its slower stream is fast enough for the sampling step of the grid.

        Args:
            segment: The segment.
            dt: Sampling step, s, to align it with; by default its own.

        Returns:
            The decision with its reason, the measured quality and the aligned flight; with cautions if learnable.
        """
        signals = self.signals
        flight = aligned_flight(signals, segment, dt)
        quality = segment_quality(signals, segment, flight, self.log_quality)
        refusal = self.reason_to_refuse(quality)
        rate = slower_stream_rate(quality)
        if refusal is None and rate * flight.dt * MAX_STEP_RATIO < 1:
            refusal = Fact(
                NotLearnableReason.SLOWER_THAN_LONGEST,
                rate=rate,
                least_rate=1 / flight.dt,
                remedy=rate_advice(signals.telemetry, components=self.components),
            )
        if refusal is not None:
            return Learnability(
                signals.axis,
                learnable=False,
                reason=refusal,
                segment=segment,
                figures=quality,
                flight=flight,
                segments=self.segments,
            )
        attitude_name = signals.telemetry.name_in_source(self.attitude.message)
        reason = Fact(
            NotLearnableReason.LEARNABLE,
            axis=signals.axis,
            duration=segment.duration,
            attitude_rate=quality.attitude_rate,
            motor_rate=quality.motor_rate,
            # PX4's attitude may be interpolated to the stamps of the body rates; the rate is then theirs.
            body_rates=attitude_name == "vehicle_angular_velocity",
            demand=self.inputs.message == DEMAND_MESSAGE,
        )
        cautions = tuple(segment_cautions(signals, quality))
        return Learnability(
            signals.axis,
            learnable=True,
            reason=reason,
            cautions=cautions,
            segment=segment,
            figures=quality,
            flight=flight,
            segments=self.segments,
        )

    def reason_to_refuse(self, quality: QualityFigures) -> Fact | None:
        """Returns the reason why a model cannot be learned from a segment; None if it can.

        The checks are, in this order: the duration; the rates of messages and of new values; outputs that are constant
        or lost in rounding; body rates that contradict the angles; a torque command that is lost in rounding. The first
        check that fails gives the reason.

        Args:
            quality: quality of the segment.

        Returns:
            The reason, with the values that decided and a remedy where there is one.
        """
        # The gaps of a slow stream cut a flight into short segments, in which the messages may well be fast. Then the
        # user should raise the rate, and not fly longer. So for a short segment the rates of the whole log are checked.
        if (quality.duration or 0.0) < MIN_SEGMENT_DURATION:
            return self.slow_or_short(self.log_quality, quality.duration)
        for check in (
            self._too_slow_for_model,
            self._repeated_values,
            self._constant_or_rounded_outputs,
            self._inconsistent_rates,
            self._rounded_command,
        ):
            reason = check(quality)
            if reason is not None:
                return reason
        return None

    def slow_or_short(self, quality: QualityFigures, duration: float | None = None) -> Fact:
        """Returns the reason why a log has no segment that is long enough: slow streams or, otherwise, a short flight.

        Args:
            quality: quality of the log.
            duration: Duration, s, of its longest segment, if it has one.
        """
        too_slow = self._too_slow_for_model(quality)
        if too_slow is not None:
            return too_slow
        is_logged_on_board = self.signals.telemetry.translated_from in LOGGERS
        return Fact(
            NotLearnableReason.TOO_SHORT,
            duration=duration,
            least_duration=MIN_SEGMENT_DURATION,
            airborne=quality.airborne,
            recorder="logger" if is_logged_on_board else "link",
        )

    def _too_slow_for_model(self, quality: QualityFigures) -> Fact | None:
        """Checks that attitude and model inputs come at the rate that the model to be learned needs.

        Args:
            quality: quality of the segment, with the rates of both streams.

        Returns:
            The reason to refuse the segment; None if both are fast enough.
        """
        return self._too_slow(quality, self.min_rate)

    def _too_slow(self, quality: QualityFigures, min_rate: float) -> Fact | None:
        """Checks that attitude and model inputs come at some least rate.

        Args:
            quality: quality of the segment, with the rates of both streams, Hz; a missing rate counts as 0.
            min_rate: rate that each stream needs, Hz.

        Returns:
            The reason to refuse the segment, with a remedy that raises the rates; None if both are fast enough.
        """
        telemetry = self.signals.telemetry
        attitude_rate = quality.attitude_rate or 0.0
        rates = {
            telemetry.name_in_source(self.attitude.message): attitude_rate,
            telemetry.name_in_source(self.inputs.message): quality.motor_rate or 0.0,
        }
        reason = slow_streams(rates, self.signals.axis, min_rate)
        if reason is None:
            return None
        return reason.replace(remedy=self._remedy_for_slow_streams(attitude_rate))

    def _remedy_for_slow_streams(self, attitude_rate: float) -> Fact:
        """Returns the advice what to change if attitude or model inputs come too slowly.

        If only the motor outputs are slow and the controller's demand is fast, a model can use the demand as its input.
        Otherwise the rates of the streams must be raised.

        Args:
            attitude_rate: Rate of the attitude, Hz.
        """
        signals = self.signals
        is_attitude_fast = attitude_rate >= MIN_STREAM_RATE
        if signals.inputs == "motors" and is_attitude_fast and signals.demand is not None:
            demand_rate = rate_between_outages(signals.demand)
            if demand_rate >= MIN_STREAM_RATE:
                return Fact(Remedy.LEAVE_OUT_MOTORS, axis=signals.axis, rate=demand_rate)
        return rate_advice(signals.telemetry, components=self.components)

    def _repeated_values(self, quality: QualityFigures) -> Fact | None:
        """Checks that new values of attitude and model inputs come at the rate that a model needs.

        Some autopilots and radios send the last value again under a new stamp, so that the rate of messages is higher
        than the rate of the measurements.

        Args:
            quality: quality of the segment: rates of messages (``attitude_rate``, ``motor_rate``) and of new values
                (``attitude_fresh``, ``motor_fresh``), Hz; a missing rate counts as 0.

        Returns:
            The reason to refuse the segment, of the attitude before the inputs; None if new values come fast enough.
        """
        telemetry = self.signals.telemetry
        attitude_fresh_rate = quality.attitude_fresh or 0.0
        motor_fresh_rate = quality.motor_fresh or 0.0
        if attitude_fresh_rate < self.min_rate:
            message = self.attitude.message
            rate = quality.attitude_rate
            fresh_rate = attitude_fresh_rate
        elif motor_fresh_rate < self.min_rate:
            message = self.inputs.message
            rate = quality.motor_rate
            fresh_rate = motor_fresh_rate
        else:
            return None
        return Fact(
            NotLearnableReason.VALUES_REPEATED,
            name=telemetry.name_in_source(message),
            rate=rate,
            fresh_rate=fresh_rate,
            least_rate=self.min_rate,
            axis=self.signals.axis,
            remedy=rate_advice(telemetry),
        )

    def _constant_or_rounded_outputs(self, quality: QualityFigures) -> Fact | None:
        """Checks that the outputs of the model, angle and body rate, change by more than they were rounded.

        The model of yaw has the rate only, so its angle may be constant; the angles of roll and pitch may not.

        Args:
            quality: quality of the segment: standard deviations of angle and rate, the steps to which they were rounded
                (rad, rad/s), and the ratio of signal to rounding noise (``output_snr``), None if it was not measured.

        Returns:
            The reason to refuse the segment; None if the outputs can be used.
        """
        axis = self.signals.axis
        is_angle_constant = axis in TILT_AXES and not quality.angle_sd
        if not quality.rate_sd or is_angle_constant:
            return Fact(NotLearnableReason.OUTPUT_CONSTANT, axis=axis)
        if quality.output_snr is not None and quality.output_snr < MIN_SNR:
            return Fact(
                NotLearnableReason.OUTPUT_ROUNDED,
                axis=axis,
                # The ratio compares changes over this time, s.
                span=RATE_INTEGRATION_SPAN,
                angle_step=quality.angle_step,
                rate_step=quality.rate_step,
            )
        return None

    def _inconsistent_rates(self, quality: QualityFigures) -> Fact | None:
        """Checks that the body rates agree with the angles; otherwise one of the two is wrong.

        Rates and angles of a vehicle that moves are known to disagree in a log that is too slow for a full model, since
        the motion between two messages is lost. Then the rates of the messages are the reason.

        Args:
            quality: quality of the segment, with the ``consistency``: how well the integral of the rate explains the
                changes of the angle, 1 if fully; None if it was not measured.

        Returns:
            The reason to refuse the segment; None if they agree or that was not measured.
        """
        if quality.consistency is None or quality.consistency >= MIN_CONSISTENCY:
            return None
        axis = self.signals.axis
        is_still = quality.rate_sd is not None and quality.rate_sd < MAX_STILL_RATE
        if axis in TILT_AXES and not is_still:
            slow_streams_reason = self._too_slow(quality, MIN_STREAM_RATE)
            if slow_streams_reason is not None:
                return slow_streams_reason
        return Fact(
            NotLearnableReason.RATE_CONTRADICTS_ANGLE,
            axis=axis,
            consistency=quality.consistency,
            span=RATE_INTEGRATION_SPAN,
            still=axis in TILT_AXES and is_still,
            remedy=rate_advice(self.signals.telemetry, rate=ADVISED_RATE),
        )

    def _rounded_command(self, quality: QualityFigures) -> Fact | None:
        """Checks that the torque command in the model inputs changes by more than it was rounded.

        Args:
            quality: quality of the segment: standard deviation and resolution of the torque command, in the unit of the
                inputs, and the ratio of signal to rounding noise (``input_snr``), None if it was not measured.

        Returns:
            The reason to refuse the segment; None if the command can be used.
        """
        if quality.input_snr is not None and quality.input_snr < MIN_SNR:
            return Fact(
                NotLearnableReason.COMMAND_ROUNDED,
                axis=self.signals.axis,
                command=quality.input_sd,
                command_step=quality.input_step,
                unit=self.inputs.scale.unit,
            )
        return None


def first_learnable(judge: SegmentJudge, segments: Sequence[Segment]) -> Learnability:
    """Judges several segments in turn, until a model can be learned from one of them.

    Args:
        judge: judges for one segment whether a model can be learned from it, and if not, why.
        segments: at least one segment, the preferred first.

    Returns:
        The learnability of that segment or, if a model can be learned from none, of the first segment.
    """
    learnability_of_first: Learnability | None = None
    for segment in segments:
        learnability = judge.learnability(segment)
        if learnability.learnable:
            return learnability
        if learnability_of_first is None:
            learnability_of_first = learnability
    # There is at least one segment, so that there is a first.
    assert learnability_of_first is not None
    return learnability_of_first


def impossible_attitude(signals: Signals, code: NotLearnableReason | Caution) -> Fact:
    """Returns a fact about attitude messages with an angle or body rate that no vehicle can have.

    Args:
        signals: signals of the vehicle, with an attitude.
        code: whether this is a reason against a model, because they are many, or only a caution.

    Returns:
        A fact with the number of such messages (``count``), the number of all messages (``sent``), the ``name`` of the
        message, and the largest possible ``body_rate``, rad/s.
    """
    attitude = signals.attitude
    assert attitude is not None
    return Fact(
        code,
        count=attitude.impossible_count,
        sent=attitude.sent_count,
        name=signals.telemetry.name_in_source(attitude.message),
        body_rate=MAX_BODY_RATE,
    )
