"""The page of ``mavdem wind``: the wind over time, on the map and by height, the airspeed, and the drag."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from types import MappingProxyType
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.lights.wind import wind_light
from mavdem.assessment.time_history import wind_history
from mavdem.confidence import IntervalEstimate
from mavdem.dataset import intervals
from mavdem.dataset.intervals import TimeInterval
from mavdem.facts import Fact, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.report.blocks import Block, Blocks, Sentence, headline_sentence
from mavdem.report.charts.chart import Chart, Group, Line, over_time
from mavdem.report.charts.flown_path import MapWind, flown_path
from mavdem.report.charts.plans import rose_of_wind
from mavdem.report.charts.timeline import Timeline, height_chart, history_timeline
from mavdem.report.condition import (
    drag_blocks,
    estimated_intervals,
    flight_warning,
    wind_blocks,
    wind_tables,
)
from mavdem.report.gain_changes import parameter_downloads
from mavdem.report.pages.page import Chapter, Head, render_document
from mavdem.report.palette import MEASURED, PREDICTED
from mavdem.report.screen import remarks_on_wind
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.wind_velocity.velocity import WindVelocity

SUBTITLE = """\
The wind of the longest flight, from lean and velocity over ground, with 90 % bands. Directions are \
where it comes from."""
"""What stands below the title."""

SUBTITLE_WITHOUT_WIND = "No wind can be estimated from this log."
"""What stands below the title without an estimate."""

SUMMARY_LEADS = ("How certain:", "To know it better:")
"""What stands before the sentences on intervals and next flight (``sections/wind.toml``), which are never folded."""

NO_FILES: Mapping[str, str] = MappingProxyType({})
"""No files with parameters to set."""


def wind_page(
    name: str,
    wind_evidence: WindEvidence,
    assessment: Assessment,
    parameters: dict[str, IntervalEstimate],
    remarks_on_prior: Sequence[Block] = (),
    drag_files: Mapping[str, str] = NO_FILES,
) -> str:
    """Renders the page of ``mavdem wind``.

    Args:
        name: name of the log, the title of the page.
        wind_evidence: the estimated wind, perhaps with an earlier drag as its prior, and the wind that the autopilot
            estimated. There must be an estimate; the command refuses a log without one.
        assessment: assessment of the log, which gives the history of the flight and the warnings.
        parameters: parameters of the autopilot's drag model to set, with their intervals.
        remarks_on_prior: sentences that name the earlier flight whose drag is the prior, and say what is in doubt about
            it; none without a prior.
        drag_files: texts of the files with these parameters, by the ending of their names, such as ``.params``.

    Returns:
        The page as HTML.
    """
    wind = wind_evidence.estimate
    assert wind is not None
    timeline = _wind_timeline(wind_evidence, assessment)
    head = Head(
        level=_page_level(wind_evidence, assessment),
        # The page is about the wind alone: the levels of motors, power and the like are not shown.
        lights={},
        timeline=timeline,
        timeline_title="Wind over time",
        path=flown_path(timeline, MapWind.of_flight(wind)),
    )
    evidence = assessment.evidence
    autopilot = "" if evidence is None else evidence.signals.telemetry.autopilot
    chapter = Chapter(
        "By direction, time and height, and the drag",
        [*wind_tables(wind), *drag_blocks(wind.drag, autopilot, parameters)],
        _rose_groups(wind),
        is_side_by_side=True,
        downloads=[*parameter_downloads(drag_files, f"{PurePath(name).stem}.drag", "Drag:")],
    )
    sentences = _wind_sentences(wind_evidence, assessment, remarks_on_prior)
    limits = Chapter("What the estimate rests on", sentences.limits, folded=True)
    return render_document(name, SUBTITLE, sentences.summary, [chapter, limits], head=head)


class _WindSentences(NamedTuple):
    """The sentences on the wind, by their place on the page."""

    summary: Blocks
    """The estimated wind, warnings, how certain it is and what to fly next; they stand above the charts."""

    limits: Blocks
    """What was left out, checked, and not identified; they stand folded below the charts."""


def _wind_sentences(
    wind_evidence: WindEvidence, assessment: Assessment, remarks_on_prior: Sequence[Block]
) -> _WindSentences:
    """Returns the sentences on the estimated wind.

    Args:
        wind_evidence: the estimated wind, and the wind that the autopilot estimated.
        assessment: assessment of the log, which gives the warnings.
        remarks_on_prior: sentences on the earlier flight whose drag was used; none without one.
    """
    remarks = [*remarks_on_prior, *remarks_on_wind(assessment.judgement)]
    # The first block is the sentence with the estimate, and the others say what limits it.
    estimate_sentence, *limitations = wind_blocks(wind_evidence, remarks=remarks)
    assert isinstance(estimate_sentence, Sentence)
    summary: Blocks = [
        headline_sentence(f"{estimate_sentence.lead} {estimate_sentence.text}"),
        *flight_warning(assessment.judgement),
    ]
    limits: Blocks = []
    for block in limitations:
        # A sentence with a level is a caution, which is never folded.
        is_caution = isinstance(block, Sentence) and block.level is not None
        is_for_summary = isinstance(block, Sentence) and block.lead in SUMMARY_LEADS
        if is_caution or is_for_summary:
            summary.append(block)
        else:
            limits.append(block)
    return _WindSentences(summary, limits)


def _rose_groups(wind: WindVelocity) -> list[Group]:
    """Returns the wind rose as the only group of charts; no group if speed or direction are not identifiable."""
    if not wind.speed_identifiable or not wind.direction_identifiable:
        return []
    return [Group.side_by_side([rose_of_wind(wind)])]


def page_without_wind(name: str, reason: Fact, assessment: Assessment) -> str:
    """Renders the page of ``mavdem wind`` for a log from which no wind can be estimated.

    Args:
        name: name of the log, the title of the page.
        reason: why there is no estimate.
        assessment: assessment of the log, which gives the warnings.

    Returns:
        The page as HTML, with the reason and what to do about it.
    """
    summary: Blocks = [headline_sentence(reason.sentence)]
    if reason.remedy:
        summary.append(Sentence(reason.remedy, "Next:"))
    summary += next_step_without_wind(reason, assessment.judgement)
    head = Head(level=Level.UNKNOWN, lights={})
    return render_document(name, SUBTITLE_WITHOUT_WIND, summary, [], head=head)


def next_step_without_wind(reason: Fact, judgement: Judgement) -> list[Sentence]:
    """Returns what else is wrong with a flight that shows no wind, and what to do before the next one.

    Args:
        reason: why no wind can be estimated. Where it has a remedy, such as a message to log, that is the next step.
        judgement: headline and next step of the flight.
    """
    sentences = flight_warning(judgement)
    if not reason.remedy:
        sentences.append(Sentence(str(judgement.next_step), "Next:"))
    return sentences


def _page_level(wind_evidence: WindEvidence, assessment: Assessment) -> Level:
    """Returns the level of the page, which colours its edge: that of the wind, or unknown.

    It is unknown where a green edge would mislead: it would call a flight sound that ended in a crash, or a speed known
    that may be biased.

    Args:
        wind_evidence: the wind that was estimated for this page; it must have an estimate.
        assessment: assessment of the log.
    """
    wind = wind_evidence.estimate
    assert wind is not None
    is_flight_sound = not flight_warning(assessment.judgement)
    if is_flight_sound and wind.status["speed"] is Status.REPORTED:
        return _wind_level(wind_evidence, assessment)
    return Level.UNKNOWN


def _wind_level(wind_evidence: WindEvidence, assessment: Assessment) -> Level:
    """Returns the level of the wind's status light, judged by the estimate of this page.

    The light of the flight's review may have another level. This page may use the vehicle's drag from an earlier
    flight, by which the wind is known better. If the vehicle did not fly, the level is taken from the review.

    Args:
        wind_evidence: the wind that was estimated for this page.
        assessment: assessment of the log, with the light of the state estimator, on which the light of the wind
            depends.
    """
    lights = assessment.lights
    if assessment.evidence is None or assessment.evidence.not_flown is not None:
        return lights[Light.WIND].level
    evidence = replace(assessment.evidence, wind=wind_evidence)
    return wind_light(evidence, lights[Light.ESTIMATOR]).level


def _wind_timeline(wind_evidence: WindEvidence, assessment: Assessment) -> Timeline | None:
    """Returns the timeline of the page: charts of height, wind and speed through the air over time.

    It is the timeline of the flight's page, with the wind of this page, and without charts that do not concern the
    wind.

    Args:
        wind_evidence: the wind that was estimated for this page, and the autopilot's own estimate.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        The timeline; None if the log has no attitude over time, or the wind is of another boot of the autopilot.
    """
    evidence = assessment.evidence
    if evidence is None or evidence.time_history is None:
        return None
    history = evidence.time_history
    wind = wind_history(wind_evidence, history.segment)
    if wind is None:
        return None
    timeline = history_timeline(replace(history, wind=wind))
    # Of the charts of the flight, such as battery voltage, only the height concerns the wind.
    height = height_chart(history)
    wind_charts = timeline.wind_charts
    if wind.estimate.speed_identifiable:
        # The speed through the air follows from the speed of the wind.
        wind_charts = (*wind_charts, _air_velocity_chart(wind.estimate))
    return timeline._replace(
        flight_charts=(height,) if height.lines else (),
        axis_charts={},
        wind_charts=wind_charts,
        events=(),
        grey_intervals=_intervals_without_wind(wind.estimate.time, timeline.span),
        grey_meaning="no wind estimate",
    )


def _intervals_without_wind(time: Array, span: TimeInterval) -> tuple[TimeInterval, ...]:
    """Returns the parts of a flight for which no wind was estimated, such as take-off, landing and what was left out.

    Args:
        time: times (T,) of the estimate, s, evenly spaced but for gaps.
        span: first and last time that is shown, s.

    Returns:
        Start and end of each part, s, in the order of time.
    """
    return tuple(intervals.intersection([span], intervals.complement(estimated_intervals(time))))


def _air_velocity_chart(wind: WindVelocity) -> Chart:
    """Returns the chart of the speed through the air over time, m/s: forward and to the right of the vehicle.

    It is the velocity of the vehicle relative to the wind of each moment, not to the mean wind, so that the chart of a
    hover shows the gusts. The airspeed in the message VFR_HUD is not drawn for comparison: without an airspeed sensor,
    ArduPilot sends the ground speed in its place.

    Args:
        wind: the estimated wind, with the velocity of the vehicle relative to the air along its body axes.
    """
    forward_speed = wind.air_velocity[:, 0]
    speed_to_right = wind.air_velocity[:, 1]
    lines = [
        Line("forward", PREDICTED, wind.time, forward_speed),
        Line("to the right", MEASURED, wind.time, speed_to_right),
    ]
    return over_time("Speed through the air", "m/s", lines)
