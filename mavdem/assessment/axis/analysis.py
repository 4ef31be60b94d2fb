"""Analysis: from a log to all that it says of one vehicle and axis.

Learnability and tier say what the log allows. The model is trained on the settled flight, judged by windows that no
model saw, and graded by findings; a model of the slow motion is kept only where it predicts better than none.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace

import numpy as np

from mavdem.assessment.axis.figures import ALL, LogAnalysis, axis_figures, physical_of
from mavdem.assessment.axis.findings import disown_torque
from mavdem.assessment.condition import condition_of
from mavdem.assessment.inventory import identity_of, tier_of
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.flights import flights_of_longest_boot, usable_segments
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.learnability import Learnability
from mavdem.dataset.phases import settled_intervals
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals, rate_between_outages
from mavdem.dataset.steady_flight import tracked_headings
from mavdem.dem import Learned, Settings, learn
from mavdem.dem.learning import MIN_SAMPLES, prepared_training
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.experiments.held_out import (
    BASELINES,
    FOLDS,
    HeldOut,
    Progress,
    held_out_test,
    held_out_windows,
)
from mavdem.experiments.paired_test import SIGNIFICANCE, paired
from mavdem.experiments.truth import compare_with_truth, truth_of
from mavdem.experiments.window import Length, TooFewSamples, no_test_window, part_samples, too_short
from mavdem.facts import Fact
from mavdem.facts.assessment import Caveat, NoModel
from mavdem.facts.forecasts import Forecasts, TestResult
from mavdem.files import PathName
from mavdem.flight import Flight, Flights
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest import Log
from mavdem.motors.loss_detection import MIN_RATE, MotorAlarm, MotorWatch
from mavdem.motors.trim_pattern import trim_of_signals
from mavdem.plant.wind_torque import estimate_wind_torque

# of squared errors, to a forecast's without a model, up to which one of slow motion is worth it
MAX_SLOW_RATIO = 0.9

StepProgress = Callable[..., AbstractContextManager[Progress]]
"""Shows a step of the work by its ``title``; what it yields is called with the share done, if it is ``measured``."""


def silent(title: str, measured: bool = True) -> AbstractContextManager[Progress]:
    """Shows nothing of a step."""
    return nullcontext(lambda share: None)


@dataclass(frozen=True)
class Options:
    """What of a log is analysed, and how a model is learned.

    Attributes:
        inputs: as for :func:`mavdem.read_flight`.
        settings: of the fits.
        start: seconds of settled flight that are left out at its beginning.
        train, test: lengths of the training data and of a test window; without ``train`` all is trained on.
        truth: the truth file of a simulated flight.
        whole: with the model; without, only that of slow motion is learned, where whether there is one decides.
    """

    inputs: str | None = None
    settings: Settings = field(default_factory=Settings)
    start: float = 0.0
    train: Length | None = None
    test: Length | None = None
    truth: PathName | None = None
    whole: bool = True


def analyse(
    log: Log,
    signals: Signals,
    axis: str = "roll",
    options: Options | None = None,
    *,
    progress: StepProgress = silent,
    other_axis: LogAnalysis | None = None,
) -> LogAnalysis:
    """Returns all that a log says of one vehicle and axis.

    The model is trained on the whole settled flight of the longest segment's boot and judged by held-out windows. With
    ``options.train`` it is trained on so much of the longest segment, and tested once on what follows.

    Args:
        log: of ``mavdem.ingest.read_log``.
        signals: of the vehicle; their axis and inputs do not matter.
        axis: "roll" or "pitch"; "all" for a model of roll, and the physical parameters of roll, pitch and yaw.
        options: what is analysed, and how; ``Options()`` unless given.
        progress: shows the steps of the work.
        other_axis: the analysis of another axis of the vehicle: what that says of the vehicle, and perhaps of the
            physical parameters of this axis, is not made again.

    Raises:
        NotLearnable: the ``start``, ``train`` or ``test`` that was asked for does not fit.
        Unreadable: ``truth`` is not the truth of this flight.
        ValueError: an axis or inputs that are none.
    """
    options = options or Options()
    inputs = options.inputs
    signals = signals.for_axis(AXES[0] if axis == ALL else axis, inputs)
    segments, learnability = usable_segments(signals, log.components)
    analysis = _without_model(log, signals, learnability, other_axis)
    slow = analysis.tier.tier == "b" and signals.axis in TILT_AXES
    if slow:
        segments, of_slow = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
        if not segments:
            return _refused(analysis, of_slow.reason)
    if not segments or not (options.whole or slow):
        return analysis
    try:
        flights, learned, held_out = _model(segments, options, progress, slow)
    except NotLearnable as error:
        if isinstance(error, TooFewSamples) and (options.start or options.train or options.test):
            raise
        return _refused(analysis, error.fact) if slow else replace(analysis, reason=error.fact)
    caution = [Fact(Caveat.SLOW_MOTION_ONLY)] if slow else []
    cautions = *caution, *flights[0].cautions, *learned.cautions
    learned = replace(learned, cautions=cautions)  # before anything is fitted that it keeps
    figures = None if other_axis is None else other_axis.axes.get(axis)
    if figures and figures.physical and tuple(map(len, figures.flights)) == learned.record.lengths:
        learned = learned.with_physical(figures.physical).with_wind_torque(figures.wind)
    else:
        if not slow:
            learned = learned.with_physical(physical_of(signals, flights))
        if analysis.changes and learned.physical is not None and learned.wind_torque is not None:
            torque = estimate_wind_torque(learned.physical, learned.record, analysis.changes)
            learned = learned.with_wind_torque(torque)
    learned = disown_torque(learned, analysis.condition.oscillation is not None)
    analysis = replace(analysis, flights=flights, learned=learned, held_out=held_out)
    if options.truth is not None:
        truth = truth_of(flights, options.truth)
        analysis = replace(analysis, truth=compare_with_truth(learned, flights, truth))
    if axis == ALL:
        axes = {**analysis.axis_figures}
        with progress("Estimating the physical parameters") as done:
            for other in AXES[1:]:
                about = signals.for_axis(other, inputs)
                axes[other] = axis_figures(about, log.components, analysis.changes)
                done(len(axes) / len(AXES))
        analysis = replace(analysis, axes=ReadOnlyDict(axes))
    return analysis


def _without_model(
    log: Log, signals: Signals, learnability: Learnability, other_axis: LogAnalysis | None
) -> LogAnalysis:
    """What a log says of a vehicle without a model of an axis, and why it allows none."""
    condition = condition_of(signals) if other_axis is None else other_axis.condition
    tier = tier_of(learnability, condition)
    reason = None if tier.tier == "a" else tier.tier_reason
    measured = learnability.figures
    if tier.tier is None and measured.airborne and not measured.segments:
        reason = Fact(NoModel.NO_SETTLED_FLIGHT, duration=measured.airborne)
    if other_axis is not None:
        return LogAnalysis(
            learnability,
            tier,
            condition,
            other_axis.identity,
            reason,
            alarms=other_axis.alarms,
            trim=other_axis.trim,
            watched=other_axis.watched,
        )
    motors = signals.motors
    return LogAnalysis(
        learnability,
        tier,
        condition,
        identity_of(signals, log.receive_time[0]),
        reason,
        alarms=motor_alarms(signals),
        trim=trim_of_signals(signals),
        watched=motors is not None
        and bool(motors.geometry.positions)
        and rate_between_outages(motors) >= MIN_RATE,
    )


def _refused(analysis: LogAnalysis, refusal: Fact) -> LogAnalysis:
    """Why there is no model of the slow motion either, after why there is no full one."""
    if analysis.reason is None or refusal == analysis.reason:
        return analysis
    reason = Fact(NoModel.SLOW_MODEL_REFUSED, because=analysis.reason, refusal=refusal)
    return replace(analysis, reason=reason)


def motor_alarms(signals: Signals) -> tuple[MotorAlarm, ...]:
    """Returns what a live session would have said of the motors of ``signals``, boot by boot.

    Live, the end of the climb-out is known half a second late and a landing when it has happened, so that times differ
    by as much. Logs with fewer than 6 samples of the motors a second show nothing.
    """
    motors = signals.motors
    if motors is None:
        return ()
    alarms = []
    for boot in np.unique(motors.boot).tolist():
        watch = MotorWatch(motors.geometry, boot)
        shares = motors.range_fractions(boot)
        heading = tracked_headings(signals, boot, shares.time)
        flown = in_intervals(shares.time, settled_intervals(signals, boot))
        columns = shares.time[flown].tolist(), shares.values[flown], heading[flown].tolist()
        for sample in zip(*columns, strict=True):
            watch.take(*sample)
        alarms += watch.alarms
    return tuple(alarms)


def _model(
    segments: Flights, options: Options, progress: StepProgress, slow: bool
) -> tuple[Flights, Learned, HeldOut]:
    """What was trained on, the model, and forecasts of windows that no model saw.

    A model of ``slow`` motion is refused by these before it is learned.
    """
    settings = options.settings
    if options.train is not None:
        training, following = cut(
            max(segments, key=len), options.start, options.train, options.test
        )
        with _learning(progress):
            learned = learn(training, settings)
        return (training,), learned, held_out_test(training, following, learned)
    flights = flown_after(segments, options.start)
    with _learning(progress):
        first = prepared_training(flights, settings) if slow else learn(flights, settings)
    _, steps = part_samples(flights[0].dt, None, options.test)
    try:
        with progress("Judging by held-out windows") as done:
            held_out = held_out_windows(flights, settings, steps, done)
    except ValueError as error:
        raise no_test_window(sum(map(len, flights)), flights[0].dt, steps, FOLDS) from error
    if slow and (refusal := slow_motion_refusal(held_out)):
        raise NotLearnable(refusal)
    return flights, first if isinstance(first, Learned) else learn(flights, settings), held_out


@contextmanager
def _learning(progress: StepProgress) -> Iterator[None]:
    """Shows that a model is learned; raises ``NotLearnable`` where it cannot be."""
    try:
        with progress("Learning", measured=False):
            yield
    except ValueError as error:
        raise NotLearnable(NoModel.NOT_LEARNED, because=fact_from_error(error)) from error


def slow_motion_refusal(held_out: HeldOut) -> Fact | None:
    """Returns why a model does not beat each baseline in ``held_out`` windows by a margin, beyond chance; or None."""
    for name in BASELINES:
        ratio = held_out.error_ratio() / held_out.error_ratio(name)
        test = paired(held_out.error_ratios(name), np.ones(len(held_out)))
        is_weak = not ratio <= MAX_SLOW_RATIO
        if is_weak or test.result != TestResult.LOWER:
            return Fact(
                NoModel.SLOW_MODEL_TOO_WEAK,
                name=name,
                windows=len(held_out),
                ratio=ratio,
                p_value=None if is_weak else test.p_value,
                limit=MAX_SLOW_RATIO if is_weak else SIGNIFICANCE,
            )
    return None


def flown_after(segments: Flights, start: float) -> Flights:
    """Returns what is flown ``start`` s after the first sample and later; raises ``TooFewSamples`` of too little.

    Of the longest segment's boot: times of another cannot be compared.
    """
    flights = flights_of_longest_boot(segments)
    begin = flights[0].time[0] + start
    skips = [
        (flight, int(np.searchsorted(flight.time, begin - flight.dt / 2))) for flight in flights
    ]
    left = tuple(
        flight[skip:] if skip else flight
        for flight, skip in skips
        if len(flight) - skip >= MIN_SAMPLES
    )
    if not left:
        raise TooFewSamples(Forecasts.NOTHING_LEFT, samples=MIN_SAMPLES, start=start)
    return left


def cut(flight: Flight, start: float, train: Length, test: Length | None) -> tuple[Flight, Flight]:
    """Returns ``train`` of the ``flight`` from ``start`` s on and the ``test`` after it; raises ``TooFewSamples``."""
    first = round(min(start / flight.dt, len(flight)))
    length, ahead = part_samples(flight.dt, train, test)
    end = first + length
    if len(flight) < end + ahead:
        raise too_short(flight, start, length, ahead, MIN_SAMPLES)
    return flight[first:end], flight[end : end + ahead]
