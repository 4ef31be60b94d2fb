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
from mavdem.report.comparison import compared_kinds, comparison_report
from mavdem.report.numbers import listed
from mavdem.report.pages.page import Chapter, KeyEntry, ResultPicture, render_document

SUBTITLE = "Forecasts of mavdem and of other methods, compared on the same windows of flight."
"""What stands below the title."""

CAPTION = """\
A lower line is better. Where a line crosses that of the constant mean, the forecast is worse than the mean of the \
training data. At horizons below the whole the forecast starts anew from the data after each."""
"""What stands below the charts."""

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
    """Renders the page of ``mavdem compare`` as HTML: the result beside a chart of errors, then all tables.

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
    groups = {}
    for kind in compared_kinds(comparison):
        chart = forecast_error_chart(comparison, kind)
        # The constants have no lines.
        if chart.lines:
            caption = CAPTION if kind == KNOWN_INPUTS else ""
            groups[kind] = Group.side_by_side([chart], caption)
    picture = None
    if KNOWN_INPUTS in groups:
        picture = ResultPicture(groups[KNOWN_INPUTS], position=1)
    chapters = [Chapter("All figures", details)]
    if UNKNOWN_INPUTS in groups:
        without_inputs = Chapter("Forecasts without the inputs", groups=[groups[UNKNOWN_INPUTS]])
        chapters.insert(0, without_inputs)
    title = listed(comparison.flights)
    return render_document(
        title, SUBTITLE, result, chapters, key=_colour_key(comparison), picture=picture
    )


def _colour_key(comparison: Comparison) -> list[KeyEntry]:
    """Returns the colours of DEM's model, mavdem's default and the last sample, as far as they are compared."""
    key = []
    for method, colour in OWN_COLOURS.items():
        if method in comparison.methods:
            key.append(KeyEntry(colour, method, DESCRIPTIONS[method]))
    return key
