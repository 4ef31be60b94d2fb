"""Tables of the margins of each axis now and with new gains, such as "29 (23 to 35) → 44", at the top of a tuning."""

import re
from collections.abc import Iterable, Sequence

from mavdem.assessment.axis.tuning import Tuning
from mavdem.facts import Fact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import LOOP_NAMES, MarginTarget
from mavdem.report.blocks import Blocks, Detailed, Table
from mavdem.report.tuning.figures import TUNED_FIGURES, figure_text, value_text
from mavdem.report.tuning.outcomes import (
    GainOutcome,
    gain_outcome,
    has_doubtful_margins,
    outcome_sentences,
)
from mavdem.report.tuning.result import is_headline_of_tuning

FIGURES_WITH_INTERVAL = ("phase_margin", "gain_margin")
"""Figures of ``TUNED_FIGURES`` whose 90 % interval the overview of a tuning shows; a terminal has no room for all."""


OVERVIEW_HEADERS = {
    "phase_margin": "phase margin (°)",
    "gain_margin": "gain margin (dB)",
    "ms": "Ms",
    "crossover": "crossover (Hz)",
}
"""Headers of ``TUNED_FIGURES`` in the overview of a tuning, whose columns are narrow."""


DOUBTFUL_HEADER = "doubtful"
"""What the overview calls loops whose margins may be wrong."""


INTERVAL_IN_CELL = re.compile(r"\([^()]+ to [^()]+\)")
"""An interval of a figure in a cell, such as "(23 to 35)"."""


def margin_overview(tuning: Tuning, *, names_axis: bool) -> list[Table]:
    """Returns tables of the margins now and with new gains, such as "29 (23 to 35) → 44", below a row with their goal.

    Each loop of an axis has a row, with a second line for its intervals on a phone. Axes whose gains are treated alike,
    such as those with gains to load, share a table (:func:`_margins_header`); doubtful margins come last.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
        names_axis: whether both rows of an axis name it, as on a page, whose rows may be read alone.

    Returns:
        The tables; empty if no loop is known.
    """
    advice_by_header = dict[str, list[Advice]]()
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice):
            advice_by_header.setdefault(_margins_header(tuning, axis), []).append(advice)
    doubtful_advice = advice_by_header.pop(DOUBTFUL_HEADER, None)
    if doubtful_advice is not None:
        advice_by_header[DOUBTFUL_HEADER] = doubtful_advice
    tables = []
    for header, advice_of_axes in advice_by_header.items():
        tables.append(_margins_table(header, advice_of_axes, names_axis=names_axis))
    return tables


def _margins_table(
    first_header: str, advice_of_axes: Sequence[Advice], *, names_axis: bool
) -> Table:
    """Returns a table of the margins of some axes, with a row for each loop, and a narrower one for a phone.

    Args:
        first_header: header of the first column, such as "now → new".
        advice_of_axes: advice on each axis, with its identified loops; all have the same goal.
        names_axis: whether both rows of an axis name it.
    """
    goal = _goal_row(advice_of_axes[0].target)
    rows = [goal]
    # Without its space no goal breaks in the narrow columns of a phone.
    rows_on_phone = [[cell.replace(" ", "") for cell in goal]]
    for advice in advice_of_axes:
        rows_with_intervals = _overview_rows(advice, names_axis=names_axis)
        values = _overview_rows(advice, has_intervals=False, names_axis=True)
        rows += rows_with_intervals
        for row, row_of_values in zip(rows_with_intervals, values, strict=True):
            rows_on_phone.append(_cells_on_phone(row, row_of_values))
    headers = [first_header, *[OVERVIEW_HEADERS[figure_name] for figure_name in TUNED_FIGURES]]
    return Table(headers, rows, phone_tables=[Table(headers, rows_on_phone)])


def _goal_row(target: MarginTarget) -> list[str]:
    """Returns the first row of a table of margins: the goal of each of ``TUNED_FIGURES``; the crossover has none."""
    goals = {
        "phase_margin": f"≥ {target.phase_margin:g}",
        "gain_margin": f"≥ {target.gain_margin:g}",
        "ms": f"≤ {target.ms:g}",
    }
    return ["goal", *[goals.get(figure_name, "") for figure_name in TUNED_FIGURES]]


def _cells_on_phone(row: Iterable[str], row_of_values: Iterable[str]) -> list[str]:
    """Returns the cells of a row as a phone shows them: each figure, with its intervals in smaller lines below it.

    Args:
        row: cells with intervals, such as "29 (23 to 35) → 44".
        row_of_values: the same cells without, such as "29 → 44".
    """
    cells = []
    for cell, value in zip(row, row_of_values, strict=True):
        # The spaces around an arrow are left out, so that all columns fit and no line breaks there.
        text = value.replace(" → ", "→")
        # The interval with the new gains is below that with the present ones, so that all columns fit.
        intervals = "\n".join(INTERVAL_IN_CELL.findall(cell))
        cells.append(Detailed(text, intervals) if intervals else text)
    return cells


def _margins_header(tuning: Tuning, axis: str) -> str:
    """Returns the header above the margins of an axis, which says of which gains they are, such as "now → new".

    Axes with the same header share a table.

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The first of these that applies:

        - ``DOUBTFUL_HEADER`` if the margins may be wrong.
        - "now → tried" if another flight is to confirm the new gains of this axis.
        - "as flown" if the vehicle must be repaired first, which changes the margins.
        - "now → stage 2" if the new gains wait for a flight with those of another axis.
        - "now → new", or "now" if no axis has gains to load.
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    if has_doubtful_margins(tuning, axis):
        return DOUBTFUL_HEADER
    outcome = gain_outcome(tuning, axis)
    if outcome is GainOutcome.FLY_FIRST:
        return "now → tried"
    if outcome is GainOutcome.REPAIR_FIRST:
        return "as flown"
    if tuning.waits(advice):
        return f"now → stage {advice.stage:d}"
    outcomes = [gain_outcome(tuning, other_axis) for other_axis in tuning.axes]
    return "now → new" if GainOutcome.NEW in outcomes else "now"


def _overview_rows(
    advice: Advice, *, has_intervals: bool = True, names_axis: bool = False
) -> list[list[str]]:
    """Returns the rows of the overview's table for the rate loop and the attitude loop of one axis.

    Args:
        advice: advice on the axis: its identified loops with the gains that flew and with new ones, if there are any.
        has_intervals: whether ``FIGURES_WITH_INTERVAL`` have their intervals.
        names_axis: whether the row of the attitude names the axis, too, as on a page, whose rows may be read alone.

    Returns:
        For each loop its name and a cell for each of ``TUNED_FIGURES`` (:func:`_overview_cell`).
    """
    rows = []
    for loop_name in LOOP_NAMES:
        has_axis = names_axis or loop_name == "rate"
        first_cell = f"{advice.before.axis} {loop_name}" if has_axis else f"  {loop_name}"
        row = [first_cell]
        for figure_name in TUNED_FIGURES:
            has_interval = has_intervals and figure_name in FIGURES_WITH_INTERVAL
            cell = _overview_cell(
                advice,
                loop_name,
                figure_name,
                has_interval=has_interval,
                # A terminal of 80 columns has no room for these.
                has_new_interval=has_interval and names_axis,
            )
            row.append(cell)
        rows.append(row)
    return rows


def _overview_cell(
    advice: Advice, loop_name: str, figure_name: str, *, has_interval: bool, has_new_interval: bool
) -> str:
    """Returns a figure of a loop now and, if it changes, with new gains, such as "29 (23 to 35) → 44 (38 to 51)".

    Args:
        advice: advice on an axis: its identified loops with the gains that flew and with new ones, if there are any.
        loop_name: "rate" or "attitude".
        figure_name: one of ``TUNED_FIGURES``, such as "phase_margin".
        has_interval: whether the figure now has its 90 % interval.
        has_new_interval: whether the figure with new gains has one.
    """
    value_now = value_text(advice.before, loop_name, figure_name)
    text_now = figure_text(advice.before, loop_name, figure_name) if has_interval else value_now
    if not advice.parameters:
        return text_now
    new_text = value_text(advice.after, loop_name, figure_name)
    if new_text == value_now:
        return text_now
    if has_new_interval:
        new_text = figure_text(advice.after, loop_name, figure_name)
    return f"{text_now} → {new_text}"


def tune_overview(tuning: Tuning, result: Fact) -> Blocks:
    """Returns what becomes of each axis at a glance: in a sentence, and in tables (:func:`margin_overview`).

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
        result: the most important result (:func:`tuning_result`). If it is not the headline of the report, the sentence
            is, and is left out here.

    Returns:
        The sentence and the tables; empty if no loop is known.
    """
    tables = margin_overview(tuning, names_axis=False)
    if not tables or not is_headline_of_tuning(tuning, result):
        return [*tables]
    return [*outcome_sentences(tuning), *tables]
