"""Assessing a log: facts (coded findings) on events, models, loops and status lights, each from the ones before."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.assessment.axis import LogAnalysis, Options, analyse
from mavdem.assessment.axis.analysis import analyse_without_model
from mavdem.assessment.axis.figures import ALL_AXES, AxisEstimates
from mavdem.assessment.axis.loops import AxisResults, loops_of_axes, results_of_axis
from mavdem.assessment.axis.options import ShowStep, show_nothing
from mavdem.assessment.ending import find_ending, lower_unconfirmed_crash_reports
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flight_verdict import worst_first
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.judgement import judge, lights_without_loops, unjudged
from mavdem.assessment.lights.power import (
    mark_battery_reports_on_ground,
    with_low_supply,
    with_supply_as_suspect,
)
from mavdem.assessment.motion import motion_events
from mavdem.assessment.motor_failure import (
    raise_level_of_assumed_landings,
    with_evidence_of_cause,
)
from mavdem.assessment.motor_witnesses import with_sensor_evidence
from mavdem.assessment.record import Assessment
from mavdem.assessment.repeated_reports import in_time_order
from mavdem.assessment.reported import reported_events
from mavdem.assessment.saturated_motor import (
    saturation_losses,
    with_motors_limited_before,
    with_saturated_motor,
)
from mavdem.assessment.separate_flights import RecordedFlight, separate_flights
from mavdem.assessment.vehicle_verdict import RecordedVehicle, VehicleVerdict
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import choose_vehicle, matching_vehicles, names_of_vehicles
from mavdem.dataset.signals import Signals
from mavdem.dem.parallel import in_second_process
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.lights import Light
from mavdem.files import AnyPath
from mavdem.immutable import ReadOnlyDict, freeze
from mavdem.ingest import Log, read_log
from mavdem.ingest.telemetry import Telemetry
from mavdem.loops.axis_loops import Loop
from mavdem.motors.motor_changes import MotorChange, thrust_losses
from mavdem.wind_velocity.from_log import WindEvidence, wind_evidence


class FirstFindings(NamedTuple):
    """What is known of a flight before its models and control loops, which take most of the time."""

    evidence: Evidence
    """What happened, and all that was measured, without the loops."""
    analysis: LogAnalysis
    """What the log allows, and which vehicle it is, without a model."""
    lights: NamedFacts
    """The lights that need no loop, by name."""


ShowFindings = Callable[[FirstFindings], None]
"""Shows what is known before models and loops."""


def ignore_findings(findings: FirstFindings) -> None:
    """Shows nothing of the first findings: the default of :func:`assess`."""


def review(path: AnyPath, vehicle: str | None = None) -> Assessment:
    """Returns the assessment of a log: what happened, the state of its vehicle, and what its data are good for.

    >>> a = mavdem.review("flight.tlog")
    >>> [*a.lights][:4], [*a.loops], a.model is not None
    (['motors', 'vibration', 'tracking', 'margins'], ['roll', 'pitch', 'yaw'], True)

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component"; None for the only vehicle, or for the worst of several.

    Returns:
        The assessment.

    Raises:
        Unreadable: the log cannot be read.
        ValueError: ``path`` is not a path.
    """
    return assess(read_log(path), vehicle)


def assess(
    log: Log,
    vehicle: str | None = None,
    axis: str = ALL_AXES,
    options: Options | None = None,
    *,
    progress: ShowStep = show_nothing,
    show_findings: ShowFindings = ignore_findings,
) -> Assessment:
    """Assesses a flight of a vehicle in a log: events, status lights, the model, control loops and wind.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        vehicle: "system" or "system:component". Of several vehicles that match, each is judged, and the assessment is
            of the worst.
        axis: axis to model, or ``ALL_AXES``.
        options: choices of the user; None for the defaults.
        progress: shows the name of a step while it runs.
        show_findings: is called with what is known before models and loops are computed, which takes most of the time.

    Returns:
        The assessment. A log without a vehicle that can be judged has one whose headline is the reason.
    """
    vehicles = matching_vehicles(log.vehicles, vehicle)
    recorded_vehicle = None
    if len(vehicles) > 1:
        worst_vehicle, recorded_vehicle = _worst_vehicle(log, vehicles, axis, options, progress)
        signals = Signals(worst_vehicle)
    else:
        try:
            signals = Signals(choose_vehicle(log.vehicles, vehicle))
        except NotLearnable as error:
            return Assessment(log, unjudged(error.fact))
    assessment = assess_recording(
        log, signals, axis, options, progress=progress, show_findings=show_findings
    )
    return replace(assessment, recorded_vehicle=recorded_vehicle)


def _worst_vehicle(
    log: Log,
    vehicles: Sequence[Telemetry],
    axis: str,
    options: Options | None,
    progress: ShowStep,
) -> tuple[Telemetry, RecordedVehicle]:
    """Finds the vehicle of a log that has the worst headline, by judging each vehicle by itself.

    A vehicle that flew counts as worse than all that did not, as in a library (``mavdem serve``). Of vehicles that are
    equally bad the first is the worst.

    Args:
        log: the log, with the messages of each vehicle.
        vehicles: the vehicles, at least two.
        axis: axis to model, or ``ALL_AXES``.
        options: choices of the user; None for the defaults. No model is learned here, whatever they say.
        progress: shows the name of a step while it runs.

    Returns:
        The messages of the worst vehicle, and its name with the verdicts on the others: their names and headlines.
    """
    # A model takes most of the time, and does not change which vehicle is the worst.
    without_model = replace(options or Options(), with_model=False)
    names = names_of_vehicles(vehicles)
    assessments = []
    for telemetry, name in zip(vehicles, names, strict=True):
        with progress(f"Judging vehicle {name}", measured=False):
            assessments.append(assess_recording(log, Signals(telemetry), axis, without_model))

    numbers_worst_first = sorted(
        range(len(vehicles)), key=lambda number: assessments[number].severity_key
    )
    worst_number, *other_numbers = numbers_worst_first
    other_verdicts = []
    for number in other_numbers:
        other_verdicts.append(VehicleVerdict(names[number], assessments[number].stated_headline))
    return vehicles[worst_number], RecordedVehicle(names[worst_number], tuple(other_verdicts))


# Damaged messages hold infinite numbers and NaN.
@np.errstate(all="ignore")
def assess_recording(
    log: Log,
    signals: Signals,
    axis: str = ALL_AXES,
    options: Options | None = None,
    *,
    progress: ShowStep = show_nothing,
    show_findings: ShowFindings = ignore_findings,
) -> Assessment:
    """Returns the assessment of the worst flight of a vehicle's recording, with the verdicts on the others.

    A verdict is the number of a flight with its headline and status lights. All flights are judged without a model,
    which takes most of the time, and then the worst one is assessed with it.

    Flights between which the autopilot restarted on the ground are judged each by itself
    (``mavdem.assessment.separate_flights``): each with its own parameters, and none by the messages of another. A
    recording without such a restart between flights is assessed as a whole.

    Args:
        log: the log, with the messages of each vehicle.
        signals: logged time series of the vehicle in all boots.
        axis, options, progress, show_findings: as for :func:`assess_signals`, which raises the same errors.

    Returns:
        The assessment. Of flights that are equally bad the latest is assessed.
    """
    flights = separate_flights(signals)
    if not flights:
        return assess_signals(
            log, signals, axis, options, progress=progress, show_findings=show_findings
        )
    options = options or Options()
    without_model = replace(options, with_model=False)
    flight_by_number = {}
    verdicts = []
    for flight in flights:
        with progress(f"Judging flight {flight.first_number}", measured=False):
            assessment = assess_signals(log, flight.signals, axis, without_model)
        flight_by_number[flight.first_number] = flight
        verdicts.append(flight.verdict(assessment.judgement))
    worst_verdict, *other_verdicts = worst_first(verdicts)
    worst_flight = flight_by_number[worst_verdict.number]
    assessment = assess_signals(
        log, worst_flight.signals, axis, options, progress=progress, show_findings=show_findings
    )
    return replace(
        assessment,
        recorded_flight=RecordedFlight(worst_flight, tuple(other_verdicts), signals),
    )


# Damaged messages hold infinite numbers and NaN.
@np.errstate(all="ignore")
def assess_signals(
    log: Log,
    signals: Signals,
    axis: str = ALL_AXES,
    options: Options | None = None,
    *,
    progress: ShowStep = show_nothing,
    show_findings: ShowFindings = ignore_findings,
) -> Assessment:
    """Returns the assessment of one vehicle, part by part in the order in which they depend on each other.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        axis, options, progress: as for :func:`mavdem.assessment.axis.analyse`, which raises the same errors.
        show_findings: is called with what is known before models and loops are computed.

    Returns:
        The assessment, with one analysis under the name of its axis.
    """
    options = options or Options()

    # The wind comes first, since the messages that it reads are cached in the signals for the analysis.
    with progress("Estimating the wind", measured=False):
        wind = wind_evidence(signals)

    # What the log contains of the vehicle, what happened, and the lights that do not depend on models and loops.
    with progress("Examining the motors", measured=False):
        analysis = analyse_without_model(log, signals, axis, options)
    with progress("Judging the flight", measured=False):
        evidence = _evidence_without_loops(log, signals, analysis, wind)
        lights = lights_without_loops(evidence)
    show_findings(FirstFindings(evidence, analysis, ReadOnlyDict(lights)))

    # The models of the axes, and the control loops, which need their physical parameters. Pitch and yaw do not depend
    # on roll, so that a second core computes them.
    loop_signals = signals.for_axis(AXES[0], options.inputs)
    with _results_of_other_axes(log, loop_signals, axis, options, analysis) as other_axes:
        analysis = analyse(
            log,
            signals,
            axis,
            options,
            progress=progress,
            other_axis=analysis,
            estimates_of_other_axes=other_axes.estimates,
        )
        # Loops are built from the physical parameters, which are only kept if the model of roll could be learned.
        known_loops = other_axes.loops() if analysis.axes else {}
    with progress("Identifying the loops", measured=False):
        loops, autotune = loops_of_axes(
            log, loop_signals, options.start, analysis.estimates_by_axis, known_loops
        )
    evidence = replace(
        evidence,
        learnability=analysis.learnability,
        events=tuple(in_time_order([*evidence.events, *autotune])),
        loops=ReadOnlyDict(loops),
    )

    # The judgement measures margins, responses and tracking when the lights need them, and then selects headline and
    # next step.
    with progress("Judging the loops", measured=False):
        judgement = judge(evidence, **lights)
    analyses = ReadOnlyDict({analysis.learnability.axis: analysis})
    return Assessment(log, judgement, evidence, analyses)


class _ResultsOfOtherAxes:
    """Estimates and loops of pitch and yaw that a second process computes; empty if there is no such process."""

    def __init__(self, wait_for_results: Callable[[], dict[str, AxisResults] | None]) -> None:
        """Does not wait yet; the first access to the results does.

        Args:
            wait_for_results: waits for the process, and returns its results by axis; None if there is none.
        """
        self._wait_for_results = wait_for_results

    @cached_property
    def _results(self) -> dict[str, AxisResults]:
        """The results by axis, once the process has computed them."""
        return freeze(self._wait_for_results() or {})

    def estimates(self) -> dict[str, AxisEstimates]:
        """Returns the estimates by axis, once the process has computed them."""
        return {axis: results.estimates for axis, results in self._results.items()}

    def loops(self) -> dict[str, Loop | Fact]:
        """Returns the loops by axis, or the facts about why they are not known, once the process has computed them."""
        return {axis: results.loop for axis, results in self._results.items()}


@contextmanager
def _results_of_other_axes(
    log: Log, signals: Signals, axis: str, options: Options, analysis: LogAnalysis
) -> Iterator[_ResultsOfOtherAxes]:
    """Estimates physical parameters and loops of pitch and yaw in a second process, while the caller analyses roll.

    The process runs during the block of the ``with`` statement. It is started only if it saves time: if all axes are
    analysed with models, and there is a second core.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, and which of them are the inputs of the model.
        axis: name of the axis that is analysed, or ``ALL_AXES``.
        options: what is analysed.
        analysis: the analysis without a model, with the changes of the motors.

    Yields:
        The results, empty without a second process. The first access to them waits for the process.
    """
    learns_model = options.with_model and analysis.learnability.learnable
    if axis != ALL_AXES or not learns_model:
        yield _ResultsOfOtherAxes(_no_results)
        return
    compute_results = partial(_results_by_axis, log, signals, analysis.alarms, options.start)
    with in_second_process(compute_results) as wait_for_results:
        yield _ResultsOfOtherAxes(wait_for_results)


def _no_results() -> None:
    """Takes the place of the function that waits for a second process, if there is none."""


def _results_by_axis(
    log: Log, signals: Signals, alarms: Sequence[MotorChange], start: float
) -> dict[str, AxisResults]:
    """Estimates the physical parameters and the loops of pitch and yaw.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, and which of them are the inputs of the model.
        alarms: lasting changes of the motors in the flight.
        start: time from which on the flight is used, as in the options of the analysis.

    Returns:
        Estimates and loops by axis.
    """
    results_by_axis = {}
    # Roll, the first axis, is analysed by the caller.
    for axis in AXES[1:]:
        results = results_of_axis(axis, log, signals, alarms, start)
        # The wind torque is computed when it is first accessed. The page needs it, and this process has time for it
        # while the first one learns the model.
        _ = results.estimates.wind
        results_by_axis[axis] = results
    return results_by_axis


def _evidence_without_loops(
    log: Log, signals: Signals, analysis: LogAnalysis, wind: WindEvidence
) -> Evidence:
    """Collects what happened to a vehicle, and the measurements of its flights, except its control loops.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        analysis: analysis of the vehicle, without a model.
        wind: the wind in m/s, or the reason why it is not known.

    Returns:
        The evidence, to which the loops are added later.
    """
    # Each step needs the results of the steps before.
    # 1. Reports of the autopilot, and events in the motion. A reported crash counts only if sensors confirm it.
    reports = reported_events(signals)
    events = _events_without_motors(signals, reports)
    # 2. The event with which the flight was lost, if it was (the ending).
    ending = find_ending(signals, events, analysis.condition.collective)
    # 3. Losses of motor thrust until then.
    changes = _motor_changes(analysis, _first_event_distorting_outputs(events, ending))
    events += with_sensor_evidence(signals, changes, reports)
    saturation = saturation_losses(signals, events, ending)
    saturation = with_sensor_evidence(signals, saturation, reports)
    events += saturation
    # 4. The motor whose loss of thrust caused the ending, or the motors that were at their limit before it, and what
    # shows the cause.
    ending = with_saturated_motor(ending, saturation, events)
    ending = with_motors_limited_before(ending, events)
    ending = with_evidence_of_cause(signals, ending, events)
    events = raise_level_of_assumed_landings(ending, events)
    if ending is not None:
        events.append(ending)
    evidence = Evidence(
        log,
        signals,
        learnability=analysis.learnability,
        condition=analysis.condition,
        wind=wind,
        events=tuple(in_time_order(events)),
        ending=ending,
    )
    # 5. What is changed because of the flights, which follow from the ending.
    evidence = replace(evidence, events=mark_battery_reports_on_ground(evidence))
    evidence = replace(evidence, events=with_low_supply(evidence))
    evidence = replace(evidence, events=with_supply_as_suspect(evidence))
    if evidence.reasons_not_to_fly:
        evidence = replace(evidence, wind=without_flight_advice(wind))
    return evidence


def _events_without_motors(signals: Signals, reports: Facts) -> list[Fact]:
    """Returns the reports of the autopilot that sensors do not contradict, and events in the motion."""
    return lower_unconfirmed_crash_reports(signals, [*reports, *motion_events(signals, reports)])


# Damaged messages hold infinite numbers and NaN.
@np.errstate(all="ignore")
def loss_of_flight(signals: Signals) -> Fact | None:
    """Returns the event by which a flight was lost, such as an impact, without naming its cause.

    This takes seconds less than an assessment, which also computes the thrust that motors lost, and so may find another
    cause of the same loss.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The event as a fact (a coded finding); None if no flight was lost. The figures that name the cause are empty:
        the ``subject``, such as "motor 2", the ``cause``, and the autopilot's ``word`` for it. A loss that only the
        autopilot reports is returned as it is.
    """
    reports = reported_events(signals)
    loss = find_ending(signals, _events_without_motors(signals, reports))
    if loss is None or loss.code is Ending.LOSS_REPORTED:
        return loss
    return loss.replace(subject="", cause=None, word=None)


def _first_event_distorting_outputs(events: Sequence[Fact], ending: Fact | None) -> Fact | None:
    """Finds the first event after which the outputs of the motors do not describe the motors themselves.

    Such events are the loss of control, a motor that stood still, and a height estimate that diverged: a vehicle that
    follows a false height drives its motors to their limits.

    Args:
        events: events of the log, each a fact (a coded finding) with its time.
        ending: event with which the flight was lost; None if the flight was not lost.

    Returns:
        The first such event; None if there was none.
    """
    distorting_events = []
    for event in events:
        is_standstill = event.code is MotionEvent.MOTOR_STOOD_STILL and event.is_bad
        if is_standstill or event.code is MotionEvent.HEIGHT_DIVERGED:
            distorting_events.append(event)
    if ending is not None:
        distorting_events.append(ending)
    return in_time_order(distorting_events)[0] if distorting_events else None


def _motor_changes(analysis: LogAnalysis, ending: Fact | None) -> list[Fact]:
    """Returns the facts about thrust that motors lost, and about other lasting changes of their balance, before a loss.

    Args:
        analysis: analysis with the alarms on motors that a live session would have raised.
        ending: event after which the balance of the motors is not used, such as the loss of the flight; None without
            one.

    Returns:
        The losses of thrust of weak motors, then the changes that name no weak motor.
    """
    alarms = alarms_before_loss(analysis.alarms, ending)
    other_changes = [alarm.fact for alarm in alarms if not alarm.is_weak]
    return [*thrust_losses(alarms), *other_changes]


def alarms_before_loss(alarms: Sequence[MotorChange], ending: Fact | None) -> list[MotorChange]:
    """Returns the alarms before control was lost: after that the balance of the motors shows nothing."""
    loss_time = None if ending is None else loss_onset(ending)
    if loss_time is None:
        loss_time = inf
    return [alarm for alarm in alarms if alarm.time < loss_time]


def with_wind(assessment: Assessment, wind: WindEvidence) -> Assessment:
    """Returns an assessment with another estimate of its wind, such as one with the drag of an earlier flight.

    The light of the wind, the headline and the next step are judged anew; the other lights (the judgements of motors,
    margins, …) are kept.

    Args:
        assessment: assessment of a vehicle, which must have been judged.
        wind: the other estimate, and the estimate of the autopilot.

    Returns:
        A copy of the assessment.
    """
    assert assessment.evidence is not None
    evidence = replace(assessment.evidence, wind=wind)
    other_lights = {
        name: fact for name, fact in assessment.judgement.lights.items() if name != Light.WIND
    }
    judgement = judge(evidence, **other_lights)
    return replace(assessment, judgement=judgement, evidence=evidence)


def without_flight_advice(wind: WindEvidence) -> WindEvidence:
    """Removes advice to fly from the facts about the wind, for a vehicle that must not fly as it is.

    Where the direction of the wind is not known, for example, its fact advises to fly legs in several directions. After
    a crash, or with an oscillation, that would be dangerous.

    Args:
        wind: the estimated wind with facts, by quantity, that say why one is not known, and a fact that advises how to
            know the wind better; or the reason why there is no estimate.

    Returns:
        The same with each of these facts replaced by :attr:`mavdem.facts.Fact.without_flight_advice`: reasons have no
        remedy then, and the advice begins with the condition that the vehicle may fly again.
    """
    estimate = wind.estimate
    reason_unknown = wind.reason
    if estimate is not None:
        reasons = {name: fact.without_flight_advice for name, fact in estimate.reasons.items()}
        advice = estimate.advice
        if advice is not None:
            advice = advice.without_flight_advice
        estimate = replace(estimate, reasons=reasons, advice=advice)
    if reason_unknown is not None:
        reason_unknown = reason_unknown.without_flight_advice
    return wind._replace(estimate=estimate, reason=reason_unknown)
