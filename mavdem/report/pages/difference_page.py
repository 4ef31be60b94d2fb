"""The HTML page that compares two flights: what differs, then responses, margins, spectra, motors and wind of both."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from math import sqrt
from typing import NamedTuple, Self

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.parameter_changes import ParameterChange, axes_of_parameter
from mavdem.fleet.quantities import LOOP_KINDS, SHARE
from mavdem.fleet.random_effects import QuantityChange
from mavdem.fleet.report_columns import value_at
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.loops.axis_loops import LOOP_NAMES
from mavdem.report.blocks import Block, Blocks, Rated, Sentence, Table
from mavdem.report.charts.change_plan import (
    change_plan,
    drawn_changes,
    is_uncertain_sign_of_weak_motor,
)
from mavdem.report.charts.chart import Axis, Chart, Group, Line, LineStyle, Mark, Plan, step_chart
from mavdem.report.charts.comparison_charts import (
    BATTERY_VOLTAGE,
    HEIGHT,
    HEIGHT_ABOVE_START,
    MAX_MOTORS,
    MEAN_MOTOR_OUTPUT,
    MEAN_SECONDS,
    MOTOR_OUTPUTS,
    PITCH,
    PITCH_ERROR,
    ROLL,
    ROLL_ERROR,
    VIBRATIONS,
    FlightSeries,
    flight_series_charts,
    start_on_boot_clock,
    time_in_flight,
)
from mavdem.report.charts.flight_charts import MIN_DENSITY
from mavdem.report.difference.changes import (
    difference_blocks,
    explained_bounds,
    missing_margins_reason,
    sentences_on_missing_quantities,
    unchanged_quantity_sentences,
)
from mavdem.report.difference.conditions import condition_table
from mavdem.report.difference.flight_cautions import flight_cautions
from mavdem.report.difference.gain_table import tabled_gains
from mavdem.report.difference.headline import (
    headline_blocks,
    headline_in_two_sizes,
    headline_of_comparison,
    sentences_on_watched_lights,
)
from mavdem.report.difference.identity import identity_remarks
from mavdem.report.difference.lights import (
    NO_REVIEWS,
    REFERENCE,
    Review,
    bad_lights,
    light_blocks,
    lights_are_equal,
    lights_of_both,
    lights_of_side,
    sentences_on_further_watched_lights,
    states_in_flights,
    vibration_changes,
    vibrations_of_same_imu,
)
from mavdem.report.difference.motors import motor_table, motor_warnings
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.parameter_rows import parameter_rows
from mavdem.report.difference.parameters import parameter_count_sentences
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.difference.sides import side_descriptions
from mavdem.report.numbers import (
    UNKNOWN_FIGURE,
    counted,
    display_density_unit,
    estimate_with_interval,
    listed,
)
from mavdem.report.pages.page import Chapter, KeyEntry, ResultPicture, render_document
from mavdem.report.pages.page_link import PageLink
from mavdem.report.palette import (
    BAD,
    DISTURBANCE,
    LIMITED,
    MEASURED,
    PHYSICAL,
    PREDICTED,
    TRUTH,
)
from mavdem.report.templates import render_section
from mavdem.report.tuning.figures import LOOP_FIGURES, TUNED_FIGURES

Reviews = Mapping[str, Review]
"""The reviews of both flights, by side: "A" and "B"."""

SIDE_COLOURS = {"A": PREDICTED, "B": TRUTH}
"""Colour of each side in charts."""

SIDE_SHAPES = {"A": LineStyle.DOTS, "B": LineStyle.SQUARES}
"""Shape of each side in the chart of trims, where colours of single flights are those of their motors' level."""

CHANGES_CAPTION = """\
Changes from A to B with 90 % intervals, each kind on its own scale. An interval within the shaded band: the same."""
"""What stands below the drawing of all changes, before what its shapes mean."""

OUTCOME_CAPTIONS = {
    QuantityOutcome.CHANGED: " Square: changed; red worse, green better, blue neither, or by lean.",
    QuantityOutcome.UNCERTAIN: " Ring: too uncertain to tell; perhaps changed if the interval leaves out 0.",
    QuantityOutcome.SAME: " Dot: the same.",
}
"""What the shape of each outcome means, for the outcomes that are drawn."""

EVIDENCE_CAPTION = " Diamond: uncertain alone, but agrees with the weak motor of the headline."
"""What the shape of such a change means."""

TRIMS_CAPTION = """\
Relative trim: a motor's mean output over the median motor's, lean in wind included. The bars include how much flights \
of one vehicle usually differ."""
"""What stands below the chart of trims."""

FLIGHT_DOTS_CAPTION = """\
 Each motor has a column for A (dots) and one for B (squares). The mean has a bar. Right of it are the single flights, \
hollow, in order of date, coloured by how the motors of each were judged."""
"""What is added to it where a side has several flights."""

MAX_CHANGES_AT_TOP = 8
"""Drawn changes that stand below the chart at the top of the page, such as the trims of eight motors; a choice.

More of them have a chapter of their own, since they would push all other results from the first screen.
"""

MEAN_OFFSET = -0.3
"""Position of the mean in the column of its side, in distances of two columns: left of the flights, a choice."""

STATE_COLOURS = {
    Level.GOOD: PHYSICAL,
    Level.WATCH: LIMITED,
    Level.BAD: BAD,
    REFERENCE: DISTURBANCE,
    Level.UNKNOWN: MEASURED,
}
"""Colour of the dot of a single flight, by the state of its motors."""

WARNING_COLOURS = {Level.BAD: BAD, Level.WATCH: LIMITED}
"""Colour of the line at a warning about a motor, by its level, the worse first."""

MARK_ROOM = 0.15
"""Room for the names of marks above the lines, in the range of the vertical axis: a choice, the height of a name."""

FLIGHT_DOTS_WIDTH = 0.4
"""Room of the dots of single flights beside each other, in distances of two columns: a choice."""

FLIGHT_DOTS_OFFSET = 0.05
"""Position of their middle in the column, likewise: the mean and the flights together are about its middle."""

MAX_FLIGHT_DOTS = 40
"""Flights of a side up to which each has a dot of its own: more would hide each other."""

CHARTS_IN_ROW = 2
"""Charts over time side by side: four motors fill two rows, and roll stands beside pitch."""

GYRO_DENSITY_UNIT = display_density_unit("rad/s")
"""Unit in which power spectral densities of the gyro are shown."""

MARGIN_FIGURES = {"rate": (*LOOP_FIGURES,), "attitude": TUNED_FIGURES}
"""Figures in the table of margins, by the loop."""

SUBJECT_PLACEHOLDER = "{subject}"
"""Stands for the subject of a sentence, such as "roll rate", while equal ones of several axes are put together."""

TITLES_OF_LIGHTS: Mapping[str, Sequence[str]] = {
    Light.TRACKING: (ROLL_ERROR, PITCH_ERROR),
    Light.WIND: (ROLL, PITCH),
    Light.POWER: (BATTERY_VOLTAGE,),
    Light.ESTIMATOR: (HEIGHT, HEIGHT_ABOVE_START),
    Light.VIBRATION: VIBRATIONS,
}
"""Titles of the charts over time that show what a light judges, by its name."""

LIGHTS_OVER_TIME = (Light.TRACKING, Light.POWER)
"""Lights on what the charts over time show. Vibration and output of the motors have charts of their own above."""

MAX_OPEN_ROWS = 10
"""Rows of a table, of parameters or margins, up to which the page shows it unasked: a choice, a third of a screen."""

MAX_LISTED_PARAMETERS = 2000
"""Changed parameters that the page lists: more than an autopilot has, about 1500; a damaged log may have any number."""


def comparison_page(
    names: tuple[str, str],
    reviewed: ReviewedDifference,
    back: PageLink | None = None,
    flights: tuple[FlightSeries | None, FlightSeries | None] = ({}, {}),
    addresses: tuple[str, str] = ("", ""),
) -> str:
    """Renders the page that compares two flights.

    Args:
        names: names of the two flights, or groups of flights, A and B.
        reviewed: their comparison. In its reviews the motors are judged beside other flights of the vehicle as well
            (``review_with_compared_motors``).
        back: link to the page from which this one is reached; None without one.
        flights: time series of A and of B (``flight_series``), which are drawn over each other. They are empty for a
            group of flights, and None for a flight with which they were not stored.
        addresses: addresses of the pages of A and of B; empty where there are none.

    Returns:
        The HTML of the page.
    """
    descriptions = side_descriptions(names, reviewed)
    colour_key = []
    for (side, description), address in zip(descriptions.items(), addresses, strict=True):
        colour_key.append(KeyEntry(SIDE_COLOURS[side], side, description, address))
    headline = headline_of_comparison(reviewed)
    summary = _summary(reviewed, headline)
    chapters: list[Chapter] = []
    picture = None
    # A flight does not differ from itself.
    if not reviewed.difference.is_of_same_flight:
        pictures = _pictures(reviewed, flights)
        chart = _main_chart(reviewed, pictures)
        pictures = pictures._replace(at_top=chart)
        is_trim_chart_at_top = chart is pictures.trims
        caption = _trims_caption(reviewed) if is_trim_chart_at_top else ""
        change_chapter, *chapters = _chapters(reviewed, headline, flights, pictures)
        group = None if chart is None else Group.side_by_side([chart], caption)
        changes = _changes_of_top(reviewed)
        if changes is not None:
            change_chapter = change_chapter._replace(groups=[])
            charts = () if chart is None else (chart,)
            caption = f"{changes.caption} {caption}".rstrip()
            group = Group(((*charts, *changes.columns[0]),), caption)
        if group is not None:
            picture = ResultPicture(group, len(summary.first_blocks))
        chapters = [change_chapter, *chapters]
    return render_document(
        " and ".join(names),
        subtitle="",
        blocks=[*summary.first_blocks, *summary.further_blocks],
        chapters=chapters,
        back=back,
        key=colour_key,
        picture=picture,
    )


def _changes_of_top(reviewed: ReviewedDifference) -> Group | None:
    """Returns the drawing of what changed for the top of the page; None if nothing did, or too much for it.

    Args:
        reviewed: comparison of both flights.
    """
    notable, _ = _notable_and_other_changes(reviewed)
    if len(notable) > MAX_CHANGES_AT_TOP:
        return None
    change_chapter = _change_chapter(reviewed)
    for group in change_chapter.groups:
        for (drawing,) in group.columns:
            assert isinstance(drawing, Plan)
            return Group(((drawing._replace(title=change_chapter.title),),), group.caption)
    return None


class _Summary(NamedTuple):
    """The top of the page in sentences and a table."""

    first_blocks: Blocks
    """The heading, lights to be watched if none is bad, and the next step, which stand above the picture."""

    further_blocks: Blocks
    """The rest of the headline, remarks, and how both flew."""


def _summary(reviewed: ReviewedDifference, headline: Sequence[Sentence]) -> _Summary:
    """Returns the top of the page: the heading, the next step, the rest of the headline, remarks, and how both flew.

    Args:
        reviewed: comparison of both flights.
        headline: the sentences that head the comparison.
    """
    blocks_of_headline = headline_in_two_sizes(reviewed, headline)
    next_step = next_step_sentences(reviewed)
    if reviewed.difference.is_of_same_flight:
        # A flight that is compared with itself needs no remarks.
        return _Summary([*blocks_of_headline, *next_step], [])
    heading_end = _end_of_first_heading(blocks_of_headline)
    watched_lights = sentences_on_further_watched_lights(reviewed.reviews, headline)
    # They may be the reason of the next step, unless that follows from a bad light in the heading.
    are_watched_lights_first = not bad_lights(reviewed.reviews)
    further_blocks: Blocks = [
        *([] if are_watched_lights_first else watched_lights),
        *_without_tabled_vibration(blocks_of_headline[heading_end:], reviewed),
        *render_section("difference_pair", motors_by_pair=reviewed.motors_by_pair),
        *identity_remarks(reviewed),
        *flight_cautions(reviewed),
        *parameter_count_sentences(reviewed, headline),
        *condition_table(reviewed),
    ]
    first_blocks: Blocks = [
        *blocks_of_headline[:heading_end],
        *(watched_lights if are_watched_lights_first else []),
        *next_step,
    ]
    return _Summary(first_blocks, further_blocks)


class _Pictures(NamedTuple):
    """The charts of both flights, of which the top of the page has one."""

    legend: Mapping[str, str]
    """Name of each side in legends."""

    series_charts: Sequence[Chart]
    """Charts of the time series of both flights."""

    motor_groups: Sequence[Group]
    """Charts of the outputs of the motors."""

    spectra: Chart
    """Spectra of the gyro; without lines where none were recorded."""

    trims: Chart
    """Relative trims of the motors; without lines where none were compared."""

    at_top: Chart | None = None
    """That of them which stands at the top of the page, and is not repeated in a chapter of few charts."""

    @property
    def mean_motor_output(self) -> Chart | None:
        """The mean motor output over time; None where it was not recorded."""
        for chart in self.series_charts:
            if chart.title == MEAN_MOTOR_OUTPUT:
                return chart
        return None


def _pictures(
    reviewed: ReviewedDifference, flights: tuple[FlightSeries | None, FlightSeries | None]
) -> _Pictures:
    """Returns the charts of both flights, each of which has the lines of A and of B.

    Args:
        reviewed: comparison of both flights.
        flights: time series of flight A and of flight B; None where they were not stored with the flight.
    """
    # Each side is only called "A" or "B". Names of files and dates stand at the top, and would fill each legend.
    legend = {side: side for side in SIDE_COLOURS}
    series_charts = list(_series_charts(flights, legend))
    return _Pictures(
        legend,
        series_charts=series_charts,
        motor_groups=_motor_groups(reviewed, _stored_series(flights), series_charts),
        spectra=_spectrum_chart(reviewed.reviews, legend),
        trims=_trim_chart(legend, reviewed.difference, reviewed.reviews),
    )


def _stored_series(
    flights: tuple[FlightSeries | None, FlightSeries | None],
) -> dict[str, FlightSeries]:
    """Returns the time series of the two flights by side, "A" and "B"; a flight without stored ones is left out.

    Args:
        flights: time series of flight A and of flight B; None where they were not stored with the flight.
    """
    series_by_side = {}
    for side, series in zip(SIDE_COLOURS, flights, strict=True):
        if series is not None:
            series_by_side[side] = series
    return series_by_side


def _main_chart(reviewed: ReviewedDifference, pictures: _Pictures) -> Chart | None:
    """Returns the one chart at the top of the page, which shows what the heading states; None without a fitting one.

    Args:
        reviewed: comparison of both flights.
        pictures: their charts. One with a line of a single flight does not fit, since it compares nothing.
    """
    for chart in _candidates_for_main_chart(reviewed, pictures):
        if len(chart.lines) > 1:
            return chart
    return None


def _candidates_for_main_chart(
    reviewed: ReviewedDifference, pictures: _Pictures
) -> Iterator[Chart]:
    """Yields the charts that may show what the heading of the page states, the best first.

    1. What the first bad light is about, such as the lean in wind that carried the vehicle away.
    2. The output of the motor with the worst warning, if the light of the motors warns, unless both flights have it and
       the loops changed.
    3. The trims, if those of a motor changed, or of fleets.
    4. A step response of an axis whose gains or margins changed, and then the spectra of the gyro.
    5. The spectra, if a flight oscillates, and the trims, if the motors are judged differently otherwise.
    6. The mean motor output, and then the spectra, unless loops changed: the drawing of changes shows these.

    Spectra up to very different frequencies do not fit.

    Args:
        reviewed: comparison of both flights.
        pictures: their charts.
    """
    for light in bad_lights(reviewed.reviews)[:1]:
        yield from _charts_of_light(light.name, pictures.series_charts)
    changed_axes = _axes_with_loop_changes(reviewed.difference)
    has_warning = _warns_of_motors(reviewed.reviews)
    if reviewed.motors.differs or (has_warning and not changed_axes):
        title_of_worst_motor = _title_of_worst_motor(reviewed)
        for group in pictures.motor_groups:
            for (chart,) in group.columns:
                if isinstance(chart, Chart) and chart.title == title_of_worst_motor:
                    yield chart
    if _has_changed_motor(reviewed.difference) or reviewed.fleet_sides:
        yield pictures.trims
    for axis in AXES:
        if axis in changed_axes:
            yield from _step_charts_of_worst_loop(reviewed.reviews, pictures.legend, axis)
    if (changed_axes or _oscillates(reviewed.reviews)) and _have_common_range(pictures.spectra):
        yield pictures.spectra
    if reviewed.motors.differs:
        yield pictures.trims
    if changed_axes:
        return
    if pictures.mean_motor_output is not None:
        yield pictures.mean_motor_output
    if _have_common_range(pictures.spectra):
        yield pictures.spectra


def _charts_of_light(name: str, series_charts: Sequence[Chart]) -> list[Chart]:
    """Returns the charts over time that show what a light judges, that with the largest range first.

    Args:
        name: name of the light, such as "wind"; motors and margins have charts of their own.
        series_charts: charts of the time series of both flights.
    """

    def largest_range(chart: Chart) -> float:
        """Returns the largest difference of two values of a line."""
        return max(float(np.ptp(line.y)) for line in chart.lines)

    titles = TITLES_OF_LIGHTS.get(name, ())
    charts = [chart for chart in series_charts if chart.title in titles]
    return sorted(charts, key=largest_range, reverse=True)


def _step_charts_of_worst_loop(
    reviews_by_side: Reviews, legend: Mapping[str, str], axis: str
) -> list[Chart]:
    """Returns the charts of the step responses of an axis, that of the loop first whose margins are bad in a flight.

    Args:
        reviews_by_side: review documents of both flights, by side.
        legend: name of each side in legends.
        axis: "roll", "pitch" or "yaw".
    """
    charts = list(_step_charts(reviews_by_side, legend, axis))
    for review in reviews_by_side.values():
        light = value_at(review, "lights.margins") or {}
        is_of_attitude = light.get("level") == Level.BAD and light.get("subject") == "attitude"
        if is_of_attitude and value_at(light, "figures.axis") == axis:
            return charts[::-1]
    return charts


def _have_common_range(spectra: Chart) -> bool:
    """Returns whether the spectra of a chart end within an octave of each other, so that one shows what the other does.

    Args:
        spectra: chart with a line for each flight with a spectrum.
    """
    ends = [line.x[-1] for line in spectra.lines]
    return len(ends) > 1 and max(ends) <= 2 * min(ends)


def _warns_of_motors(reviews_by_side: Reviews) -> bool:
    """Returns whether the light of the motors warns in a flight. An event, such as a limit at touch-down, is none."""
    for review in reviews_by_side.values():
        if value_at(review, f"lights.{Light.MOTORS}.level") in WARNING_COLOURS:
            return True
    return False


def _oscillates(reviews_by_side: Reviews) -> bool:
    """Returns whether a vehicle oscillates in one of the flights, by the light of its margins."""
    for review in reviews_by_side.values():
        if value_at(review, "lights.margins.code") == MarginsLight.OSCILLATES:
            return True
    return False


def _axes_with_loop_changes(difference: VehicleDifference) -> set[str]:
    """Returns the axes, such as "roll", of whose loops a gain, a filter or a compared figure changed."""
    axes = set(difference.axes_with_changed_loops)
    for change in difference.changes_with(QuantityOutcome.CHANGED):
        if change.quantity.kind in LOOP_KINDS:
            axes.add(change.quantity.axis)
    return axes


def _end_of_first_heading(blocks: Sequence[Block]) -> int:
    """Returns the number of blocks up to the first heading, including it and a table with its remarks.

    If there is no heading, all blocks count.
    """
    for count, block in enumerate(blocks, start=1):
        # A sentence without text, which has a lead alone, is a heading.
        is_heading = isinstance(block, Sentence) and not block.text
        if is_heading:
            return count + _length_of_table_with_remarks(blocks[count:])
    return len(blocks)


def _length_of_table_with_remarks(blocks: Sequence[Block]) -> int:
    """Returns the number of blocks of a table at the beginning and of the sentences without a lead that follow it."""
    if not blocks or not isinstance(blocks[0], Table):
        return 0
    for count, block in enumerate(blocks[1:], start=1):
        is_remark = isinstance(block, Sentence) and not block.lead
        if not is_remark:
            return count
    return len(blocks)


def _without_tabled_vibration(blocks: Sequence[Block], reviewed: ReviewedDifference) -> Blocks:
    """Returns the sentences of the headline without the figures of vibration that the table beside them has.

    Args:
        blocks: sentences of the headline, and the table of gains.
        reviewed: comparison of both flights. Of flights with clipped samples the sentence says more than the table.
    """
    lights = lights_of_both(reviewed.reviews).get(Light.VIBRATION)
    if lights is None or not vibrations_of_same_imu(lights):
        return [*blocks]
    if any(value_at(light, "figures.clips") for light in lights.values()):
        return [*blocks]
    levels = ", ".join(f"{light['level']} in {side}" for side, light in lights.items())
    watched_lights = sentences_on_watched_lights(reviewed.reviews)
    shortened_blocks = Blocks()
    for block in blocks:
        if isinstance(block, Table):
            shortened_blocks.append(block)
            continue
        # Below a heading with the levels it has the figures alone.
        if block.text == f"{vibration_changes(lights)}.":
            continue
        if block in watched_lights and block.lead == f"{Light.VIBRATION.capitalize()}:":
            block = block._replace(text=f"{levels}; the table has the figures.")
        shortened_blocks.append(block)
    return shortened_blocks


def _chapters(
    reviewed: ReviewedDifference,
    headline: Sequence[Sentence],
    flights: tuple[FlightSeries | None, FlightSeries | None],
    pictures: _Pictures,
) -> list[Chapter]:
    """Returns the chapters of the page in their order: first what changed, last what does not differ.

    A phone opens only the list of changes: the top of the page has one chart already.

    Args:
        reviewed: comparison of both flights.
        headline: the sentences at the head of the comparison, which the chapters do not repeat.
        flights: time series of flight A and of flight B; None where they were not stored with the flight.
        pictures: the charts of both flights.
    """
    series_chapter = _series_chapter(flights, pictures.series_charts)._replace(
        folded=not _do_lights_over_time_differ(reviewed)
    )
    chapters_by_difference = _chapters_by_difference(reviewed, pictures)
    closed_chapters = [
        *chapters_by_difference.different,
        _overview_chapter(reviewed, pictures),
        series_chapter,
        _light_chapter(reviewed, headline),
    ]
    return [
        _change_chapter(reviewed),
        *[chapter._replace(is_closed_on_phone=True) for chapter in closed_chapters],
        _unchanged_chapter(reviewed),
        *chapters_by_difference.alike,
        _autopilot_parameter_chapter(reviewed),
        _single_side_chapter(pictures.series_charts),
        _chapter_in_words(reviewed, headline),
    ]


class _ChaptersByDifference(NamedTuple):
    """The chapters on gains, motors and loops, by whether the flights differ in these."""

    different: list[Chapter]
    """Chapters on what differs, open: they come first on the page."""

    alike: list[Chapter]
    """The other ones, mostly folded: they come last."""


def _chapters_by_difference(
    reviewed: ReviewedDifference, pictures: _Pictures
) -> _ChaptersByDifference:
    """Returns the chapters on gains, motors, step responses, margins and parameters, those on differences first.

    Args:
        reviewed: comparison of both flights.
        pictures: the charts of both flights.
    """
    different = []
    alike = []
    parameter_chapters = _parameter_chapters(reviewed)
    if reviewed.difference.axes_with_changed_loops and not parameter_chapters[0].folded:
        gain_chapter, *parameter_chapters = parameter_chapters
        different.append(gain_chapter)
    motor_chapter = _motor_chapter(reviewed, pictures)
    # The chapter of the motors has a table if a flight has a warning of a single motor.
    has_motor_warning = bool(motor_chapter.blocks)
    do_motors_differ = has_motor_warning or _has_changed_motor(reviewed.difference)
    if do_motors_differ:
        different.append(motor_chapter)
    step_chapter = _step_chapter(reviewed, pictures.legend)
    if _has_changed_loop_or_gains(reviewed) and _has_chart_of_both(step_chapter):
        different.append(step_chapter)
    else:
        alike.append(step_chapter._replace(folded=True))
    if not do_motors_differ:
        alike.append(motor_chapter._replace(folded=True))
    margins = _margin_chapter(reviewed.reviews)
    if not _has_changed_loop(reviewed.difference):
        margins = margins._replace(folded=True)
    alike.append(margins)
    return _ChaptersByDifference(different, alike=[*alike, *parameter_chapters])


def _has_chart_of_both(chapter: Chapter) -> bool:
    """Returns whether a chart of a chapter has lines of both flights: those of one alone compare nothing."""
    for group in chapter.groups:
        for column in group.columns:
            if any(isinstance(panel, Chart) and len(panel.lines) > 1 for panel in column):
                return True
    return False


def _chapter_in_words(reviewed: ReviewedDifference, headline: Sequence[Sentence]) -> Chapter:
    """Returns the folded chapter with the whole comparison in sentences, without those that stand above it.

    Args:
        reviewed: comparison of both flights.
        headline: the sentences that head the comparison.
    """
    stated_above = parameter_count_sentences(reviewed, headline)
    sentences = []
    for sentence in difference_blocks(reviewed, headline):
        if sentence not in stated_above:
            sentences.append(sentence)
    return Chapter("In words", sentences, folded=True)


def _has_changed_motor(difference: VehicleDifference) -> bool:
    """Returns whether a compared figure of a motor changed."""
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    return any(
        change.quantity.is_of_motor and not change.is_explained_by_lean for change in changes
    )


def _has_changed_loop_or_gains(reviewed: ReviewedDifference) -> bool:
    """Returns whether the control loops of two flights differ: a compared figure of a loop changed, or gains did.

    Args:
        reviewed: comparison of both flights, which knows the axes with other gains.
    """
    return _has_changed_loop(reviewed.difference) or bool(
        reviewed.difference.axes_with_changed_loops
    )


def _has_changed_loop(difference: VehicleDifference) -> bool:
    """Returns whether a compared figure of a loop, such as a margin, changed."""
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    return any(change.quantity.kind in LOOP_KINDS for change in changes)


def _do_lights_over_time_differ(reviewed: ReviewedDifference) -> bool:
    """Returns whether both flights differ in a light that charts over time can explain: tracking or power.

    Args:
        reviewed: comparison of both flights, with their reviews.
    """
    lights = lights_of_both(reviewed.reviews)
    lights_over_time = [lights[name] for name in LIGHTS_OVER_TIME if name in lights]
    return any(not lights_are_equal(*by_side.values()) for by_side in lights_over_time)


def _motor_chapter(reviewed: ReviewedDifference, pictures: _Pictures) -> Chapter:
    """Returns the chapter on the motors: their outputs and trims in both flights, and what each flight warns of.

    Args:
        reviewed: comparison of both flights.
        pictures: their charts.
    """
    groups = list(pictures.motor_groups)
    tables = motor_table(reviewed.reviews, reviewed.difference)
    # Equal trims need no chart beside the table that states how little they differ.
    has_use = not tables or bool(reviewed.fleet_sides) or _has_notable_trim(reviewed)
    if has_use and pictures.trims is not pictures.at_top:
        groups += _chart_group(pictures.trims, _trims_caption(reviewed))
    return Chapter("Motors", tables, groups)


def _trims_caption(reviewed: ReviewedDifference) -> str:
    """Returns what stands below the chart of trims.

    Args:
        reviewed: comparison of both flights, or fleets, whose single flights have dots.
    """
    if _has_trim_columns(reviewed.difference):
        return TRIMS_CAPTION + FLIGHT_DOTS_CAPTION
    return TRIMS_CAPTION


def _has_notable_trim(reviewed: ReviewedDifference) -> bool:
    """Returns whether a motor's trim changed, or may have changed."""
    notable, _ = _notable_and_other_changes(reviewed)
    return any(change.quantity.kind == SHARE for change in notable)


def _step_chapter(reviewed: ReviewedDifference, legend: Mapping[str, str]) -> Chapter:
    """Returns the chapter on step responses: how the rate and the attitude follow a step of their setpoint.

    Each axis has a column of charts: its rate loop, and below it its attitude loop. A chart shows the responses that
    were measured in both flights. Axes without a measured response have no column; the chapter is empty if no axis has
    one.

    Args:
        reviewed: comparison of both flights, with the review documents of their logs.
        legend: name of each side in legends.
    """
    charts_by_axis = {}
    for axis in AXES:
        charts = list(_step_charts(reviewed.reviews, legend, axis))
        if charts:
            charts_by_axis[axis] = charts
    if not charts_by_axis:
        return Chapter("Step response")
    return Chapter(
        "Step response",
        # Of a fleet no steps are drawn, which a sentence says.
        [
            *_missing_step_sentences(reviewed.reviews),
            *render_section("difference_fleet_steps", sides=reviewed.fleet_sides),
        ],
        [Group.of_axes(charts_by_axis)],
    )


def _missing_step_sentences(reviews_by_side: Reviews) -> list[Sentence]:
    """Returns why step responses were measured in one flight of a comparison and not in the other one.

    Args:
        reviews_by_side: review documents of both flights, by side, "A" and "B".

    Returns:
        For each flight that lacks responses of the other one, all reasons in one text under "Not measured in A:".
    """
    sentences = []
    for side in reviews_by_side:
        reasons = _reasons_for_missing_steps(reviews_by_side, side)
        if reasons:
            sentences.append(Sentence(" ".join(reasons), f"Not measured in {side}:"))
    return sentences


def _reasons_for_missing_steps(reviews_by_side: Reviews, side: str) -> list[str]:
    """Returns why one flight of a comparison lacks step responses that were measured in the other one.

    A reason that is the same on several axes, such as a log that is too slow, is stated once and names all of them.

    Args:
        reviews_by_side: review documents of both logs, by side, "A" and "B".
        side: the side whose missing responses are explained.
    """
    axes_by_reason = dict[_MissingStepReason, list[str]]()
    for axis, loop_name in product(AXES, LOOP_NAMES):
        responses = {
            each_side: value_at(review, f"axes.{axis}.{loop_name}") or {}
            for each_side, review in reviews_by_side.items()
        }
        is_measured_anywhere = any(response.get("measured") for response in responses.values())
        if responses[side].get("measured") or not is_measured_anywhere:
            continue
        for fact in responses[side].get("facts") or ():
            reason = _MissingStepReason.from_fact(fact, axis, loop_name)
            axes_by_reason.setdefault(reason, []).append(axis)
    return [reason.text(axes) for reason, axes in axes_by_reason.items()]


class _MissingStepReason(NamedTuple):
    """Why a step response was not measured, without the axis: the same reason on two axes is equal, and stated once."""

    sentence: str
    """The reason; ``SUBJECT_PLACEHOLDER`` stands where it names its subject, a loop of an axis such as "roll rate"."""

    loop_of_subject: str
    """Name of that loop, "rate" or "attitude"; empty if the reason has no such subject."""

    @classmethod
    def from_fact(cls, fact: JsonValues, axis: str, loop_name: str) -> Self:
        """Makes the reason from a fact of a review; a placeholder replaces the loop that its sentence is about.

        In "The roll rate is logged too slowly." it replaces "roll rate", so that the same reason on pitch is equal.

        Args:
            fact: a finding of a review document: its sentence and, if it is about one loop, the subject of the
                sentence, such as "roll rate".
            axis: axis of the missing step response, "roll", "pitch" or "yaw".
            loop_name: loop of the missing step response, "rate" or "attitude".
        """
        loop_of_axis = f"{axis} {loop_name}"
        if fact.get("subject") != loop_of_axis:
            return cls(fact["sentence"], "")
        # The axis alone cannot be replaced: words such as "controller" contain its name.
        sentence = fact["sentence"].replace(loop_of_axis, SUBJECT_PLACEHOLDER)
        return cls(sentence, loop_name)

    def text(self, axes: Sequence[str]) -> str:
        """Returns the reason for some axes, as in "The roll and pitch rate is logged too slowly."."""
        return self.sentence.replace(SUBJECT_PLACEHOLDER, f"{listed(axes)} {self.loop_of_subject}")


def _light_chapter(reviewed: ReviewedDifference, headline: Sequence[Sentence]) -> Chapter:
    """Returns the chapter "Lights of both": how each flight was judged by its own log.

    It has the status lights of both flights, each the judgement of one subject, such as the motors, and then the
    headline of each flight, which states the most urgent of them. A headline that the reader has seen already, at the
    head of the comparison or as the reason for a light, is left out.

    Args:
        reviewed: comparison of both flights, with their reviews.
        headline: the sentences that head the comparison.
    """
    watched_lights = sentences_on_further_watched_lights(reviewed.reviews, headline)
    texts_of_comparison = [sentence.text for sentence in (*headline, *watched_lights)]
    blocks = light_blocks(reviewed.reviews, " ".join(texts_of_comparison))
    # A flight that is compared with itself has one headline, which says nothing about a difference.
    if not reviewed.difference.is_of_same_flight:
        headlines = {}
        for side, review in reviewed.reviews.items():
            headlines[side] = value_at(review, "headline.sentence")
        reasons_of_lights = _reasons_in_tables(blocks)
        blocks += headline_blocks(headlines, [*texts_of_comparison, *reasons_of_lights])
    return Chapter("Lights of both", blocks)


def _reasons_in_tables(blocks: Blocks) -> list[str]:
    """Returns the texts that stand in the cells of tables as reasons for a level, such as why a light is bad.

    Args:
        blocks: sentences and tables of a chapter.
    """
    reasons = []
    for block in blocks:
        if not isinstance(block, Table):
            continue
        for row in block.rows:
            reasons += [cell.reason for cell in row if isinstance(cell, Rated)]
    return reasons


def _change_chapter(reviewed: ReviewedDifference) -> Chapter:
    """Returns the chapter with the drawing of what changed between the flights; empty where nothing did.

    Where nothing could be compared, it is closed, and sentences say why.

    Args:
        reviewed: comparison of both flights.
    """
    difference = reviewed.difference
    if not difference.changes:
        return Chapter("Not compared", sentences_on_missing_quantities(difference), folded=True)
    notable, _ = _notable_and_other_changes(reviewed)
    is_certain = bool(difference.changes_with(QuantityOutcome.CHANGED))
    changed = "differs" if reviewed.are_two_vehicles else "changed"
    may_have_changed = "may differ" if reviewed.are_two_vehicles else "may have changed"
    title = f"What {changed if is_certain else may_have_changed}"
    # Two vehicles differ in much, none of which is a change of either.
    return Chapter(
        title,
        groups=_change_groups(reviewed, notable),
        is_closed_on_phone=reviewed.are_two_vehicles,
    )


def _unchanged_chapter(reviewed: ReviewedDifference) -> Chapter:
    """Returns the closed chapter on the figures of which no change was found; empty without any.

    It has the drawing of those that are too uncertain to tell, how large a change may have been missed, and the names
    of those that stayed the same.

    Args:
        reviewed: comparison of both flights.
    """
    difference = reviewed.difference
    notable, drawn_others = _notable_and_other_changes(reviewed)
    unchanged = []
    uncertain_count = 0
    for change in difference.changes:
        if change not in notable and not reviewed.motors.covers(change):
            unchanged.append(change)
            uncertain_count += change.outcome is QuantityOutcome.UNCERTAIN
    same = [change for change in unchanged if change not in drawn_others]
    found = "difference" if reviewed.are_two_vehicles else "change"
    title = f"No {found} found: {counted(len(unchanged), 'figure')}"
    if uncertain_count:
        title += f", {uncertain_count} too uncertain to tell"
    blocks = [*explained_bounds(reviewed), *unchanged_quantity_sentences(same)]
    return Chapter(title, blocks, _change_groups(reviewed, drawn_others), folded=True)


class _DrawnChanges(NamedTuple):
    """The drawn changes, by whether the page shows them at once."""

    notable: list[QuantityChange]
    """Those that are shown at once: something changed, or may have."""

    others: list[QuantityChange]
    """Those that are shown when asked for."""


def _notable_and_other_changes(reviewed: ReviewedDifference) -> _DrawnChanges:
    """Parts the drawn changes into those that the page shows at once, and those that it shows when asked for.

    Notable are changes that are certain, doubtful ones, whose own interval excludes "no change", and those that agree
    with a weak motor. Beside the trim of a motor those of the others are drawn too, if they are few. More changes would
    push all else from the screen, and without a notable one the others show nothing but "no change".

    Args:
        reviewed: comparison of both flights.
    """
    changes = drawn_changes(reviewed.difference)
    notable = []
    others = []
    for change in changes:
        is_certain = change.outcome is QuantityOutcome.CHANGED
        if is_certain or change.is_doubtful or change in reviewed.motors.evidence:
            notable.append(change)
        else:
            others.append(change)
    if not any(change.quantity.kind == SHARE for change in notable):
        return _DrawnChanges(notable, others)
    other_trims = [change for change in others if change.quantity.kind == SHARE]
    if len(notable) + len(other_trims) > MAX_CHANGES_AT_TOP:
        return _DrawnChanges(notable, others)
    remaining = [change for change in others if change not in other_trims]
    return _DrawnChanges([*notable, *other_trims], remaining)


def _change_groups(reviewed: ReviewedDifference, changes: Sequence[QuantityChange]) -> list[Group]:
    """Returns the drawing of some changes with its caption; empty without a change.

    Args:
        reviewed: comparison of both flights.
        changes: the changes to draw.
    """
    evidence = reviewed.motors.evidence
    drawing = change_plan(
        reviewed.difference,
        evidence,
        are_two_vehicles=reviewed.are_two_vehicles,
        changes=changes,
    )
    if drawing is None:
        return []
    return [Group.side_by_side([drawing], _changes_caption(changes, evidence))]


def _changes_caption(
    changes: Sequence[QuantityChange], evidence: Collection[QuantityChange]
) -> str:
    """Returns the caption of the drawing of changes, with a legend of the shapes that occur in it.

    A change has a shape for its outcome: a square for "changed", a ring for "uncertain", a dot for "the same".
    An uncertain change that agrees with a weak motor has a diamond instead of the ring.

    Args:
        changes: the drawn changes.
        evidence: changes that agree with the motor that the headline names as weak, certain or not.
    """
    outcomes = set()
    has_diamond = False
    for change in changes:
        if is_uncertain_sign_of_weak_motor(change, evidence):
            has_diamond = True
        else:
            outcomes.add(change.outcome)
    caption = CHANGES_CAPTION
    for outcome, meaning_of_shape in OUTCOME_CAPTIONS.items():
        if outcome in outcomes:
            caption += meaning_of_shape
    if has_diamond:
        caption += EVIDENCE_CAPTION
    return caption


def _series_charts(
    flights: tuple[FlightSeries | None, FlightSeries | None], legend: Mapping[str, str]
) -> Iterator[Chart]:
    """Yields a chart of each recorded quantity over time, such as roll, with the lines of both flights in it.

    Args:
        flights: time series of flight A and of flight B; None where they were not stored with the flight.
        legend: name of each side, "A" and "B", in legends.
    """
    for chart in flight_series_charts(_stored_series(flights), legend, SIDE_COLOURS):
        yield _with_single_side(chart)


def _overview_chapter(reviewed: ReviewedDifference, pictures: _Pictures) -> Chapter:
    """Returns the chapter with a row of pictures: spectra of the gyro, vibration and mean motor output.

    Each picture shows both flights; if only one of them has the quantity, its title says which one. A quantity that was
    not recorded in either has no picture, nor has the one at the top of the page.

    Args:
        reviewed: comparison of both flights, with the review documents of their logs.
        pictures: their charts.

    Returns:
        The chapter, with a remark on a side that is a fleet, of which nothing is drawn; empty without a picture.
    """
    charts = []
    if pictures.spectra.lines and pictures.spectra is not pictures.at_top:
        charts.append(_with_single_side(pictures.spectra))
    charts_by_title = {chart.title: chart for chart in pictures.series_charts}
    for title in _overview_titles(pictures.series_charts):
        if title in charts_by_title and charts_by_title[title] is not pictures.at_top:
            charts.append(charts_by_title[title])
    title = "Both flights"
    if not charts:
        return Chapter(title)
    remarks = render_section("difference_fleet_series", sides=reviewed.fleet_sides)
    return Chapter(title, remarks, [Group.side_by_side(charts)])


def _overview_titles(series_charts: Sequence[Chart]) -> list[str]:
    """Returns the titles of the time series in the row of pictures at the top of the page.

    They are what rotors and load change in flights that are flown alike: the vibration, of the IMU that vibrates most
    in one of both flights, and the mean motor output.

    Args:
        series_charts: charts of the time series of both flights.
    """
    largest_vibrations = {}
    for chart in series_charts:
        if chart.title in VIBRATIONS:
            largest_vibrations[chart.title] = max(float(np.mean(line.y)) for line in chart.lines)
    if not largest_vibrations:
        return [MEAN_MOTOR_OUTPUT]
    return [max(largest_vibrations, key=largest_vibrations.__getitem__), MEAN_MOTOR_OUTPUT]


def _motor_groups(
    reviewed: ReviewedDifference,
    flights_by_side: Mapping[str, FlightSeries],
    series_charts: Sequence[Chart],
) -> list[Group]:
    """Returns the charts of the outputs of the motors in both flights, with a line where a motor began to warn.

    Args:
        reviewed: comparison of both flights, with their reviews.
        flights_by_side: time series of the flights, by side, "A" and "B".
        series_charts: charts of these.

    Returns:
        A group in rows of ``CHARTS_IN_ROW``, of which a phone opens the motor of the worst warning alone; empty without
        such charts.
    """
    marks_by_title = _marks_by_motor_chart(reviewed, flights_by_side)
    charts = []
    for chart in series_charts:
        if chart.title in MOTOR_OUTPUTS:
            chart = chart._replace(marks=tuple(marks_by_title.get(chart.title, ())))
            charts.append(_with_room_above(chart) if marks_by_title else chart)
    if not charts:
        return []
    caption = _motors_caption(flights_by_side, has_marks=bool(marks_by_title))
    group = Group.side_by_side(charts, caption)._replace(is_flat=True, columns_in_row=CHARTS_IN_ROW)
    title_of_worst_motor = _title_of_worst_motor(reviewed)
    if title_of_worst_motor:
        group = group.folded_by_title()._replace(first=title_of_worst_motor)
    return [group]


def _title_of_worst_motor(reviewed: ReviewedDifference) -> str:
    """Returns the title of the chart of the motor that has the worst warning in both flights; empty without any.

    Args:
        reviewed: comparison of both flights, with their reviews.
    """
    for level in WARNING_COLOURS:
        for side in SIDE_COLOURS:
            for motor, warning in motor_warnings(reviewed.reviews.get(side, {})).items():
                if warning["level"] == level and motor <= MAX_MOTORS:
                    return MOTOR_OUTPUTS[motor - 1]
    return ""


def _with_room_above(chart: Chart) -> Chart:
    """Returns a chart with ``MARK_ROOM`` above its lines, for the names of marks."""
    if chart.y.limits is None:
        return chart
    low, high = chart.y.limits
    if low is None or high is None:
        return chart
    limits = (low, high + MARK_ROOM * (high - low))
    return chart._replace(y=chart.y._replace(limits=limits))


def _marks_by_motor_chart(
    reviewed: ReviewedDifference, flights_by_side: Mapping[str, FlightSeries]
) -> dict[str, list[Mark]]:
    """Returns lines at the times of the worst warning about each motor, by the title of the motor's chart.

    Args:
        reviewed: comparison of both flights, with their reviews, whose times are on the boot clock.
        flights_by_side: time series of the flights, whose times are in the air.

    Returns:
        Lines with the side and the time on both clocks: sentences and tables state that since boot, and the axis of the
        charts begins at take-off. First come motors with a bad level. Warnings without a time in the flight have none.
    """
    marks_by_title = defaultdict[str, list[Mark]](list)
    for level, colour in WARNING_COLOURS.items():
        for side, series in flights_by_side.items():
            for motor, warning in motor_warnings(reviewed.reviews.get(side, {})).items():
                if warning["level"] != level or motor > MAX_MOTORS:
                    continue
                mark = _mark_of_warning(warning, side, series, colour)
                if mark is not None:
                    marks_by_title[MOTOR_OUTPUTS[motor - 1]].append(mark)
    return marks_by_title


def _mark_of_warning(
    warning: JsonValues, side: str, series: FlightSeries, colour: str
) -> Mark | None:
    """Returns a line at the time when a warning began, named for example "B: 92 s since boot, 40 s in the air".

    Args:
        warning: the warning, as the review document of the flight has it.
        side: side of the flight, "A" or "B".
        series: time series of the flight, whose times are in the air.
        colour: colour of the line.

    Returns:
        The line; None if the warning has no time, or one outside of the flight.
    """
    boot_time = warning.get("time")
    if boot_time is None:
        return None
    time = time_in_flight(series, boot_time, value_at(warning, "figures.boot") or 0)
    if time is None:
        return None
    name = f"{side}: {boot_time:.0f} s since boot, {time:.0f} s in the air"
    return Mark(time, name, colour)


def _motors_caption(flights_by_side: Mapping[str, FlightSeries], *, has_marks: bool) -> str:
    """Returns what stands below the charts of the motors' outputs, with when they begin on the boot clocks if known.

    Args:
        flights_by_side: time series of the flights, by side, "A" and "B".
        has_marks: whether a warning about a motor is marked.
    """
    starts = []
    for side, series in flights_by_side.items():
        start = start_on_boot_clock(series)
        if start is not None:
            starts.append(f"{start:.0f} s in {side}")
    starts_text = f" ({listed(starts)}, since boot)" if starts else ""
    return (
        f"Means over {MEAN_SECONDS:g} s on one scale, from take-off{starts_text} or the beginning of the log. Take-off "
        f"and landing may leave a plot.{' A dashed line marks a warning about the motor.' if has_marks else ''}"
    )


def _paired_groups(charts: Sequence[Chart], caption: str = "") -> list[Group]:
    """Returns low charts in rows of ``CHARTS_IN_ROW``, with a caption below the last row.

    Args:
        charts: charts in the order of reading.
        caption: what stands below them; empty for nothing.
    """
    rows = []
    for first in range(0, len(charts), CHARTS_IN_ROW):
        row = Group.side_by_side(charts[first : first + CHARTS_IN_ROW])
        rows.append(row._replace(is_flat=True))
    if rows:
        rows[-1] = rows[-1]._replace(caption=caption)
    return rows


def _series_chapter(
    flights: tuple[FlightSeries | None, FlightSeries | None], series_charts: Sequence[Chart]
) -> Chapter:
    """Returns the chapter with the charts over time that are in no other part of the page.

    The overview at the top of the page has some of the charts, and the chapter of the motors those of their outputs.
    The others that both flights have stand here in pairs, such as roll beside pitch. A sentence above them
    names each side whose time series were not stored, so that its lines are missing.

    Args:
        flights: time series of flight A and of flight B; None where they were not stored with the flight.
        series_charts: all charts of the time series of both flights.
    """
    sides_without_series = []
    for side, series in zip(STATE_NAMES, flights, strict=True):
        if series is None:
            sides_without_series.append(side)
    remarks = render_section("difference_series", lacking=sides_without_series)
    charts = []
    for chart in _further_charts(series_charts):
        if len(chart.lines) > 1:
            charts.append(chart)
    return Chapter("Attitude, tracking and more over time", remarks, _paired_groups(charts))


def _single_side_chapter(series_charts: Sequence[Chart]) -> Chapter:
    """Returns a folded chapter with the charts over time of what only one flight has recorded: they compare nothing.

    Args:
        series_charts: all charts of the time series of both flights.
    """
    charts = [chart for chart in _further_charts(series_charts) if len(chart.lines) == 1]
    return Chapter("In one flight only", (), _paired_groups(charts), folded=True)


def _further_charts(series_charts: Sequence[Chart]) -> list[Chart]:
    """Returns the charts over time that stand neither at the top of the page nor in the chapter of the motors.

    Args:
        series_charts: all charts of the time series of both flights.
    """
    # The title of a chart of one side also names that side.
    titles_elsewhere = (*_overview_titles(series_charts), *MOTOR_OUTPUTS)
    return [chart for chart in series_charts if chart.title not in titles_elsewhere]


def _parameter_chapters(reviewed: ReviewedDifference) -> list[Chapter]:
    """Returns the chapters on the autopilot's parameters that changed: gains and filters, then all others.

    Args:
        reviewed: comparison of both flights, with the changed parameters.

    Returns:
        A chapter with the gains and filters of the loops, those of an axis together, and a second one with the others,
        folded where they are many, or where the table at the top of the page has all gains. Few parameters, and those
        without a gain, share one chapter, which may be empty.
    """
    changed_count = len(reviewed.parameters)
    listed_parameters = sorted(reviewed.parameters, key=_axis_number)[:MAX_LISTED_PARAMETERS]
    title = "Parameters"
    header = f"{changed_count} of {counted(reviewed.common_parameter_count, 'parameter')} changed"
    if changed_count > len(listed_parameters):
        header += f", the first {len(listed_parameters)}"
    gains = [parameter for parameter in listed_parameters if _is_of_control(parameter)]
    gains_at_top = tabled_gains(reviewed)
    are_stated_above = bool(gains) and all(gain in gains_at_top for gain in gains)
    rows = parameter_rows(listed_parameters, has_percentages=bool(gains))
    if not gains or len(rows) <= MAX_OPEN_ROWS:
        chapter = _folded_if_long(_table_chapter(title, header, rows), rows)
        return [chapter._replace(folded=chapter.folded or are_stated_above)]
    others = [parameter for parameter in listed_parameters if not _is_of_control(parameter)]
    rows_of_gains = parameter_rows(gains, has_percentages=True)
    other_rows = parameter_rows(others)
    other_chapter = _table_chapter("Other parameters", "beside those of control", other_rows)
    header += f", of control {len(gains)}"
    gain_chapter = _folded_if_long(_table_chapter(title, header, rows_of_gains), rows_of_gains)
    return [
        gain_chapter._replace(folded=gain_chapter.folded or are_stated_above),
        _folded_if_long(other_chapter, other_rows),
    ]


def _folded_if_long(chapter: Chapter, rows: Sequence[Sequence[str]]) -> Chapter:
    """Returns a chapter that is folded if its table has more than ``MAX_OPEN_ROWS`` rows, and else open.

    Args:
        chapter: the chapter.
        rows: rows of its table.
    """
    return chapter._replace(folded=len(rows) > MAX_OPEN_ROWS)


def _is_of_control(parameter: ParameterChange) -> bool:
    """Returns whether a parameter is one of a multirotor's control: a gain, filter or output, such as MC_ROLLRATE_P."""
    return CONTROL_PARAMETERS.match(parameter.name) is not None


def _axis_number(parameter: ParameterChange) -> int:
    """Returns the number of the axis of a gain or filter, by which parameters are sorted; others have a larger one."""
    axes = axes_of_parameter(parameter.name)
    return AXES.index(axes[0]) if _is_of_control(parameter) and axes else len(AXES)


def _autopilot_parameter_chapter(reviewed: ReviewedDifference) -> Chapter:
    """Returns the folded chapter on parameters that a calibration or the autopilot itself set; empty if there are none.

    Args:
        reviewed: comparison of both flights, with these parameters.
    """
    title = f"Calibrated, learned or counted: {len(reviewed.parameters_set_by_autopilot)}"
    rows = parameter_rows(reviewed.parameters_set_by_autopilot[:MAX_LISTED_PARAMETERS])
    return _table_chapter(title, "parameter", rows)._replace(folded=True)


def _table_chapter(title: str, header: str, rows: list[list[str]]) -> Chapter:
    """Returns a chapter with a table of figures of both flights, without rows in which no figure is known.

    Args:
        title: title of the chapter.
        header: header of the first column, which names the figures.
        rows: the name of a figure, its cells for A and B and, of all rows or of none, the change.
    """
    known_rows = []
    for row in rows:
        # The first cell is the name.
        if any(cell != UNKNOWN_FIGURE for cell in row[1:]):
            known_rows.append(row)
    if not known_rows:
        return Chapter(title)
    headers = [header, *SIDE_COLOURS, "change"]
    return Chapter(title, [Table(headers[: len(known_rows[0])], known_rows)])


def _chart_group(chart: Chart, caption: str = "") -> list[Group]:
    """Returns a group of one chart with a caption; none if the chart has no lines."""
    return [Group.side_by_side([_with_single_side(chart)], caption)] if chart.lines else []


def _with_single_side(chart: Chart) -> Chart:
    """Adds the name of the side to the title of a chart, if only one side has a line in it.

    A chart with a single line has no legend, so that nothing else would show to which side the line belongs.

    Args:
        chart: chart with a line for each side (A and B) for which the quantity is known.

    Returns:
        The chart; with two lines it is unchanged.
    """
    if len(chart.lines) != 1:
        return chart
    return chart._replace(title=f"{chart.title}, only {chart.lines[0].name}")


def _margin_chapter(reviews_by_side: Reviews) -> Chapter:
    """Returns the chapter on stability margins: a table of those of both logs, and why axes have none in one of them.

    Args:
        reviews_by_side: review documents of both logs, by side.
    """
    sides_without = _sides_without_margins(reviews_by_side)
    rows = _margin_rows(reviews_by_side)
    chapter = _folded_if_long(_table_chapter("Margins", "90 % interval", rows), rows)
    sentences = []
    for axis, side in sides_without.items():
        reason = missing_margins_reason(reviews_by_side, side, axis)
        sentences += render_section(
            "difference_missing_margins", axis=axis, side=side, reason=reason
        )
    return chapter._replace(blocks=[*chapter.blocks, *sentences])


def _sides_without_margins(reviews_by_side: Reviews) -> dict[str, str]:
    """Returns the side, "A" or "B", that has no margins of an axis, by each axis of which the other side has them."""
    sides_by_axis = {}
    for axis in AXES:
        sides_without = []
        for side, review in reviews_by_side.items():
            if not value_at(review, f"axes.{axis}.loop"):
                sides_without.append(side)
        if len(sides_without) == 1:
            [sides_by_axis[axis]] = sides_without
    return sides_by_axis


def _margin_rows(reviews_by_side: Reviews) -> list[list[str]]:
    """Returns the rows of the table of stability margins: for each axis, each figure of its rate and attitude loop.

    An axis without margins in one of the logs has no rows: they would compare nothing.

    Args:
        reviews_by_side: review documents of both logs, by side.

    Returns:
        Rows of a name, such as "roll rate: phase margin (°)", and one cell for each side.
    """
    rows = []
    incomplete_axes = _sides_without_margins(reviews_by_side)
    for axis in AXES:
        if axis in incomplete_axes:
            continue
        for loop_name, keys in MARGIN_FIGURES.items():
            path = f"axes.{axis}.loop.{loop_name}"
            loops = [value_at(review, path) or {} for review in reviews_by_side.values()]
            for key in keys:
                figure = LOOP_FIGURES[key]
                cells = [_margin_cell(loop, key, figure.scale) for loop in loops]
                rows.append([f"{axis} {loop_name}: {figure.header}", *cells])
    return rows


def _margin_cell(loop: Review, key: str, scale: float) -> str:
    """Returns a margin of a loop with its interval, such as "57 (50 to 63)"; a dash if any of it is not known.

    Args:
        loop: the loop in a review document; empty if it was not identified.
        key: key of the margin in the document, such as "phase_margin".
        scale: factor from its unit in the document to the one in which it is shown.
    """
    interval = loop.get(f"{key}_interval")
    return estimate_with_interval(loop.get(key), interval, scale) or UNKNOWN_FIGURE


def _step_charts(reviews_by_side: Reviews, legend: Mapping[str, str], axis: str) -> Iterator[Chart]:
    """Yields a chart of the step response of the rate loop and one of the attitude loop of an axis, with both flights.

    The responses and their 90 % bands are measured ones, from the review documents. A loop that neither flight has
    measured has no chart.

    Args:
        reviews_by_side: review documents of both logs, by side.
        legend: name of each side in legends.
        axis: "roll", "pitch" or "yaw".
    """
    for loop_name in LOOP_NAMES:
        lines = []
        for side, review in reviews_by_side.items():
            # Times, s, the response to a step of 1, and the half width of its band.
            response = value_at(review, f"axes.{axis}.{loop_name}.measured")
            if not response:
                continue
            time = np.array(response["time"])
            step = np.array(response["step"])
            half_width = np.array(response["step_half"])
            lines.append(Line.with_band(legend[side], SIDE_COLOURS[side], time, step, half_width))
        if lines:
            chart = step_chart(f"{axis.capitalize()} {loop_name}: step", lines)
            yield _with_single_side(chart)


def _spectrum_chart(reviews_by_side: Reviews, legend: Mapping[str, str]) -> Chart:
    """Returns a chart of the power spectral densities of the gyro in both flights, (°/s)²/Hz, the sum of three axes.

    Both are from before the filters if both logs have that, and otherwise from after them: the filters take away what
    a chart of one from before and one from after them would show as a difference. A side without any has no line.

    Args:
        reviews_by_side: review documents of both logs, by side.
        legend: name of each side in legends.
    """
    lines = []
    key = _key_of_comparable_spectra(reviews_by_side)
    for side, review in reviews_by_side.items():
        spectra = review.get("spectra") or {}
        spectrum = spectra.get(key)
        if not spectrum:
            continue
        density = np.sum(list(spectrum["density"].values()), axis=0)
        frequency = np.array(spectrum["frequency"])
        # The first frequency, 0 Hz, is the mean and no vibration.
        power = GYRO_DENSITY_UNIT.scale * np.maximum(density[1:], MIN_DENSITY)
        lines.append(Line(legend[side], SIDE_COLOURS[side], frequency[1:], power))
    power_axis = Axis(f"power ({GYRO_DENSITY_UNIT.name})", is_logarithmic=True)
    title = f"Gyro, power ({GYRO_DENSITY_UNIT.name})"
    return Chart(title, Axis("frequency (Hz)"), power_axis, tuple(lines))


def _key_of_comparable_spectra(reviews_by_side: Reviews) -> str:
    """Returns the key of the spectra of the gyro that most logs have: of before its filters, or after them.

    Args:
        reviews_by_side: review documents of both logs, by side.
    """
    counts = {}
    for key in ("gyro_before", "gyro"):
        documents = [review.get("spectra") or {} for review in reviews_by_side.values()]
        counts[key] = sum(1 for spectra in documents if spectra.get(key))
    # Of equal numbers the first counts, before the filters.
    return max(counts, key=lambda key: counts[key])


def _trim_chart(
    legend: Mapping[str, str], difference: VehicleDifference, reviews_by_side: Reviews = NO_REVIEWS
) -> Chart:
    """Returns a chart with the relative trim of each motor, %, as a dot for flight A and a dot for flight B.

    The relative trim is by how much the motor's mean output in hover exceeds that of the median motor. The step from
    one dot of a motor to the other shows the change that the text states.

    The text also states a 90 % interval of that change. It allows for more than the errors within both flights, since
    the trims of a vehicle vary from flight to flight, and depend on the lean in wind. The chart must show the same
    uncertainty. So the interval of the change is divided equally between the whiskers of the motor's two dots. Half
    widths of independent errors add by their squares, so that each whisker is 1/√2 of the change's half width.

    Args:
        legend: name of each side, "A" and "B", in legends.
        difference: comparison of both flights, quantity by quantity.
        reviews_by_side: review documents, of a fleet with the level of the motors in each flight.

    Returns:
        The chart, with motors on the horizontal axis and a line at 0; without dots if no trims were compared. Of
        several flights, each has a dot of its own beside their mean, and each motor a column for either side.
    """
    has_columns = _has_trim_columns(difference)
    # Of all compared quantities, such as margins and motor time constants, the chart has the trims ("share").
    trim_changes = [change for change in difference.changes if change.quantity.kind == SHARE]
    motor_numbers = [change.quantity.motor for change in trim_changes]
    lines: list[Line] = []
    if trim_changes:
        for side, flight_count in zip(STATE_NAMES, difference.flights, strict=True):
            name = f"{legend[side]}, mean" if flight_count > 1 else legend[side]
            lines.append(_trim_dots(side, name, trim_changes, has_columns=has_columns))
            if _has_flight_dots(flight_count):
                lines += _flight_dots(side, legend[side], trim_changes, reviews_by_side)
        if has_columns:
            lines = [*_with_common_abscissae(lines)]
    names = []
    for number in range(1, max(motor_numbers, default=0) + 1):
        names += [f"{number} {side}" for side in STATE_NAMES] if has_columns else [str(number)]
    motor_axis = Axis("motor", names=tuple(names))
    trim_axis = Axis("relative trim (%)")
    return Chart("Relative trim (%)", motor_axis, trim_axis, tuple(lines), levels=(0.0,))


def _trim_dots(
    side: str, name: str, trim_changes: Sequence[QuantityChange], *, has_columns: bool
) -> Line:
    """Returns the relative trim of each motor on a side, %, as dots with whiskers; of several flights the mean.

    Args:
        side: "A" or "B".
        name: name of the dots in the legend.
        trim_changes: the compared trims, at least one, as fractions of the median motor's output.
        has_columns: whether each motor has a column for A and one for B.
    """
    motor_numbers = [change.quantity.motor for change in trim_changes]
    # The horizontal axis counts its names from 0, and motors count from 1.
    positions = np.array(motor_numbers) - 1.0
    if has_columns:
        positions = _column_positions(side, motor_numbers) + MEAN_OFFSET
    values = [change.before if side == "A" else change.after for change in trim_changes]
    half_widths_of_changes = np.array([change.half_width for change in trim_changes])
    return Line.with_band(
        name,
        SIDE_COLOURS[side],
        positions,
        100 * np.array(values),
        100 * half_widths_of_changes / sqrt(2),
        SIDE_SHAPES[side],
    )


def _has_trim_columns(difference: VehicleDifference) -> bool:
    """Returns whether each motor has a column for A and one for B in the chart of trims, to hold dots of flights."""
    return any(_has_flight_dots(flight_count) for flight_count in difference.flights)


def _flight_dots(
    side: str, name: str, trim_changes: Sequence[QuantityChange], reviews_by_side: Reviews
) -> list[Line]:
    """Returns the relative trim of each motor in each flight of a side, %, as dots beside the mean of the motor.

    The dots of a motor are in order of date from left to right. Their colour says how its flight was judged, so that
    each judgement has a line of its own.

    Args:
        side: "A" or "B", which has a column of its own for each motor.
        name: name of the side in the legend.
        trim_changes: the compared trim of each motor, with its values in all flights as a fraction.
        reviews_by_side: review documents by side; that of a fleet has the state of the motors in each flight.
    """
    trims_of_flights = []
    for change in trim_changes:
        trims_of_flights.append(change.flights_before if side == "A" else change.flights_after)
    # Trims and positions have a row for each motor and a column for each flight.
    trims = 100 * np.array(trims_of_flights)
    flight_count = trims.shape[1]
    offsets = np.linspace(-FLIGHT_DOTS_WIDTH / 2, FLIGHT_DOTS_WIDTH / 2, flight_count)
    columns = _column_positions(side, [change.quantity.motor for change in trim_changes])
    positions = columns[:, np.newaxis] + FLIGHT_DOTS_OFFSET + offsets
    states = np.array(_motor_states(reviews_by_side.get(side, {}), flight_count))
    lines = []
    for state, colour in STATE_COLOURS.items():
        is_in_state = states == state
        if is_in_state.any():
            x = positions[:, is_in_state].ravel()
            y = trims[:, is_in_state].ravel()
            state_name = state if state == REFERENCE else f"motors {state}"
            lines.append(Line(f"{name}, {state_name}", colour, x, y, style=SIDE_SHAPES[side]))
    return lines


def _column_positions(side: str, motor_numbers: Sequence[int]) -> Array:
    """Returns the positions (motors,) of a side's columns in a chart with a column for A and one for B of each motor.

    Those of motors 1 and 2 are 0 and 2 for A, and 1 and 3 for B.

    Args:
        side: "A" or "B".
        motor_numbers: numbers of the motors, from 1 on.
    """
    return 2.0 * (np.array(motor_numbers) - 1.0) + STATE_NAMES.index(side)


def _has_flight_dots(flight_count: int) -> bool:
    """Returns whether each flight of a side has a dot: a single one is its mean, and many would hide each other."""
    return 1 < flight_count <= MAX_FLIGHT_DOTS


def _motor_states(review: Review, flight_count: int) -> list[str]:
    """Returns how the motors were judged in each flight of a side, in order of date, such as "good" or "reference".

    Args:
        review: review document of the side. If it does not judge the motors, they are unknown in all flights.
        flight_count: number of its flights.
    """
    light = lights_of_side(review).get(Light.MOTORS)
    if light is None:
        return [Level.UNKNOWN] * flight_count
    return states_in_flights(light)


def _with_common_abscissae(lines: Sequence[Line]) -> tuple[Line, ...]:
    """Gives all lines of dots of a chart the same abscissae, with NaN where a line has no dot.

    A chart resamples lines with different abscissae, which would move dots.

    Args:
        lines: lines with different abscissae, such as means at the motors and single flights beside them.

    Returns:
        The same lines, all with the same ascending abscissae.
    """
    abscissae = np.unique(np.concatenate([line.x for line in lines]))

    def extended(values: Array | None, line: Line) -> Array | None:
        """Returns the values of a line at all abscissae; None of a line without them."""
        if values is None:
            return None
        extended_values = np.full(len(abscissae), np.nan)
        extended_values[np.searchsorted(abscissae, line.x)] = values
        return extended_values

    extended_lines = []
    for line in lines:
        y = np.full(len(abscissae), np.nan)
        y[np.searchsorted(abscissae, line.x)] = line.y
        extended_lines.append(
            line._replace(
                x=abscissae,
                y=y,
                lower_edge=extended(line.lower_edge, line),
                upper_edge=extended(line.upper_edge, line),
            )
        )
    return tuple(extended_lines)
