"""Tables that compare control loops: their margins and step responses with the present and with new gains."""

from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from typing import NamedTuple

from mavdem.assessment.axis.tuning import Tuning
from mavdem.confidence import IntervalEstimate
from mavdem.facts import Fact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import LOOP_NAMES, Loop, LoopsByAxis
from mavdem.loops.identified_step import STEP_SECONDS, predicted_step
from mavdem.loops.margins import OpenLoop
from mavdem.report.blocks import Table
from mavdem.report.numbers import listed, rounded
from mavdem.report.tuning.figures import (
    LOOP_FIGURES,
    TUNED_FIGURES,
    figure_text,
    text_with_interval,
)
from mavdem.report.tuning.outcomes import has_doubtful_margins

TRIED_HEADER = "tried, not to be loaded"
"""What tables call gains that another flight is to confirm before they are loaded."""


PHONE_TITLE_OF_MARGINS = "All margins with intervals"
"""What a phone shows of the table of all margins until it is opened."""


def margin_tables(
    loops: LoopsByAxis,
    doubtful_headers: Container[str] = (),
    omitted_figures: Container[str] = (),
) -> Iterator[Table]:
    """Yields a table of the stability margins of rate loops, then one of the attitude loops around them.

    Args:
        loops: the loops to compare, by the header of their column, such as "now" and "new".
        doubtful_headers: headers of the loops that a measured response contradicts; "(doubtful)" is added to them.
        omitted_figures: names of ``LOOP_FIGURES``, such as "phase_margin", that the reader finds elsewhere.

    Yields:
        A table with a row for each of the other ``LOOP_FIGURES`` and a column for each of ``loops``.
    """
    models = [loop.model for loop in loops.values()]
    headers = _marked_headers(loops, doubtful_headers)
    for loop_name in LOOP_NAMES:
        rows = [["model of the plant", *models]]
        for figure_name, figure in LOOP_FIGURES.items():
            if figure_name in omitted_figures:
                continue
            row = [figure.header]
            for loop in loops.values():
                row.append(figure_text(loop, loop_name, figure_name))
            rows.append(row)
        yield Table([f"{loop_name} loop (90 % interval)", *headers], rows)


def _marked_headers(headers: Iterable[str], doubtful: Container[str]) -> list[str]:
    """Returns the headers of columns of loops, with "(doubtful)" after those of loops that may be wrong."""
    return [f"{header} (doubtful)" if header in doubtful else header for header in headers]


def tuned_loops_table(tuning: Tuning, axes_with_feedforward: Collection[str]) -> list[Table]:
    """Returns a table of the loops of all axes: margins, predicted step responses, and errors of the angle by wind.

    Args:
        tuning: advice for each axis, or the fact (coded finding) that says why there is none.
        axes_with_feedforward: axes whose charts show attitude steps with feed-forward; the table's are without it.

    Returns:
        A list with the table, which has a column for the present gains of each axis and, if they change, one for its
        new gains; empty if no loop is identified.
    """
    loops, doubtful_headers = loop_columns(tuning)
    if not loops:
        return []
    rows = []
    for loop_name in LOOP_NAMES:
        rows += _margin_rows(loops, loop_name)
        rows += _step_rows(loops, loop_name, axes_with_feedforward)
    if tuning.has_computed_gains:
        # The standard deviation of the angle in the wind of the flight, degrees.
        wind_errors = [rounded(loop.lean_in_wind) for loop in loops.values()]
        rows.append(["error by wind torque, sd (°)", *wind_errors])
    table = Table(["90 % interval", *_marked_headers(loops, doubtful_headers)], rows)
    narrow_tables = _tables_by_axis(table, [*loops])
    # The summary above has the margins that decide, so that a phone shows all of them only on demand.
    return [table._replace(phone_tables=narrow_tables, phone_title=PHONE_TITLE_OF_MARGINS)]


def _tables_by_axis(table: Table, headers: Iterable[str]) -> list[Table]:
    """Divides a table of the loops of several axes into one for each axis, since a phone has room for few columns.

    Args:
        table: the table, whose columns behind the first one are of one axis each.
        headers: headers of these columns without marks, such as "roll, now".

    Returns:
        The tables, one for each axis in the order of their columns.
    """
    columns_by_axis: dict[str, list[int]] = {}
    for column, header in enumerate(headers, start=1):
        axis, _, _ = header.partition(", ")
        columns_by_axis.setdefault(axis, []).append(column)
    tables = []
    for columns in columns_by_axis.values():
        rows = [[row[column] for column in (0, *columns)] for row in table.rows]
        tables.append(Table([table.header[column] for column in (0, *columns)], rows))
    return tables


class _ComparedLoops(NamedTuple):
    """The loops of several axes as the columns of a table that compares them."""

    by_header: dict[str, Loop]
    """The loops by the header of their column, such as "roll, now"."""
    doubtful_headers: set[str]
    """Headers of those whose margins may be wrong."""


def loop_columns(tuning: Tuning) -> _ComparedLoops:
    """Returns the columns of a table of control loops, such as "roll, now" and, if gains change, one with new gains.

    Args:
        tuning: advice on the gains of each axis; an axis without an identified loop gets no column.
    """
    compared = _ComparedLoops(by_header={}, doubtful_headers=set())
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact):
            continue
        for gains, loop in compared_loops(advice).items():
            gains_header = _gains_header(gains, advice, waits_for_stage_1=tuning.waits(advice))
            header = f"{axis}, {gains_header}"
            compared.by_header[header] = loop
            if has_doubtful_margins(tuning, axis):
                compared.doubtful_headers.add(header)
    return compared


def compared_loops(advice: Advice) -> dict[str, Loop]:
    """Returns the loop of one axis with the gains that flew ("now") and, if gains change, with the new ones ("new").

    The new gains are advised or, if another flight is to confirm them first, only tried.

    Args:
        advice: advice on the axis, with both loops.
    """
    loops = {"now": advice.before}
    if advice.parameters:
        loops["new"] = advice.after
    return loops


def _gains_header(gains: str, advice: Advice, *, waits_for_stage_1: bool) -> str:
    """Returns the header of a column of a table of loops: with which gains of the axis its figures were computed.

    Args:
        gains: "now" for the gains that flew, "new" for those that are computed from the identified loop.
        advice: advice on the axis, with the new gains.
        waits_for_stage_1: whether the new gains are a second stage, to be loaded only after a flight with the gains of
            the first one.

    Returns:
        "now" or, for new gains, "advised", "advised, stage 2", or ``TRIED_HEADER`` if another flight is to confirm them
        before they are loaded.
    """
    if gains == "now":
        return "now"
    # Gains are sound if this flight is a sufficient basis for them.
    if not advice.is_sound:
        return TRIED_HEADER
    if waits_for_stage_1:
        return f"advised, stage {advice.stage:d}"
    return "advised"


def _margin_rows(loops: Mapping[str, Loop], loop_name: str) -> list[list[str]]:
    """Returns table rows with the stability margins and the crossover of a control loop, each with its interval.

    Args:
        loops: the identified loops of an axis, by header of the table's column: with the present gains and, if gains
            change, with the new ones.
        loop_name: which loop of the axis the rows are about, "rate" or "attitude".

    Returns:
        A row for each figure, such as the phase margin: its name, and then its value in each column.
    """
    rows = []
    for figure_name in TUNED_FIGURES:
        figure = LOOP_FIGURES[figure_name]
        row = [f"{loop_name}: {figure.header}"]
        for loop in loops.values():
            row.append(figure_text(loop, loop_name, figure_name))
        rows.append(row)
    return rows


def _step_rows(
    loops: Mapping[str, Loop], loop_name: str, axes_with_feedforward: Collection[str]
) -> list[list[str]]:
    """Returns the rows of a table with overshoot and rise time of a loop's predicted step responses.

    Args:
        loops: loops with the present and, if gains change, with the new gains, which have a cell each.
        loop_name: "rate" or "attitude".
        axes_with_feedforward: axes whose charts of the attitude have feed-forward of its setpoint, with which a step
            rises faster and overshoots. The rows say that their steps are without it.
    """
    condition = " of a step"
    remark_on_charts = ""
    if loop_name == "attitude":
        condition = " of a step without feed-forward"
        if axes_with_feedforward:
            remark_on_charts = f"; the chart of {listed(axes_with_feedforward)} has it"
    overshoot_row = [f"{loop_name}: overshoot{condition} (%{remark_on_charts})"]
    rise_time_row = [f"{loop_name}: 10 to 90 %{condition} (ms{remark_on_charts})"]
    for loop in loops.values():
        overshoot, rise_time = _step_texts(loop.open_loop(loop_name), STEP_SECONDS[loop_name])
        overshoot_row.append(overshoot)
        rise_time_row.append(rise_time)
    return [overshoot_row, rise_time_row]


def _step_texts(loop: OpenLoop, duration: float) -> tuple[str, str]:
    """Returns overshoot, %, and rise time, ms, of a loop's predicted step response, such as ("12 (8 to 17)", "45").

    Args:
        loop: rate or attitude loop, whose closed loop is computed.
        duration: length of the step response, s.

    Returns:
        Both as text, with their 90 % intervals unless these are narrower than the last digit; empty if the step cannot
        be predicted.
    """
    step = predicted_step(loop, duration)
    if step is None:
        return ("", "")
    overshoot, rise_time = step.overshoot, step.rise_time
    return (
        text_with_interval(overshoot.value, overshoot.interval, scale=100),
        _rise_time_text(rise_time, duration),
    )


def _rise_time_text(rise_time: IntervalEstimate, duration: float) -> str:
    """Returns a rise time with its 90 % interval in ms, such as "87 (63 to 140)".

    Args:
        rise_time: the rise time, s; the duration where the step does not reach 90 %.
        duration: length of the step response, s.

    Returns:
        The text. A step that does not rise within its length has "> 500", and "87 (63 to > 500)" if that is so in more
        than 5 % of the vehicle models.
    """
    limit = f"> {1e3 * duration:.0f}"
    if rise_time.value >= duration:
        return limit
    if rise_time.high >= duration:
        return f"{rounded(1e3 * rise_time.value)} ({rounded(1e3 * rise_time.low)} to {limit})"
    return text_with_interval(rise_time.value, rise_time.interval, scale=1e3)
