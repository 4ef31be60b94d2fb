"""LogAnalysis: what a log says of one vehicle and axis: its verdict, the model, how good that is, and the vehicle.

Training data: which part of the settled flight a model is learnt from, and which part it is tested on.

Slow motion: whether a model of it, at 8 to 40 Hz, predicts better than no model.

Motor alarms of a recorded flight: the test that watches motors while a vehicle flies, over its log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from os import PathLike
from typing import Protocol

import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.alignment.phases import settled
from mavdem.alignment.read import choose_vehicle, judged_segments
from mavdem.alignment.signals import SLOW_MOTION_RATE, Signals
from mavdem.analysis.figures import ALL, AxisFigures, LogAnalysis, vehicle_of_log
from mavdem.analysis.findings import Finding, findings, limited_by
from mavdem.condition import condition_of, identity_of
from mavdem.condition.inventory import tier_of
from mavdem.dem import Learned, Settings, learn
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.evaluate.held_out import BASELINES, FOLDS, HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.paired_test import SIGNIFICANCE, paired
from mavdem.evaluate.truth import compare_with_truth, truth_of
from mavdem.evaluate.windows import TEST_SECONDS, Length, fewer_samples, samples_in
from mavdem.flight import Flight
from mavdem.health.motor_watch import MotorAlarm, MotorWatch
from mavdem.ingest import Log


class TooFewSamples(NotLearnable):
    """The settled flight is too short for the windows that were asked for.

    Attributes:
        lengths: options of ``mavdem learn`` with windows that fit, ("--test", "40"); empty where none do.
    """

    def __init__(self, reason: str, remedy: str = "", lengths: tuple[str, ...] = ()) -> None:
        super().__init__(reason, remedy or f"Ask for shorter ones: `{' '.join(lengths)}`.")
        self.lengths = lengths


def of_one_boot(segments: Sequence[Flight]) -> tuple[Flight, ...]:
    """Those of the longest segment's boot: times of another cannot be compared."""
    boot = max(segments, key=len).provenance["segment"]["boot"]
    return tuple(flight for flight in segments if flight.provenance["segment"]["boot"] == boot)


def flown_after(flights: Sequence[Flight], start: float) -> tuple[Flight, ...]:
    """What is flown ``start`` seconds after the first sample and later; raises TooFewSamples where little is left."""
    late = [
        (flight, round(np.clip(flights[0].time[0] + start - flight.time[0], 0, len(flight) * flight.dt) / flight.dt))
        for flight in flights
    ]
    left = tuple(flight[first:] for flight, first in late if len(flight) - first >= FEWEST_SAMPLES)
    if not left:
        raise TooFewSamples(
            f"Less than {FEWEST_SAMPLES} samples of settled flight are left after {start:g} s.",
            "Start earlier, with a smaller --start.",
        )
    return left


def judged(
    flights: Sequence[Flight], settings: Settings, test: Length | None, done: Callable[[float], None]
) -> HeldOut:
    """Held-out windows of ``test``, of 1.5 s unless given; ``done`` is called with the share of the work that is done.

    Raises TooFewSamples: no window fits into a part of the flights.
    """
    dt = flights[0].dt
    steps = test.samples(dt) if test else samples_in(TEST_SECONDS, dt)
    try:
        return held_out_windows(flights, settings, steps, done)
    except ValueError as error:
        samples = sum(map(len, flights))
        fewer = max(1, samples // (FOLDS + 1))
        shorter = fewer < steps and samples >= 2 * samples_in(TEST_SECONDS, dt)
        raise TooFewSamples(
            f"The settled flight has {samples} samples ({samples * dt:.1f} s), too few for test windows of {steps}.",
            "" if shorter else "Fly longer, or give a smaller --start.",
            ("--test", str(fewer)) if shorter else (),
        ) from error


def cut(flight: Flight, start: float, train: Length, test: Length | None) -> tuple[Flight, Flight]:
    """The training data from ``start`` on, and the test after it; raises TooFewSamples where they do not fit."""
    first = round(min(start / flight.dt, len(flight)))
    left = len(flight) - first
    length = train.samples(flight.dt)
    ahead = test.samples(flight.dt) if test else samples_in(TEST_SECONDS, flight.dt)
    if left >= length + ahead:
        end = first + length
        return flight[first:end], flight[end : end + ahead]
    fewer_train, fewer_test = fewer_samples(left, length, ahead)
    fits = fewer_train >= FEWEST_SAMPLES
    raise TooFewSamples(
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), {left} of them from {start:g} s on, "
        f"but {length} training and {ahead} test samples were asked for.",
        "" if fits else "Start earlier, with a smaller --start.",
        ("--train", str(fewer_train), "--test", str(fewer_test)) if fits else (),
    )


MOST_OF_BASELINE = 0.9
"""Squared error over that of a forecast without a model, up to which a model is worth having: an RMSE 5 % lower."""
CAUTION = "The model is of the slow motion only: what shows at several Hz, such as the motors' effect, is not in it."


def objection(held_out: HeldOut) -> str:
    """Why a model is none of the slow motion: a baseline that it does not beat beyond chance; empty if it beats all."""
    for name in BASELINES:
        ratio = held_out.error_ratio() / held_out.error_ratio(name)
        test = paired(held_out.error_ratios(baseline=name), np.ones(len(held_out)))
        of = (
            f"A model of the slow motion has {ratio:.2g} times the squared error of “{name}” in {len(held_out)} windows"
        )
        if not ratio <= MOST_OF_BASELINE:
            return f"{of} that it has not seen: at most {MOST_OF_BASELINE:g} times would make it worth having."
        if test.verdict != "lower":
            return f"{of} that it has not seen, which may be luck (p = {test.p_value:.2g}, needed {SIGNIFICANCE:g})."
    return ""


def motor_alarms(signals: Signals) -> tuple[MotorAlarm, ...]:
    """What a live session would have said of a vehicle's motors, boot by boot.

    Live, the end of the climb-out is known half a second late and a landing when it has happened, so that times differ
    by as much. Logs with fewer than 6 samples of the motors a second show nothing.
    """
    motors = signals.motors
    if motors is None:
        return ()
    layout, found = motors.layout, list[MotorAlarm]()
    for boot in np.unique(motors.boot):
        place = layout.names, layout.motors, layout.positions, layout.spins
        watch = MotorWatch(*place, layout.positions_assumed, int(boot))
        rows = motors.boot == boot
        time, commands = motors.time[rows], motors.scale.fraction(motors.outputs[rows])
        flying = np.zeros(len(time), dtype=bool)
        for begin, end in settled(signals, int(boot)):
            flying |= (time >= begin) & (time <= end)
        for at in np.flatnonzero(flying):
            watch.take(float(time[at]), commands[at], True)
        found += watch.alarms
    return tuple(found)


class StepProgress(Protocol):
    """Shows a step of the work by its ``title``; what it yields is called with the share done, if that is measured."""

    def __call__(self, title: str, measured: bool = True) -> AbstractContextManager[Callable[[float], None]]:
        """Shows the step while the work is done."""


def silent(title: str, measured: bool = True) -> AbstractContextManager[Callable[[float], None]]:
    """Shows nothing."""
    return nullcontext(lambda share: None)


def analyse(
    log: Log,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
    settings: Settings | None = None,
    *,
    start: float = 0.0,
    train: Length | None = None,
    test: Length | None = None,
    truth: str | PathLike[str] | None = None,
    progress: StepProgress = silent,
) -> LogAnalysis:
    """All that a log says of one vehicle and axis.

    The model is learnt from the whole settled flight of the longest segment's boot and judged by held-out windows. With
    ``train`` it is learnt from so much of the longest segment, and tested once on what follows. In tier "b" it is kept
    only if it predicts better than no model (``mavdem.analysis.analysis``).

    Args:
        log: of ``mavdem.ingest.read_log``.
        axis: "roll" or "pitch"; "all" for a model of roll, and the physical parameters of roll, pitch and yaw.
        vehicle, inputs: as for :func:`mavdem.read_flight`.
        settings: of the fits; ``Settings()`` unless given.
        start: seconds of settled flight that are left out at its beginning.
        train, test: lengths of the training data and of a test window.
        truth: the truth file of a simulated flight.
        progress: shows the steps of the work.

    Raises:
        NotLearnable: no such vehicle, or the ``start``, ``train`` or ``test`` that was asked for does not fit.
        Unreadable: ``truth`` is not the truth of this flight.
        ValueError: an axis or inputs that are none.
    """
    signals = Signals(choose_vehicle(log.vehicles, vehicle), AXES[0] if axis == ALL else axis, inputs)
    segments, verdict = judged_segments(signals, log.components)
    condition, identity = condition_of(signals), identity_of(signals, log.receive_time[0])
    tier, figures = tier_of(verdict, condition), vehicle_of_log(log, (), vehicle, inputs)
    found = LogAnalysis(verdict, tier, condition, identity, figures, tier.reason, tier.remedy)
    found = replace(found, alarms=motor_alarms(signals))
    slow = tier.name == "b"
    if slow:
        segments, of_slow = judged_segments(signals, log.components, SLOW_MOTION_RATE)
        if not segments:
            return replace(found, reason=_joined(tier.reason, of_slow.reason))
    if not segments:
        return found
    try:
        flights, learned, held_out = _model(segments, settings or Settings(), start, train, test, progress)
    except NotLearnable as error:
        if isinstance(error, TooFewSamples) and (start or train or test):
            raise
        if slow:
            return replace(found, reason=_joined(tier.reason, error.reason))
        return replace(found, reason=error.reason, remedy=error.remedy)
    if slow and (refused := objection(held_out)):
        return replace(found, reason=_joined(tier.reason, refused))
    known = None if truth is None else truth_of(flights, truth)
    cautions = (*([CAUTION] if slow else []), *flights[0].provenance["cautions"], *learned.cautions)
    learned = replace(learned, cautions=cautions)
    if axis == ALL:
        with progress("Estimating the physical parameters") as done:
            others = vehicle_of_log(log, AXES[1:], vehicle, inputs, done)
        own = AxisFigures(flights, learned.physical, learned.wind, learned.physical_reason)
        figures = others._replace(axes={AXES[0]: own, **others.axes})
    return replace(
        found,
        vehicle=figures,
        reason=tier.reason if slow else "",
        flights=flights,
        learned=learned,
        held_out=held_out,
        findings=_findings(flights, learned, held_out, found.alarms),
        truth=None if known is None else compare_with_truth(learned, flights, known),
    )


def _findings(
    flights: Sequence[Flight], learned: Learned, held_out: HeldOut, alarms: Sequence[MotorAlarm]
) -> tuple[Finding, ...]:
    """What the model is good for: less, where a motor changed in what it was learnt from."""
    found = findings(learned, held_out)
    for alarm in alarms:
        if alarm.motor is not None and flights[0].time[0] < alarm.since < flights[-1].time[-1]:
            name = alarm.name.capitalize()
            reason = f"{name} changed at {alarm.since:.0f} s; this takes the flight before and after together."
            return limited_by(found, reason)
    return found


def _model(
    segments: tuple[Flight, ...],
    settings: Settings,
    start: float,
    train: Length | None,
    test: Length | None,
    progress: StepProgress,
) -> tuple[tuple[Flight, ...], Learned, HeldOut]:
    """What was learnt from, the model, and forecasts of windows that no model saw."""
    if train is not None:
        training, following = cut(max(segments, key=len), start, train, test)
        learned = _learn((training,), settings, progress)
        return (training,), learned, held_out_test(training, following, learned)
    flights = flown_after(of_one_boot(segments), start)
    with progress("Judging by held-out windows") as done:
        held_out = judged(flights, settings, test, done)
    return flights, _learn(flights, settings, progress), held_out


def _learn(flights: tuple[Flight, ...], settings: Settings, progress: StepProgress) -> Learned:
    try:
        with progress("Learning", measured=False):
            return learn(flights, settings)
    except ValueError as error:
        raise NotLearnable(
            f"No model could be learnt: {error}.",
            "Choose another part of the flight with --start, or a longer --train.",
        ) from error


def _joined(first: str, second: str) -> str:
    return first if second == first else f"{first} {second}"
