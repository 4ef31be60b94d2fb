"""The page of ``mavdem compare``: what DEM loses to, the error of each method over the horizon, and all tables."""

from collections.abc import Mapping
from types import MappingProxyType

from mavdem.experiments.comparison import Comparison
from mavdem.experiments.held_out import HOLD_LAST
from mavdem.experiments.scores import KNOWN_INPUTS, UNKNOWN_INPUTS
from mavdem.facts.forecasts import MethodName
from mavdem.report.blocks import Blocks, Table
from mavdem.report.charts.chart import Group
from mavdem.report.charts.forecast_errors import OWN_COLOURS, forecast_error_chart
from mavdem.report.comparison import compared_kinds, comparison_report, horizon_difference_tables
from mavdem.report.numbers import listed
from mavdem.report.pages.page import Chapter, KeyEntry, render_document

SUBTITLE = "Forecasts of mavdem and of other methods, compared on the same windows of flight."
"""What stands below the title."""

CAPTION = """\
A lower line is better. Where a line crosses that of the constant mean, the forecast is worse than the mean of the \
training data. At horizons below the whole the forecast starts anew from the data after each."""
"""What stands below the charts."""

CHART_TITLES = {
    KNOWN_INPUTS: "Error by horizon",
    UNKNOWN_INPUTS: "Forecasts without the inputs",
}
"""Titles of the chapters with the charts, by the kind of forecast."""

DESCRIPTIONS = {
    str(MethodName.PLANT): "DEM's model alone",
    str(MethodName.JOINT): "by which mavdem forecasts",
    str(HOLD_LAST): "the last sample as forecast",
}
"""What the methods of the key are, by their names."""


def methods_page(
    comparison: Comparison,
    planned_windows: int | None = None,
    excluded: Mapping[str, Exception] = MappingProxyType({}),
) -> str:
    """Renders the page of ``mavdem compare`` as HTML: the result, charts of errors by horizon, then all tables.

    Args:
        comparison: errors and paired tests of all methods.
        planned_windows: number of windows that were to be compared, if the run was stopped before; otherwise None.
        excluded: reason why a log is not compared, by its path.
    """
    result: Blocks = []
    for block in comparison_report(comparison, planned_windows, excluded, verbose=False):
        if isinstance(block, Table):
            # What follows explains the table, which stands among the details.
            break
        result.append(block)
    details: Blocks = []
    for block in comparison_report(comparison, planned_windows, excluded):
        if block not in result:
            details.append(block)
    charts = []
    for kind in compared_kinds(comparison):
        chart = forecast_error_chart(comparison, kind)
        # The constants have no lines.
        if chart.lines:
            caption = CAPTION if kind == KNOWN_INPUTS else ""
            group = Group.side_by_side([chart], caption)
            tables = horizon_difference_tables(comparison, kind)
            charts.append(Chapter(CHART_TITLES[kind], tables, groups=[group]))
    title = listed(comparison.flights)
    chapters = [*charts, Chapter("All figures", details)]
    return render_document(title, SUBTITLE, result, chapters, key=_colour_key(comparison))


def _colour_key(comparison: Comparison) -> list[KeyEntry]:
    """Returns the colours of DEM's model, mavdem's default and the last sample, as far as they are compared."""
    key = []
    for method, colour in OWN_COLOURS.items():
        if method in comparison.methods:
            key.append(KeyEntry(colour, method, DESCRIPTIONS[method]))
    return key
