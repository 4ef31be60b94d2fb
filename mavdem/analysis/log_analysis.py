"""LogAnalysis: what a log says of one vehicle and axis: its verdict, the model, how good that is, and the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from os import PathLike
from typing import Any, Protocol

from mavdem import evaluate
from mavdem.alignment.drive import AXES
from mavdem.alignment.read import choose_vehicle, judged_segments
from mavdem.alignment.signals import SLOW_MOTION_RATE, Signals
from mavdem.alignment.verdict import Verdict
from mavdem.analysis.motor_alarms import motor_alarms
from mavdem.analysis.slow_motion import CAUTION as SLOW_MOTION
from mavdem.analysis.slow_motion import objection
from mavdem.analysis.training_data import TooFewSamples, cut, flown_after, judged, of_one_boot
from mavdem.condition import Condition, Identity, condition_of, identity_of
from mavdem.condition.inventory import Tier, tier_of
from mavdem.dem import Learned, Settings, learn
from mavdem.errors import NotLearnable
from mavdem.evaluate.findings import Finding, findings, limited_by
from mavdem.evaluate.flight_windows import Length
from mavdem.evaluate.held_out import HeldOut, held_out_test
from mavdem.evaluate.truth import TruthComparison, compare_with_truth, truth_of
from mavdem.evaluate.vehicle_figures import ALL, AxisFigures, VehicleFigures, vehicle_of_log
from mavdem.flight import Flight
from mavdem.health.motor_watch import MotorAlarm, alarm_figures
from mavdem.ingest import Log


class StepProgress(Protocol):
    """Shows a step of the work by its ``title``; what it yields is called with the share done, if that is measured."""

    def __call__(self, title: str, measured: bool = True) -> AbstractContextManager[Callable[[float], None]]:
        """Shows the step while the work is done."""


def silent(title: str, measured: bool = True) -> AbstractContextManager[Callable[[float], None]]:
    """Shows nothing."""
    return nullcontext(lambda share: None)


@dataclass(frozen=True, eq=False)
class LogAnalysis:
    """One vehicle and axis of a log.

    Attributes:
        verdict: whether a full model of the axis can be learnt, on which segment, and its figures.
        tier: what the log allows, why no more, and what the next tier needs.
        condition: balance, limits, lean, vibration and battery, at any rate.
        identity: which vehicle, and when.
        vehicle: how hard each motor works; of ``axis="all"`` also the physical parameters of each axis.
        reason, remedy: why there is no full model, and what to change; empty where there is one.
        flights: what was learnt from; empty without a model.
        learned: the model: in tier "b" of the slow motion, and without physical parameters; None where there is none.
        held_out: forecasts of windows that no model saw; None without a model.
        findings: what the model is good for, purpose by purpose.
        truth: the estimates beside the truth of a simulated flight, where its file was given.
        alarms: lasting changes of the motors' balance in flight, as a live session would have found them; those
            without a motor are no alarms.
    """

    verdict: Verdict
    tier: Tier
    condition: Condition
    identity: Identity
    vehicle: VehicleFigures
    reason: str = ""
    remedy: str = ""
    flights: tuple[Flight, ...] = ()
    learned: Learned | None = None
    held_out: HeldOut | None = None
    findings: tuple[Finding, ...] = ()
    truth: TruthComparison | None = None
    alarms: tuple[MotorAlarm, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """All figures as plain JSON values; angles in rad, rates in rad/s, time in s."""
        learned, held_out = self.learned, self.held_out
        model = {} if learned is None or held_out is None else evaluate.report(self.flights, learned, held_out)
        return {
            **model,
            **self.vehicle.as_dict(),
            **self.tier.as_dict(),
            "reason": self.reason,
            "remedy": self.remedy,
            "condition": self.condition.as_dict(),
            "identity": self.identity.as_dict(),
            **alarm_figures(self.alarms),
            "findings": [finding._asdict() for finding in self.findings],
            "truth": None if self.truth is None else self.truth.as_dict(),
            "settings": None if learned is None else asdict(learned.settings),
            "verdict": self.verdict.as_dict(),
        }


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
    only if it predicts better than no model (``mavdem.analysis.slow_motion``).

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
    cautions = (*([SLOW_MOTION] if slow else []), *flights[0].provenance["cautions"], *learned.cautions)
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
