"""Tables of the margins of each axis now and with new gains, at the top of a tuning, for a page and for a terminal."""

import re
from collections.abc import Iterable, Sequence

from mavdem.assessment.axis.tuning import Tuning
from mavdem.facts import Fact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import LOOP_NAMES, Loop, MarginTarget
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
"""Figures of ``TUNED_FIGURES`` whose 90 % interval the overview of a tuning shows; there is no room for all."""


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


NEW_GAINS_LABEL = "  new gains"
"""Name of the row of a terminal's table with the margins that new gains give, below that with the present margins."""


def margin_overview(tuning: Tuning) -> list[Table]:
    """Returns a page's tables of margins, such as "29 (23 to 35) → 44 (38 to 51)", below a row with their goal.

    Each loop of an axis has a row, with a second line for its intervals on a phone. Axes whose gains are treated alike,
    such as those with gains to load, share a table (:func:`_margins_header`); doubtful margins come last.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        The tables; empty if no loop is known.
    """
    tables = []
    for header, advice_of_axes in _advice_by_header(tuning).items():
        tables.append(_margins_table(header, advice_of_axes))
    return tables


def terminal_margin_overview(tuning: Tuning) -> list[Table]:
    """Returns the same tables for a terminal of 80 columns, with the margins of new gains in a row of their own.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        The tables; empty if no loop is known.
    """
    tables = []
    for header, advice_of_axes in _advice_by_header(tuning).items():
        present, _, changed = header.partition(" → ")
        # Of gains that are not to be loaded the row says so: "tried gains", or "stage 2 gains".
        new_gains_label = f"  {changed} gains" if changed else NEW_GAINS_LABEL
        rows = [_goal_row(advice_of_axes[0].target)]
        for advice in advice_of_axes:
            rows += _terminal_rows(advice, new_gains_label)
        tables.append(Table(_headers(present), rows))
    return tables


def _advice_by_header(tuning: Tuning) -> dict[str, list[Advice]]:
    """Groups the axes whose loop is known by the header of their table, doubtful margins last.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
    """
    advice_by_header = dict[str, list[Advice]]()
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice):
            advice_by_header.setdefault(_margins_header(tuning, axis), []).append(advice)
    doubtful_advice = advice_by_header.pop(DOUBTFUL_HEADER, None)
    if doubtful_advice is not None:
        advice_by_header[DOUBTFUL_HEADER] = doubtful_advice
    return advice_by_header


def _headers(first_header: str) -> list[str]:
    """Returns the headers of a table of margins, the first of them given, such as "now → new"."""
    return [first_header, *[OVERVIEW_HEADERS[figure_name] for figure_name in TUNED_FIGURES]]


def _margins_table(first_header: str, advice_of_axes: Sequence[Advice]) -> Table:
    """Returns a page's table of the margins of some axes, with a row for each loop, and a narrower one for a phone.

    Args:
        first_header: header of the first column, such as "now → new".
        advice_of_axes: advice on each axis, with its identified loops; all have the same goal.
    """
    goal = _goal_row(advice_of_axes[0].target)
    rows = [goal]
    # Without its space no goal breaks in the narrow columns of a phone.
    rows_on_phone = [[cell.replace(" ", "") for cell in goal]]
    for advice in advice_of_axes:
        rows_with_intervals = _overview_rows(advice, has_intervals=True)
        values = _overview_rows(advice, has_intervals=False)
        rows += rows_with_intervals
        for row, row_of_values in zip(rows_with_intervals, values, strict=True):
            rows_on_phone.append(_cells_on_phone(row, row_of_values))
    headers = _headers(first_header)
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


def _overview_rows(advice: Advice, *, has_intervals: bool) -> list[list[str]]:
    """Returns the rows of a page's table for the rate loop and the attitude loop of one axis.

    Args:
        advice: advice on the axis: its identified loops with the gains that flew and with new ones, if there are any.
        has_intervals: whether ``FIGURES_WITH_INTERVAL`` have their 90 % intervals.

    Returns:
        For each loop its name and a cell for each of ``TUNED_FIGURES``: the figure now and, if new gains change it,
        with these: "29 (23 to 35) → 44 (38 to 51)".
    """
    rows = []
    for loop_name in LOOP_NAMES:
        row = [f"{advice.before.axis} {loop_name}"]
        for figure_name in TUNED_FIGURES:
            has_interval = has_intervals and figure_name in FIGURES_WITH_INTERVAL
            cell = _cell(advice.before, loop_name, figure_name, has_interval=has_interval)
            if _is_changed(advice, loop_name, figure_name):
                new = _cell(advice.after, loop_name, figure_name, has_interval=has_interval)
                cell = f"{cell} → {new}"
            row.append(cell)
        rows.append(row)
    return rows


def _terminal_rows(advice: Advice, new_gains_label: str) -> list[list[str]]:
    """Returns the rows of a terminal's table for the rate loop and the attitude loop of one axis.

    Args:
        advice: advice on the axis: its identified loops with the gains that flew and with new ones, if there are any.
        new_gains_label: name of the row with the margins that new gains give; a loop that they leave as it is has none.

    Returns:
        For each loop a row with its name and a cell for each of ``TUNED_FIGURES``, and one with new gains.
    """
    rows = []
    for loop_name in LOOP_NAMES:
        row = [f"{advice.before.axis} {loop_name}"]
        new_row = [new_gains_label]
        for figure_name in TUNED_FIGURES:
            has_interval = figure_name in FIGURES_WITH_INTERVAL
            row.append(_cell(advice.before, loop_name, figure_name, has_interval=has_interval))
            new_row.append(_cell(advice.after, loop_name, figure_name, has_interval=has_interval))
        rows.append(row)
        if any(_is_changed(advice, loop_name, figure_name) for figure_name in TUNED_FIGURES):
            rows.append(new_row)
    return rows


def _is_changed(advice: Advice, loop_name: str, figure_name: str) -> bool:
    """Returns whether new gains change a figure of a loop, as it is printed.

    Args:
        advice: advice on an axis: its identified loops with the gains that flew and with new ones, if there are any.
        loop_name: "rate" or "attitude".
        figure_name: one of ``TUNED_FIGURES``, such as "phase_margin".
    """
    if not advice.parameters:
        return False
    value_now = value_text(advice.before, loop_name, figure_name)
    return value_text(advice.after, loop_name, figure_name) != value_now


def _cell(loops: Loop, loop_name: str, figure_name: str, *, has_interval: bool) -> str:
    """Returns a figure of a loop, with or without its 90 % interval: "29 (23 to 35)".

    Args:
        loops: the loops of an axis with some gains.
        loop_name: "rate" or "attitude".
        figure_name: one of ``TUNED_FIGURES``, such as "phase_margin".
        has_interval: whether it has its interval.
    """
    if has_interval:
        return figure_text(loops, loop_name, figure_name)
    return value_text(loops, loop_name, figure_name)


def tune_overview(tuning: Tuning, result: Fact) -> Blocks:
    """Returns what becomes of each axis at a glance: in a sentence, and in tables (:func:`terminal_margin_overview`).

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
        result: the most important result (:func:`tuning_result`). If it is not the headline of the report, the sentence
            is, and is left out here.

    Returns:
        The sentence and the tables; empty if no loop is known.
    """
    tables = terminal_margin_overview(tuning)
    if not tables or not is_headline_of_tuning(tuning, result):
        return [*tables]
    return [*outcome_sentences(tuning), *tables]
