"""The report of a learnt flight, in sentences and tables, the verdict first; and as Markdown."""

from __future__ import annotations

from math import floor, isfinite, log10, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from mavdem import evaluate
from mavdem.dem import Learned
from mavdem.dem.engine.model import unpack
from mavdem.dem.validation import LEVEL
from mavdem.flight import Flight
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import (
    THREE_STATES,
    Readable,
    named,
    parameter_names,
    readable,
    short,
    state_names,
    states_are_outputs,
)
from mavdem.report.vehicle import physical_blocks, wind_blocks

MAX_NAMED, MIN_WEIGHT = 4, 0.3
"""Of a combination of parameters that is not identifiable: how many are named at most, and from what share of the
largest weight."""


def learned_report(report: dict[str, Any], train: Flight, test: Flight, learned: Learned) -> list[Sentence | Table]:
    """The verdict and the cautions, then the errors of ``mavdem.evaluate.report``, the model and how it was learnt."""
    source = Path(str(train.provenance.get("source", "the arrays"))).name
    energy = learned.free_energy
    return [
        Sentence("", lead=_verdict(report["forecast_mspe"], train, test)),
        *(Sentence(caution, "Caution:") for caution in learned.cautions),
        Sentence(
            f"{source}, {_which(report.get('available_samples', len(train)), train)}{len(train)} samples "
            f"({train.duration:.2f} s at {1 / train.dt:.0f} Hz). "
            f"Held-out test set: the {len(test)} samples after them ({test.duration:.2f} s).",
            "Trained on:",
        ),
        _errors(f"RMSE, {len(test)} steps ahead", report["forecast_mspe"], train),
        _errors("RMSE, one step ahead", report["one_step_mspe"], train),
        Sentence(
            "mean squared error over that of the baseline (the constant mean of the training data), with each output "
            "in units of its training variance. Below 1 is better than the baseline.",
            "Error ratio:",
        ),
        Sentence(
            f"{100 * report['inside_90_percent_band']:.0f} % of the test samples lie inside it. Expected mean squared "
            f"error: {_ratio(report['expected_error'])} training variances.",
            "90 % band of the forecast:",
        ),
        _prediction(report["prediction"], train),
        *_model(train, learned),
        *physical_blocks(train, learned.physical),
        *wind_blocks(learned.wind),
        Sentence(
            f"increased by {energy.gained:,.0f} nats in {len(energy) - 1} iterations, to {energy[-1]:,.0f}."
            f"{_convergence(learned) if learned.simulation_fit is None else ''}",
            "Free energy action F̄:",
        ),
        *_simulation_fit(train, learned),
    ]


def _which(available: int, train: Flight) -> str:
    """Which part of the samples that were available was chosen, if not all of them."""
    if len(train) == available:
        return ""
    return f"the last {train.duration:.0f} s of {available * train.dt:.0f} s: "


HOW_TO_READ_PLOTS = (
    "**How to read the plots:** plots by iteration share the time axis; +1s is iteration 10 (or choose the timeline "
    "*iteration* below). In the others, 0 s is {start:.2f} s on the autopilot's clock. "
    "Thin lines around a thick one are its 90 % band. For A and B it is DEM's own posterior, which is narrower than "
    "the ± above. y ← x is the entry of A, B or C with which x drives y, in the model's units (rad). "
    "λ of z: log precision of the measurement noise; λ of w: of the process noise. A higher λ means less noise."
)


def summary(train: Flight, test: Flight, learned: Learned) -> str:
    """The report as Markdown, with the meaning of the plots."""
    blocks = learned_report(evaluate.report(train, test, learned), train, test, learned)
    return "\n\n".join([*map(_markdown, blocks), HOW_TO_READ_PLOTS.format(start=train.time[0])])


def _markdown(block: Sentence | Table) -> str:
    if isinstance(block, Sentence):
        return f"**{block.lead}** {block.text}".rstrip() if block.lead else block.text
    rule = ["---", *["---:"] * (len(block.header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [block.header, rule, *block.rows])


def _convergence(learned: Learned) -> str:
    """Whether the last fit converged."""
    return " Converged." if learned.converged else " Not converged."


def _simulation_fit(train: Flight, learned: Learned) -> list[Sentence | Table]:
    """The simulation-error fit after DEM, and the mixer geometry in its prior."""
    fit = learned.simulation_fit
    if fit is None:
        return []
    start, end = (sum(term[i] for term in fit.terms.values()) for i in (0, -1))
    blocks: list[Sentence | Table] = [
        Sentence(
            f"over {fit.horizon * learned.dt:.2g} s: {len(fit.places)} parameters, effective sample size "
            f"{fit.numbers:.0f}; F̄ increased by another {end - start:.3g} nats."
            f"{_convergence(learned)}",
            "Simulation-error (output-error) fit",
        )
    ]
    turning = None if fit.layout is None else fit.layout.turning
    if turning is not None:
        up, down = (
            " and ".join(short(name) for name, way in zip(train.input_names, turning, strict=True) if sign * way > 0)
            for sign in (1, -1)
        )
        source = "Estimated from the data" if learned.record.effect_directions is None else "Known for these inputs"
        blocks.append(Sentence(f"{up} against {down}. {source}.", "Mixer geometry, used as a prior:"))
    return blocks


def _verdict(errors: dict[str, Any], train: Flight, test: Flight) -> str:
    """RMSE beside the baseline, the error ratio, and whether a forecast without a model is better."""
    ours, best = errors["DEM"]["relative"], next(iter(errors))
    rms = ", ".join(
        f"{name} {_with_unit(sqrt(own), unit)} (baseline {_with_unit(sqrt(constant), unit)})"
        for name, unit, own, constant in zip(
            train.output_names,
            map(readable, train.output_units),
            errors["DEM"]["per_output"],
            errors["constant mean"]["per_output"],
            strict=True,
        )
    )
    figures = f"RMSE on the held-out test set ({test.duration:.3g} s): {rms}; error ratio {_ratio(ours)}."
    if not ours < 1:
        return (
            f"Do not use this model: it forecasts no better than a constant. {figures} "
            "Try another --start, a longer --train, or a part of the flight with more motion."
        )
    if best != "DEM":
        return f"{figures} “{best}”, a forecast without a model, has a lower one ({_ratio(errors[best]['relative'])})."
    return figures


def _prediction(found: dict[str, Any], train: Flight) -> Sentence:
    """How far ahead predictions are worth something without the inputs."""
    each = ", ".join(
        f"{name} up to {seconds:.2g} s ahead" if seconds else f"{name} at no horizon"
        for name, seconds in zip(train.output_names, found["half_explained_seconds"], strict=True)
    )
    return Sentence(
        f"they explain at least half of the variance of {each}, by predictions inside the training data.",
        "Predictions without the inputs:",
    )


def _with_unit(value: float, unit: Readable) -> str:
    """A value in the unit it is shown in: "3.9°", "3.66 °/s"."""
    space = "" if unit.name in ("", "°") else " "
    return f"{unit.scale * value:.3g}{space}{unit.name}"


def _in_degrees(value: float, unit: str) -> str:
    shown = readable(unit)
    return f" ({_with_unit(value, shown)})" if shown.name != unit else ""


def _errors(title: str, errors: dict[str, Any], train: Flight) -> Table:
    """RMSE by output, and the error ratio, by which the rows are ranked."""
    units = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, units, strict=True)]
    rows = []
    for prediction, error in errors.items():
        rms = [unit.scale * sqrt(square) for unit, square in zip(units, error["per_output"], strict=True)]
        rows.append([prediction, *(f"{value:.3g}" for value in rms), _ratio(error["relative"])])
    return Table([title, *columns, "error ratio"], rows)


def _ratio(value: float) -> str:
    return f"{value:.3g}"


def _model(train: Flight, learned: Learned) -> list[Sentence | Table]:
    """The model with all it takes to use it elsewhere."""
    model, states = learned.model, state_names(train, learned)
    (n, r), m = model.B.shape, len(model.C)
    known = unpack(learned.known, n, r, m)
    A, B, C = (
        [[_entry(*cell) for cell in zip(*row, strict=True)] for row in zip(values.T, sd.T, fixed.T, strict=True)]
        for values, sd, fixed in zip(model[:3], learned.model_interval(LEVEL)[:3], known, strict=True)
    )
    derivatives = Table(
        ["variable", *(f"d {state}/dt" for state in states)],
        [[cause, *cells] for cause, cells in zip([*states, *map(short, train.input_names)], A + B, strict=True)],
    )
    if learned.scaling.constant:
        derivatives.rows.append(["constant", *(f"{value:.3g}" for value in model.offset)])
    units = ", ".join(dict.fromkeys(unit for unit in (*train.output_units, *train.input_units) if unit))
    blocks: list[Sentence | Table] = [
        Sentence(
            f"dx/dt = A x + B (u - trim){' + constant' if learned.scaling.constant else ''}, y = C x + trim"
            f"{', C = [I 0]' if states_are_outputs(learned) else ''}, in {units or 'the units of the arrays'} and s. "
            "Each column is one derivative: the sum of its entries, each times the variable of its row. "
            "“fixed” entries are held by the prior.",
            "Model:",
        ),
        derivatives,
    ]
    if states_are_outputs(learned) and len(states) == len(train.output_names) + 1:
        blocks.append(Sentence(f"hidden 1 is the lag of the motors. {THREE_STATES}", "States:"))
    if not states_are_outputs(learned):
        blocks.append(Sentence("each column is one output, summed likewise; its trim is added.", "Outputs:"))
        blocks.append(
            Table(["variable", *train.output_names], [[state, *cells] for state, cells in zip(states, C, strict=True)])
        )
    trims = [
        ", ".join(
            f"{name} {value:.4g} {unit}{_in_degrees(value, unit)}".rstrip()
            for name, value, unit in zip(*trim, strict=True)
        )
        for trim in (
            (train.output_names, model.output_trim, train.output_units),
            (train.input_names, model.input_trim, train.input_units),
        )
    ]
    return [
        *blocks,
        *_precision(learned),
        *_not_identifiable(train, learned),
        Sentence(f"{'; '.join(trims)}.", "Trim:"),
        Sentence(_poles(model.A), "Poles (1/s):"),
    ]


def _precision(learned: Learned) -> list[Sentence]:
    if learned.scatter is None:
        return []
    return [
        Sentence(
            f"half width of the {100 * LEVEL:.0f} % interval. It does not include the bias of the closed loop: the "
            "inputs are correlated with the disturbance, because the motors counteract the wind (see Limits in the "
            "README).",
            "±:",
        )
    ]


def _not_identifiable(train: Flight, learned: Learned) -> list[Sentence]:
    if not learned.undetermined:
        return []
    directions, entries = learned.undetermined, parameter_names(train, learned)
    least = directions[0].weights
    largest = np.argsort(-np.abs(least))[:MAX_NAMED]
    least = least * np.sign(least[largest[0]])
    combination = " ".join(
        f"{'-' if least[i] < 0 else '+'} {abs(least[i]):.2g} ({entries[i]})"
        for i in largest
        if abs(least[i]) > MIN_WEIGHT * np.abs(least).max()
    ).removeprefix("+ ")
    count = f"{len(directions)} combination{'s' if len(directions) > 1 else ''}"
    return [
        Sentence(
            f"{count} of parameters, about which the data contain less information than the prior. "
            f"The least identifiable is {combination}, in units of prior standard deviations.",
            "Not identifiable:",
        )
    ]


def _entry(value: float, sd: float, fixed: bool) -> str:
    """An estimate with as many digits as its standard deviation supports."""
    if not (isfinite(value) and isfinite(sd) and sd > 0):
        return f"{value:.3g}"
    digit = floor(log10(float(f"{sd:.0e}")))
    if fixed:
        return f"{round(value, -digit) + 0.0:.6g} fixed"
    # Common practice: decimals where they are few, else one power of ten for both.
    power = 0 if -6 <= digit <= 2 else 3 * (max(digit, floor(log10(abs(value) or sd))) // 3)
    decimals = max(power - digit, 0)
    shown = [round(number / 10**power, power - digit) + 0.0 for number in (value, sd)]
    mean, deviation = (f"{number:.{decimals}f}" for number in shown)
    return f"({mean} ± {deviation})e{power}" if power else f"{mean} ± {deviation}"


def _poles(A: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    """The eigenvalues of A, the slowest first, one of each complex pair, and whether the model is stable."""
    poles = sorted((value for value in np.linalg.eigvals(A) if value.imag >= 0), key=lambda value: -value.real)
    unstable = any(value.real > 0 for value in poles)
    return f"{'; '.join(map(_pole, poles))}. The model is {'unstable' if unstable else 'stable'}."


def _pole(pole: complex) -> str:
    """With natural frequency |p|/2π and damping ratio −Re p/|p| if complex, else with the time constant 1/|p|."""
    if pole.imag:
        size = abs(pole)
        return (
            f"{pole.real:.3g} ± {pole.imag:.3g}j: {size / (2 * pi):.2g} Hz, damping ratio {-pole.real / size + 0.0:.2g}"
        )
    if not pole.real:
        return "0: integrator"
    seconds = float(f"{1 / abs(pole.real):.2g}")
    return f"{pole.real:.3g}: {'grows with ' if pole.real > 0 else ''}time constant {seconds:g} s"
