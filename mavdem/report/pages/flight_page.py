"""The page of a flight: what happened, and what the flight shows of its axes, loops, noise, motors, wind and model."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from itertools import chain
from math import inf, nan
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.findings import findings_of
from mavdem.assessment.axis.responses import Responses
from mavdem.assessment.axis.tuning import AdviceByAxis, tuned
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.inventory import inventory
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.dem import Learned
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.assessment import Grade, Purpose
from mavdem.facts.ending import MotionEvent
from mavdem.facts.event import Event
from mavdem.facts.loops import Gains
from mavdem.facts.session import Spent
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import Loop, identified_loops
from mavdem.loops.filters import gyro_filters
from mavdem.loops.step_response import IntervalEstimate, StepResponse
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution, warning
from mavdem.report.charts import model_charts
from mavdem.report.charts.chart import MAX_POINTS, MAX_POINTS_OF_SMALL_PAGE, Group
from mavdem.report.charts.flight_charts import (
    loop_charts,
    spectrogram_charts,
    spectrum_chart,
    step_charts,
)
from mavdem.report.charts.plans import flown_path, frame_plan, rose_of_wind
from mavdem.report.charts.timeline import Timeline, live_timeline, timeline_of
from mavdem.report.condition import air_blocks, log_blocks
from mavdem.report.labels import Labels
from mavdem.report.loops import compared_loops, gain_blocks, gain_limits, margin_tables
from mavdem.report.numbers import display_unit, listed, rounded, with_unit
from mavdem.report.pages.page import Chapter, Head, render_document
from mavdem.report.review import review_title
from mavdem.report.screen import (
    conclusion,
    detail_blocks,
    motor_blocks,
    prediction_blocks,
    purpose_tables,
    torque_blocks,
    vehicle_blocks,
)
from mavdem.report.templates import capitalize_first, render_section, sentences_by_axes
from mavdem.report.truth import truth_blocks

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory
    from mavdem.live.session_status import SessionStatus

AXIS_IN_NAME = re.compile(r"RLL|ROLL|PITCH|PIT|YAW")
GEOMETRY = "CA_"
"""How PX4's parameters of the motors' places begin, which the picture of the motors shows."""
FIGURES = {
    "overshoot": ("overshoot (%)", 100.0),
    "rise_time": ("rise (s)", 1.0),
    "settling": ("settling (s)", 1.0),
    "delay": ("delay (ms)", 1e3),
    "peak": ("peak of |T|", 1.0),
    "peak_frequency": ("at (Hz)", 1.0),
}
"""Header and scale of the figures of a step response."""
ERRORS = {
    "angle_error": "angle error (RMS)",
    "delay": "delay",
    "rate_error": "rate error (RMS)",
}
"""Header of the figures of tracking."""
DURATIONS = "rise_time", "settling", "delay"
"""Those that end with what is seen of a step, or later."""
OTHERS = "accelerometer", "demand", "d_term"
"""Names of spectra beside those of the gyro."""


def review_page(assessment: Assessment) -> str:
    """Returns the HTML of the page of an ``assessment``."""
    name = Path(assessment.log.source).name
    analysis = assessment.analysis
    if analysis is None or assessment.evidence is None:
        return log_page(name, assessment, inventory(assessment.log))
    held = inventory(assessment.log, [assessment.contents])
    held["vehicles"][0] |= assessment.judgement_values | {"model": analysis.model}
    return log_page(name, assessment, held)


def flight_page(file: str, assessment: Assessment) -> str:
    """Returns the HTML of one flight of a fleet, the log ``file``, with a link to the fleet's page."""
    return log_page(file, assessment, back=("Fleet", "../index.html"))


def log_page(
    name: str,
    assessment: Assessment,
    held: JsonValues | None = None,
    back: tuple[str, str] | None = None,
) -> str:
    """Returns the HTML of one log of this ``name``, with models or without.

    Without what the log ``held`` (``mavdem.assessment.inventory``) the page is small, for many flights. ``back`` is
    name and address of the page that leads here.
    """
    whole = held is not None
    timeline = timeline_of(assessment)
    events = [
        Event(nan if fact.time is None else fact.time, fact)
        for fact in _stops_counted(assessment.events)
    ]
    level = assessment.headline.level
    head = Head(level, assessment.lights, events, timeline, assessment.analysis)
    chapters = [*_measured(assessment, timeline, whole), *_models(assessment)]
    if held is not None:
        chapters.append(
            Chapter("What was read from the log, and repaired", log_blocks(held), folded=True)
        )
    above, *_, following = conclusion(assessment.judgement)
    subtitle = capitalize_first(review_title(assessment).text)
    points = MAX_POINTS if whole else MAX_POINTS_OF_SMALL_PAGE
    return render_document(name, subtitle, [above, following], chapters, back, head, points)


def _stops_counted(events: Facts) -> Iterator[Fact]:
    """Yields the ``events``, but of a motor that was often at its limit only the first time, with how often."""
    stop = MotionEvent.MOTOR_AT_ITS_STOP
    counts = Counter(event.subject for event in events if event.code is stop)
    for event in events:
        if event.code is not stop:
            yield event
        elif count := counts.pop(event.subject, 0):
            yield event.but(count=count)


def _measured(assessment: Assessment, timeline: Timeline | None, whole: bool) -> Iterator[Chapter]:
    """What the flight shows without a model."""
    evidence = assessment.evidence
    analysis = assessment.analysis
    if evidence is None or analysis is None:
        return
    if timeline is not None:
        columns = tuple(
            tuple(map(timeline.marked, charts))
            for charts in timeline.axis_charts.values()
            if charts
        )
        yield Chapter(
            "Three axes",
            [*_tracking(assessment.lights["tracking"], assessment.tracking)],
            [Group(columns)],
        )
    yield responses_chapter(assessment.responses)
    yield _loops(evidence, _advice(assessment, evidence) if whole else {})
    yield _noise(assessment, timeline, whole)
    others = (_spectra(assessment.noise, name, timeline, whole) for name in OTHERS)
    yield Chapter(
        "Spectra of accelerometer, motors' demand and D term", (), [*chain(*others)], folded=True
    )
    yield _motors(analysis, evidence)
    yield _wind(assessment, analysis, timeline)
    yield _parameters(evidence.signals.telemetry)


def _tracking(light: Fact, axes: NamedFacts) -> Iterator[Block]:
    """What is said of the worst axis, and the errors of all of which there are any."""
    yield Sentence(str(light), "Tracking:")
    rows = []
    for axis, fact in axes.items():
        known = fact.figures
        shown = [
            with_unit(known[key], display_unit(fact.units[key]))
            if known.get(key) is not None
            else ""
            for key in ERRORS
        ]
        if any(shown):
            rows.append([axis, *shown])
    if rows:
        yield Table(["tracking", *ERRORS.values()], rows)


def responses_chapter(responses: Responses) -> Chapter:
    """Returns step responses as measured and predicted, their figures, and which of them is doubted."""
    rows = []
    blocks = Blocks()
    refusals = dict[Fact, list[str]]()
    for axis, loops in responses.items():
        for loop, response in loops.items():
            name = f"{axis} {loop}"
            seen = response.measured
            if isinstance(seen, Fact):
                refusals.setdefault(seen.but(subject=""), []).append(name)
            else:
                rows.append([name, *(_estimate(seen, key) for key in FIGURES)])
            if response.compared is not None and not response.compared.is_good:
                blocks.append(caution(response.compared))
    for fact, names in refusals.items():
        blocks.append(Sentence(str(fact.but(subject=listed(names)))))
    if rows:
        header = ["step response (90 % interval)", *(name for name, _ in FIGURES.values())]
        blocks.insert(0, Table(header, rows))
    caption = "Grey: measured, with its 90 % band. Blue, where the loop is identified: predicted."
    columns = step_charts(responses)
    return Chapter("Step response", blocks, [Group(columns, caption)] if columns else [])


def _estimate(response: StepResponse, key: str) -> str:
    estimate: IntervalEstimate = getattr(response, key)
    _, scale = FIGURES[key]
    last = float(response.time[-1]) if key in DURATIONS else inf
    value, low, high = ("over " * (figure >= last) + rounded(scale * figure) for figure in estimate)
    return value if estimate.low >= last else f"{value} ({low} to {high})"


def _advice(assessment: Assessment, evidence: Evidence) -> AdviceByAxis:
    """What ``mavdem tune`` advises of all axes; of a grounded vehicle whose loops are not known, why nothing."""
    try:
        return tuned(assessment, AXES, is_written=False).axes
    except NotLearnable as error:
        return {"all axes": error.fact} if evidence.reasons_not_to_fly else {}


def _loops(evidence: Evidence, advice: AdviceByAxis) -> Chapter:
    """The margins of all axes, or why they are not known, the gains to set, and the loops now and with these."""
    said = []
    for margin in evidence.margins:
        facts = [fact.but(names=(margin.axis,)) for fact in margin.facts]
        if not facts and isinstance(margin.loop, Fact):
            facts = [margin.loop]
        said += [(margin.axis, fact) for fact in facts]
    blocks: Blocks = [*sentences_by_axes(said)]
    loops = identified_loops(evidence.loops)
    shown = {axis: {"now": loop} for axis, loop in loops.items()}
    for axis, gains in advice.items():
        if isinstance(gains, Advice):
            blocks.append(Sentence(gains.sentence.advised, f"Gains of {axis}:"))
            blocks += gain_blocks(gains)
            shown[axis] = compared_loops(gains)
        elif not loops:
            blocks.append(Sentence(gains.advised, f"Gains of {axis}:"))
    blocks += gain_limits(advice)
    if not loops:
        return Chapter("Control loops", blocks)
    columns = [*map(loop_charts, shown.values())]
    caption = "Open loops with 90 % bands. Dashed: where the gain is 1, with the phase margin."
    groups = [Group(tuple(columns), caption)]
    return Chapter("Control loops", [*margin_tables(loops), *blocks], groups)


def _noise(assessment: Assessment, timeline: Timeline | None, whole: bool) -> Chapter:
    """The gyro's spectrum with the filters that are set, and its spectrograms."""
    noise = assessment.noise
    loops = [*identified_loops(assessment.loops).values()]
    blocks: Blocks = [Sentence(str(fact)) for fact in noise.facts]
    first = max(loops, key=lambda loop: loop.crossover, default=None)
    if first is not None:
        filters = gyro_filters(first.controller, first.crossover)
        blocks += render_section("loop_filters", filters=filters, crossover=first.crossover)
    return Chapter("Spectra", blocks, [*_spectra(noise, GYRO, timeline, whole, first)])


def _spectra(
    noise: MeasuredNoise,
    name: str,
    timeline: Timeline | None,
    whole: bool,
    loop: Loop | None = None,
) -> Iterator[Group]:
    """Yields the spectrum of a sensor, before its filters and behind them, and if ``whole`` its spectrograms."""
    shown = noise.spectra.get(f"{name}_before", noise.spectra.get(name))
    if shown is None:
        return
    yield Group.of([spectrum_chart(noise, loop, name)])
    if whole:
        over_time, *over_throttle = spectrogram_charts(shown)
        if timeline is not None:
            over_time = timeline.marked(over_time)._replace(spans=())
        yield Group.of([over_time, *over_throttle], "The stronger the blue, the higher the power.")


def _motors(analysis: LogAnalysis, evidence: Evidence) -> Chapter:
    """What is known of each motor and of the vehicle's condition."""
    is_full = analysis.tier.tier == "a"
    blocks = motor_blocks(analysis.learned, analysis.condition.hover if is_full else None)
    if analysis.learned is None or not is_full:
        blocks += render_section("condition", analysis.condition)
    plan = frame_plan(evidence.signals.motors, analysis.condition)
    return Chapter("Motors", blocks, [] if plan is None else [Group.of([plan])], beside=True)


def _wind(assessment: Assessment, analysis: LogAnalysis, timeline: Timeline | None) -> Chapter:
    """The wind in m/s and as a torque, its rose, and the path that was flown."""
    blocks = air_blocks(assessment)
    wind = assessment.wind
    panels = [
        rose_of_wind(wind)
        if wind is not None and wind.direction_identifiable and wind.speed_identifiable
        else None,
        flown_path(timeline),
    ]
    if analysis.learned is not None:
        blocks += torque_blocks(analysis.learned)
    blocks += truth_blocks(analysis.truth) if analysis.truth else []
    return Chapter("Wind and path", blocks, [Group.of(panels)] if any(panels) else [], beside=True)


def _parameters(telemetry: Telemetry) -> Chapter:
    """Parameters that changed in the flight, and those that rate and attitude control depend on."""
    changed = [
        [name, f"{before:.4g}", f"{telemetry.parameters[name]:.4g}"]
        for name, before in sorted(telemetry.initial_parameters.items())
        if not AUTOPILOT_SET_PARAMETERS.search(name)
    ]
    blocks = []
    if changed:
        blocks.append(Table(["changed in flight", "from", "to"], changed))
    by_axis = dict[str, dict[str, str]]()
    for name, value in sorted(telemetry.parameters.items()):
        if value and CONTROL_PARAMETERS.match(name) and not name.startswith(GEOMETRY):
            axis = AXIS_IN_NAME.search(name)
            column = "all" if axis is None else axis[0][0]
            by_axis.setdefault(AXIS_IN_NAME.sub("…", name, 1), {})[column] = f"{value:.4g}"
    rows = [
        [name, *(row.get(axis, "") for axis in ("R", "P", "Y", "all"))]
        for name, row in by_axis.items()
    ]
    half = -(-len(rows) // 2)
    for part in (rows[:half], rows[half:]):
        if part:
            blocks.append(Table(["parameter", "roll", "pitch", "yaw", "all"], part))
    return Chapter("Parameters", blocks)


def _models(assessment: Assessment) -> Iterator[Chapter]:
    """What was learned of each axis, how well it forecasts and, folded, how it was learned."""
    for axis, analysis in assessment.analyses.items():
        blocks = Blocks()
        if analysis.learned is None and analysis.reason is not None:
            blocks.append(Sentence(str(analysis.reason), "No model:"))
        blocks += [*purpose_tables(analysis.findings), *map(warning, analysis.findings.warnings)]
        blocks += render_section("tier", analysis.tier)
        blocks += vehicle_blocks(analysis.axes, bool(analysis.findings.overrides))
        groups = []
        if (learned := analysis.learned) is not None:
            labels = Labels.of(learned)
            blocks += prediction_blocks(labels, analysis.held_out)
            if analysis.findings.grade(Purpose.CONTROL_EFFECTIVENESS) is not Grade.NOT_IDENTIFIABLE:
                said = "Frequency response of the vehicle without its controller, with a 90 % band."
                groups.append(Group.of(model_charts.bode_charts(learned), said))
            if analysis.held_out is not None and len(analysis.held_out):
                said = "Held-out windows, by models that were not trained on them."
                groups.append(
                    Group.of(model_charts.forecast_charts(analysis.held_out, labels), said)
                )
        yield Chapter(f"Model of {axis}", blocks, groups)
        if learned is not None:
            yield _inside(axis, learned)


def _inside(axis: str, learned: Learned) -> Chapter:
    """How a model was learned, folded."""
    settings = [[name, str(value)] for name, value in asdict(learned.settings).items()]
    blocks = detail_blocks(learned)
    blocks.append(Table(["setting", "value"], settings, words=True))
    said = "Errors one step ahead; correlations between the lines may be chance (99 %)."
    groups = [Group.of(model_charts.residual_charts(learned), said)]
    return Chapter(f"The model of {axis}, and how it was learned", blocks, groups, folded=True)


def live_page(
    link: str,
    axis: str,
    history: LiveHistory,
    status: SessionStatus,
    account: Mapping[Spent, float],
    learned: Learned | None,
    back: tuple[str, str] | None = None,
) -> str:
    """Returns the HTML of a live flight: ``history`` was collected in flight, the others are those at its end.

    ``account`` has seconds by what they were; ``back`` is name and address of the page that leads here.
    """
    findings = status.findings or findings_of(learned, alarms=status.motor_alarms)
    judgement = status.overall_judgement
    seconds = 0.0 if learned is None else len(learned.record) * learned.dt
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import live_report

    report = live_report(history, status, account, axis, seconds)
    timeline = live_timeline(history, axis)
    events = history.events
    name = status.vehicle or ""
    head = Head(judgement.headline.level, judgement.lights, events, timeline, vehicle=name)
    above, *_, following = conclusion(judgement)
    chapters = [Chapter(f"Prediction of {axis} in flight, and the link", report)]
    advice = Blocks(Sentence(each.sentence) for each in events if isinstance(each.fact.code, Gains))
    if advice:
        chapters.insert(0, Chapter("Gains", advice))
    if learned is not None:
        blocks = [*purpose_tables(findings), *torque_blocks(learned)]
        chapters.insert(0, Chapter("Motors", motor_blocks(learned, None)))
        chapters.append(Chapter(f"Model of {axis}", blocks))
    subtitle = f"What {axis} did, learned and predicted while it flew."
    return render_document(
        f"Flight over {link}", subtitle, [above, following], chapters, back, head
    )
