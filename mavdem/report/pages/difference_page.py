"""The page of two flights over each other: what differs first, then responses, spectra, margins, motors and wind."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.fleet.difference import ParameterChange, VehicleDifference
from mavdem.fleet.row import NOT_IDENTIFIABLE, UNKNOWN, value_at
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.report.blocks import Blocks, Sentence, Table
from mavdem.report.charts.chart import TIME_AFTER_STEP, Axis, Chart, Group, Kind, Line
from mavdem.report.charts.flight_charts import STEP_RESPONSE
from mavdem.report.difference import difference_blocks, headline_blocks, next_blocks, surest_change
from mavdem.report.loops import LOOP_FIGURES
from mavdem.report.numbers import counted, rounded
from mavdem.report.pages.page import Chapter, PageLink, render_document
from mavdem.report.palette import PREDICTED, TRUTH
from mavdem.report.templates import render_section

Review = Mapping[str, Any]
"""The document of a review, of which nothing need be known."""
Reviews = Mapping[str, Review]  # by side
COLOURS = {"A": PREDICTED, "B": TRUTH}


def comparison_page(
    names: tuple[str, str],
    reviews: tuple[Review, Review],
    difference: VehicleDifference,
    parameters: Sequence[ParameterChange] = (),
    lacking: Names = (),
    back: PageLink | None = None,
) -> str:
    """Returns the HTML of two flights, called ``names``, by documents as ``report.json`` has them.

    ``difference`` is what differs, ``parameters`` those that changed, and ``lacking`` the sides whose gains are not
    known; ``back`` is name and address of the page that leads here.
    """
    both = dict(zip(COLOURS, reviews, strict=True))
    steps = tuple(filter(None, (tuple(_steps(both, axis)) for axis in AXES)))
    changed = [[name, f"{before:.4g}", f"{after:.4g}"] for name, before, after in parameters]
    margins = [
        [f"{axis} {name}", *(_cell(rate, key, scale) for rate in _loops(both, axis).values())]
        for axis in AXES
        for key, (name, scale) in LOOP_FIGURES.items()
    ]
    chapters = [
        Chapter("What differs", difference_blocks(difference, parameters, lacking)),
        Chapter("Step response", (), [Group(steps)] if steps else []),
        _table("Margins", "rate loop (90 % interval)", margins),
        Chapter("Spectra", (), _group(_spectra(both))),
        Chapter("Motors", (), _group(_motors(both))),
        _table("Wind", "90 % interval", _wind(both)),
        _table("Parameters", f"{counted(len(changed), 'parameter')} changed", changed),
    ]
    first = _headline(both, difference, parameters)
    headlines = {name: value_at(review, "headline.sentence") for name, review in both.items()}
    first += [*headline_blocks(headlines), *next_blocks(difference)]
    return render_document(" and ".join(names), "A and B over each other.", first, chapters, back)


def _table(title: str, head: str, rows: list[list[str]]) -> Chapter:
    filled = [row for row in rows if {*row[1:]} != {"-"}]
    return Chapter(title, [Table([head, *COLOURS], filled)] if filled else [])


def _headline(
    both: Reviews, difference: VehicleDifference, parameters: Sequence[ParameterChange]
) -> Blocks:
    """What matters most: two vehicles, or what surely changed most, of quantities, gains and margins."""
    vehicles = [value_at(review, "identity.name") or UNKNOWN for review in both.values()]
    gains = [
        parameter
        for parameter in parameters
        if CONTROL_PARAMETERS.match(parameter.name) and parameter.before
    ]
    margins = [
        (axis, rates["A"], rates["B"])
        for axis in AXES
        for rates in [_loops(both, axis)]
        if all(rates.values())
    ]
    ends = "phase_margin_interval"
    apart = [
        (axis, before["phase_margin"], after["phase_margin"])
        for axis, before, after in margins
        for lows, highs in [np.array([before[ends], after[ends]], np.float64).T]
        if lows.max() > highs.min()  # not where an end is infinite: None in the document, NaN here
    ]
    said = render_section(
        "difference_first",
        vehicles=vehicles,
        are_two=vehicles[0] != vehicles[1] and UNKNOWN not in vehicles,
        changed=surest_change(difference),
        gain=max(
            gains, key=lambda parameter: abs(parameter.after / parameter.before - 1), default=None
        ),
        margin=max(apart, key=lambda margins: abs(margins[1] - margins[2]), default=None),
        has_margins=bool(margins),
    )
    return [Sentence("", text.text) for text in said]


def _loops(both: Reviews, axis: str) -> dict[str, Review]:
    """The figures of the rate loops of an axis; nothing of one that is not known."""
    return {name: value_at(review, f"axes.{axis}.loop.rate") or {} for name, review in both.items()}


def _steps(both: Reviews, axis: str) -> Iterator[Chart]:
    """Steps of rate and angle, with their bands."""
    for loop in ("rate", "attitude"):
        lines = []
        for name, review in both.items():
            if response := value_at(review, f"axes.{axis}.{loop}.measured"):
                time, step, half = (
                    np.array(response[key]) for key in ("time", "step", "step_half")
                )
                lines.append(Line.with_band(name, COLOURS[name], time, step, half))
        if lines:
            yield Chart(
                f"{axis.capitalize()} {loop}: step",
                TIME_AFTER_STEP,
                STEP_RESPONSE,
                tuple(lines),
                (1.0,),
            )


def _cell(response: Review, key: str, scale: float = 1.0) -> str:
    """A figure with the ends of its interval."""
    figures = [response.get(key), *(response.get(f"{key}_interval") or ())]
    if None in figures:
        return "-"
    value, low, high = (rounded(scale * figure) for figure in figures)
    return f"{value} ({low} to {high})"


def _group(chart: Chart) -> list[Group]:
    return [Group.of([chart])] if chart.lines else []


def _spectra(both: Reviews) -> Chart:
    """The gyro's, before its filters where that was logged."""
    lines = []
    for name, review in both.items():
        spectra = review.get("spectra") or {}
        if spectrum := spectra.get("gyro_before") or spectra.get("gyro"):
            density = np.sum(list(spectrum["density"].values()), axis=0)[1:]
            hertz = np.array(spectrum["frequency"])[1:]
            lines.append(Line(name, COLOURS[name], hertz, np.maximum(density, 1e-12)))
    power = Axis("power ((rad/s)²/Hz)", log=True)
    return Chart("Gyro, power ((rad/s)²/Hz)", Axis("frequency (Hz)"), power, tuple(lines))


def _motors(both: Reviews) -> Chart:
    """Trim deviations with their intervals."""
    lines = []
    names = [str(number) for number in range(1, 13)]
    for name, review in both.items():
        if shares := value_at(review, "condition.hover.trim_share"):
            deviation = 100 * (np.array(shares) - 1)
            ends = value_at(review, "condition.share_interval") or [0.0] * len(shares)
            half = 100 * np.array(ends, np.float64)
            names = names[: len(shares)]
            at = np.arange(float(len(shares)))
            lines.append(Line.with_band(name, COLOURS[name], at, deviation, half, Kind.DOTS))
    axis = Axis("motor", names=tuple(names))
    return Chart("Trim deviation (%)", axis, Axis("trim deviation (%)"), tuple(lines), (0.0,))


def _wind(both: Reviews) -> list[list[str]]:
    """Its speed and direction, where they are identifiable."""
    speeds, origins = ["wind (m/s)"], ["from (°)"]
    for review in both.values():
        wind = review.get("wind") or {}
        refused = {
            name for name, status in wind.get("status", {}).items() if status == NOT_IDENTIFIABLE
        }
        speeds.append(_cell({} if "speed" in refused else wind, "speed"))
        is_directed = wind and "direction" not in refused
        both_ends = "{direction:.0f} ± {direction_interval:.0f}"
        origins.append(both_ends.format(**wind) if is_directed else "-")
    return [speeds, origins]
