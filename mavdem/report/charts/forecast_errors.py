"""Charts of a comparison of methods: error ratios over the horizon, which show how far forecasts serve."""

from itertools import cycle

import numpy as np

from mavdem.experiments.comparison import Comparison
from mavdem.experiments.held_out import CONSTANT_MEAN, HOLD_LAST
from mavdem.experiments.scores import ForecastKind
from mavdem.facts.forecasts import MethodName
from mavdem.report.charts.chart import Axis, Chart, Line, LineStyle
from mavdem.report.palette import BASELINE, BOUND, DISTINCT, PREDICTED, TRUTH

HORIZON = Axis("horizon (s)", is_logarithmic=True)
"""Time from the first step of a forecast to its last."""

DRAWN_MINIMA = (1e-6, 0.1)
"""The lowest error ratio that is drawn is the smallest of the lines, within these limits; a choice.

Below the first a forecast is as good as exact; up to the second the chart shows what is better than useful.
"""

DRAWN_MAXIMA = (3.0, 10.0)
"""The highest error ratio that is drawn is the largest of the lines, within these limits; a choice.

There is room for the constant mean at 1, and no more than shows that a method diverges.
"""

OWN_COLOURS = {
    str(MethodName.PLANT): TRUTH,
    str(MethodName.JOINT): PREDICTED,
    str(HOLD_LAST): BASELINE,
}
"""Colours of the methods that a reader looks for first: DEM's model, mavdem's default and the last sample."""

OTHER_COLOURS = tuple(colour for colour in DISTINCT if colour not in (*OWN_COLOURS.values(), BOUND))
"""Colours of the other methods, used in turn; their names stand beside them."""

HIDDEN_METHODS = (str(CONSTANT_MEAN), "zero")
"""Methods without a line: the constant mean is the level 1, and zero is worse than it unless the vehicle hangs at 0."""


def forecast_error_chart(comparison: Comparison, kind: ForecastKind) -> Chart:
    """Returns a chart of each method's error ratio over the horizon, with the constant mean as the level 1.

    The line of a method ends where its error is infinite.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    lines = []
    other_colours = cycle(OTHER_COLOURS)
    for summary in comparison.over_flights(kind):
        method = str(summary["method"])
        if method in HIDDEN_METHODS:
            continue
        colour = OWN_COLOURS.get(method) or next(other_colours)
        lines.append(_error_line(method, colour, summary["horizon_seconds"], summary["horizons"]))
    # Lines that readers look for first are drawn over the others.
    lines.sort(key=lambda line: line.name in OWN_COLOURS)
    ratios = np.concatenate([line.y for line in lines] or [np.ones(1)])
    limits = (
        float(np.clip(np.nanmin(ratios, initial=1.0), *DRAWN_MINIMA)),
        float(np.clip(np.nanmax(ratios, initial=1.0), *DRAWN_MAXIMA)),
    )
    return Chart(
        f"Error ratio by horizon, inputs {kind}",
        HORIZON,
        Axis("error ratio", is_logarithmic=True, limits=limits),
        tuple(lines),
        levels=(1.0,),
        level_names=("constant mean",),
        group=f"horizon {kind}",
    )


def _error_line(method: str, colour: str, horizons: list[float], error_ratios: list[float]) -> Line:
    """Returns the line of one method, solid for DEM's model and mavdem's default, dashed for the last sample.

    Args:
        method: name of the method.
        colour: colour from the palette.
        horizons: (K,) horizons, s.
        error_ratios: (K,) error ratios; infinite ones are left out.
    """
    ratios = np.array(error_ratios, float)
    style = LineStyle.LINE
    if method == HOLD_LAST:
        style = LineStyle.DASHES
    elif method in OWN_COLOURS:
        style = LineStyle.BOLD
    return Line(
        method,
        colour,
        np.array(horizons, float),
        np.where(np.isfinite(ratios) & (ratios > 0), ratios, np.nan),
        style=style,
    )
