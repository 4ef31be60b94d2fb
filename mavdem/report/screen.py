"""One screen: what a vehicle does in wind, how sure that is, and what must be known before the model is used."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mavdem.analysis import LogAnalysis
from mavdem.analysis.findings import Finding, findings, known_wind, next_step, warnings_of
from mavdem.condition.hover import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical
from mavdem.evaluate.held_out import BASELINES, FORECAST, PREDICTION, HeldOut
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table, text_of
from mavdem.report.condition import condition_sentences, identity_sentence, tier_sentences
from mavdem.report.names import Labels, named, readable
from mavdem.report.rounding import plus_minus, rounded
from mavdem.report.vehicle import hover_columns, lean, wind_blocks

ROWS = {FORECAST: "forecast, motors recorded", PREDICTION: "prediction, motors unknown"}
"""Of the table of errors, beside the baselines."""


def screen(
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
    found: Sequence[Finding] | None = None,
) -> list[Block]:
    """The findings by purpose, the vehicle, the wind, prediction, and warnings.

    ``held_out`` windows and the motors' ``hover`` figures are left out where there are none; the findings are those of
    the model unless ``found`` otherwise.
    """
    labels, found = Labels.of(learned), findings(learned, held_out) if found is None else found
    return [
        *finding_blocks(found),
        *_vehicle(labels, learned.physical, hover),
        *wind_blocks(learned.wind, learned.physical),
        *_prediction(labels, held_out),
        *(Sentence(warning, "Warning:") for warning in warnings_of(learned, held_out)),
        Sentence(next_step(found), "Next:"),
    ]


def analysis_blocks(found: LogAnalysis) -> list[Block]:
    """What is reported of one vehicle and axis: the screen of its model, else what is known without one, and why."""
    model: list[Block] = []
    if found.learned is not None:
        model = screen(found.learned, found.held_out, found.vehicle.hover, found.findings)
    alarms: list[Block] = [Sentence(one.sentence.removeprefix("Alarm: "), "Motors:") for one in found.alarms]
    if suspect := next((one.name for one in found.alarms if one.motor is not None), ""):
        inspect = (
            f"Inspect {suspect}, its propeller, connector and controller before the next flight, then compare a hover "
            "with healthy flights: `mavdem track --baseline`."
        )
        alarms.append(Sentence(inspect, "Next:"))
        model = model[:-1] if found.tier.name == "a" else model
    if found.tier.name == "a" and model:
        return [*alarms, *model]
    tier = tier_sentences(found.tier.as_dict())
    # What to do next is to record faster, whatever the findings.
    why = [] if model else [Sentence(found.reason, "No model:")]
    remedy = [Sentence(found.remedy, "What to do:")] if found.remedy else []
    identity = identity_sentence(found.identity.as_dict())
    return [*alarms, *why, *remedy, *tier, *model[:-1], identity, *condition_sentences(found.condition.as_dict())]


def title(flights: Sequence[Flight]) -> Sentence:
    """Which log, axis and how much of it."""
    first = flights[0]
    seconds, source = sum(flight.duration for flight in flights), first.provenance.get("source")
    parts = f" in {len(flights)} segments" if len(flights) > 1 else ""
    return Sentence(
        f"{first.output_names[0]}, {seconds:.0f} s of settled flight{parts} at {1 / first.dt:.0f} Hz.",
        f"{Path(str(source)).name if source else 'Arrays'}:",
    )


def summary(learned: Learned) -> str:
    """The screen as text, of what the model alone knows: without windows that it has not seen."""
    blocks = screen(learned)
    cautions = [Sentence(caution, "Caution:") for caution in learned.cautions]
    return text_of([*blocks, *cautions])


def finding_blocks(found: Sequence[Finding]) -> list[Block]:
    """A row a purpose."""
    return [
        Table(
            ["purpose", "verdict", "because"],
            [[one.purpose, one.grade, one.reason] for one in found],
            words=True,
        )
    ]


def key_figures(learned: Learned, held_out: HeldOut | None = None) -> list[tuple[str, str]]:
    """The few figures to see at a glance, each with its label and unit, for a strip of a dashboard or a page."""
    labels, read, degrees = Labels.of(learned), learned.physical, readable("rad/s²")
    wind = known_wind(learned.wind, read)
    figures = []
    if read is not None:
        mean, half = read.mean_effect(LEVEL)
        figures = [
            ("motor effect", _known(degrees.scale * mean, degrees.scale * half, _per_input(labels))),
            ("damping", _known(read.damping, read.interval(LEVEL).damping, "1/s")),
            ("lag of the motors", _known(1e3 * read.lag, 1e3 * read.interval(LEVEL).lag, "ms")),
        ]
    if wind is not None:
        figures.append(("wind's torque, sd", f"{rounded(degrees.scale * wind.sd)} {degrees.name}"))
        figures.append(("gusts", str(len(wind.gusts))))
    if held_out is not None:
        unit = readable(labels.output_units[0])
        best = held_out.best_baseline
        ours, theirs = (unit.scale * held_out.rmse(name)[0] for name in (FORECAST, best))
        label = f"RMSE of {labels.output_names[0]}, {held_out.seconds:.2g} s ahead"
        figures.append((label, f"{rounded(ours)}{unit.name} ({best} {rounded(theirs)}{unit.name})"))
        figures.append(("90 % band holds", f"{100 * held_out.coverage:.0f} %"))
    return figures


def _known(value: float, half: float, unit: str) -> str:
    return f"{plus_minus(value, half)} {unit}" if np.isfinite(half) else "not identifiable"


def _per_input(labels: Labels) -> str:
    return f"{readable('rad/s²').name} per {labels.input_units[0] or 'unit of input'}"


def _vehicle(labels: Labels, read: Physical | None, hover: HoverFigures | None) -> list[Block]:
    """A row a motor: effect, imbalance, trim, headroom and saturation; and what is of all motors."""
    blocks: list[Block] = []
    columns = hover_columns(hover, labels.input_names)
    header, cells = ["vehicle"], [[name] for name in labels.input_names]
    if read is not None:
        unit, half = readable("rad/s²").scale, read.interval(LEVEL).effect
        header.append(f"effect ({_per_input(labels)})")
        for row, value, width in zip(cells, read.effect, half, strict=True):
            row.append(plus_minus(unit * value, unit * width))
    for head, column in columns.items():
        header.append(head)
        for row, cell in zip(cells, column, strict=True):
            row.append(cell)
    if len(header) > 1:
        blocks.append(Table(header, cells))
    rest = []
    if read is not None:
        interval = read.interval(LEVEL)
        rest += [
            f"{name} {_known(scale * value, scale * half, unit)}"
            for name, value, half, scale, unit in (
                ("damping", read.damping, interval.damping, 1.0, "1/s"),
                ("lag of the motors", read.lag, interval.lag, 1e3, "ms"),
                ("delay", read.delay, interval.delay, 1e3, "ms"),
            )
        ]
        rest[0] = rest[0].capitalize()
    if leaning := lean(hover):
        rest.append(f"mean lean {leaning}")
    if rest:
        blocks.append(Sentence(f"{'; '.join(rest)}. ± is the half width of the {100 * LEVEL:.0f} % interval."))
    return blocks


def _prediction(labels: Labels, held_out: HeldOut | None) -> list[Block]:
    """RMSE beside the baselines over all held-out windows, and how windows differ."""
    if held_out is None:
        return []
    units = [readable(unit) for unit in labels.output_units]
    names = [named(name, unit.name) for name, unit in zip(labels.output_names, units, strict=True)]
    ranked = sorted(held_out.forecasts, key=held_out.error_ratio)
    count = f"{len(held_out)} held-out windows" if len(held_out) > 1 else "one held-out window"
    rows = [
        [
            ROWS.get(name, name),
            *(rounded(unit.scale * rmse) for unit, rmse in zip(units, held_out.rmse(name), strict=True)),
            rounded(held_out.error_ratio(name)),
        ]
        for name in ranked
    ]
    blocks: list[Block] = [Table([f"RMSE, {held_out.seconds:.2g} s ahead, {count}", *names, "error ratio"], rows)]
    band = f"The 90 % band holds {100 * held_out.coverage:.0f} % of the samples."
    if len(held_out) > 1:
        ratios = held_out.error_ratios()
        low, median, high = np.percentile(ratios, [25, 50, 75])
        worse = ", ".join(
            f"{100 * float((held_out.error_ratios(baseline=name) > 1).mean()):.0f} % worse than “{name}”"
            for name in BASELINES
        )
        band = (
            f"Of single windows the forecast's error ratio is {rounded(median)} in the median, {rounded(low)} to "
            f"{rounded(high)} in the middle half; {worse}. {band}"
        )
    return [*blocks, Sentence(band)]
