"""Summary: the result of a learnt flight in words and tables, cautions first, as Markdown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavdem import evaluate
from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.view.units import named, readable, short, state_names

Array = NDArray[np.float64]

READING = (
    "**To read the pictures:** in those by iteration, +10s on the axis is iteration 10 (or choose the timeline "
    "*iteration* below). Thin lines beside a thick one are its 90 % band; y ← x is the entry of A, B or C by which x "
    "drives y, in the model's units. "
    "λ of z is about measurement noise, λ of w about process noise: higher means less noise."
)


def summary(train: Flight, test: Flight, learned: Learned) -> str:
    """What a reader must know before, and can know from, the pictures."""
    return "\n\n".join(
        [
            _cautions(learned),
            _flight(train, test),
            _errors(train, test, learned),
            _free_energy(learned),
            _model(train, learned),
            READING,
        ]
    )


def _cautions(learned: Learned) -> str:
    if not learned.cautions:
        return "No cautions."
    return "\n".join(f"**Caution:** {caution}\n" for caution in learned.cautions).rstrip()


def _flight(train: Flight, test: Flight) -> str:
    source = Path(str(train.provenance.get("source", "arrays"))).name
    return (
        f"**{source}**: learnt from {train.duration:.2f} s, forecast over the {test.duration:.2f} s after, "
        f"at {1 / train.dt:.0f} Hz. 0 s here is {train.time[0]:.2f} s on the autopilot's clock."
    )


def _errors(train: Flight, test: Flight, learned: Learned) -> str:
    """Root mean squared errors, which have the unit of what is predicted."""
    report = evaluate.report(train, test, learned)
    outputs = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, outputs, strict=True)]
    scales = np.array([unit.scale for unit in outputs])
    tables = []
    for title, errors in (
        ("One step ahead", report["one_step_mspe"]),
        (f"{len(test)} steps ahead", report["forecast_mspe"]),
    ):
        rows = [
            [name, *(f"{value:.3g}" for value in scales * np.sqrt(error["per_output"]))]
            for name, error in errors.items()
        ]
        tables.append(_table([f"{title}, rms error", *columns], rows))
    ratio, inside = report["forecast_over_constant_mean"], report["inside_90_percent_band"]
    verdict = (
        f"The forecast errs {ratio:.2g} times as much as the constant mean (mean square, each output in units of its "
        f"variance); {100 * inside:.0f} % of the held-out samples lie in its 90 % band."
    )
    return "\n\n".join([*tables, verdict])


def _free_energy(learned: Learned) -> str:
    energy = learned.free_energy
    return (
        f"Free energy action F̄ rose by {energy.gained:,.0f} nats in {len(energy) - 1} iterations, to {energy[-1]:,.0f}."
    )


def _model(train: Flight, learned: Learned) -> str:
    """The rows of the model as columns of a table: what drives each state, with its standard deviation."""
    model, sd = learned.model, learned.model_sd
    states = state_names(train, learned)
    coefficients = np.hstack([model.A, model.B, model.offset[:, None]])
    deviations = np.hstack([sd.A, sd.B, np.full((len(states), 1), np.nan)])
    causes = [*states, *map(short, train.input_names), "constant"]
    rows = [
        [cause, *(_estimate(value, deviation) for value, deviation in zip(values, deviations.T[place], strict=True))]
        for place, (cause, values) in enumerate(zip(causes, coefficients.T, strict=True))
    ]
    stability = model.spectral_abscissa
    units = ", ".join(dict.fromkeys(unit for unit in (*train.output_units, *train.input_units) if unit))
    return "\n\n".join(
        [
            f"**Model** ẋ = A x + B u + constant, about trim, ± sd, in {units or 'the units of the arrays'} and s:",
            _table(["", *(f"d {state}/dt" for state in states)], rows),
            f"It is {'unstable' if stability > 0 else 'stable'}: the largest real part of its eigenvalues is "
            f"{stability:.2f} 1/s.",
        ]
    )


def _estimate(value: float, deviation: float) -> str:
    return f"{value:.3g}" if np.isnan(deviation) else f"{value:.3g} ± {deviation:.1g}"


def _table(header: list[str], rows: list[list[str]]) -> str:
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [header, rule, *rows])
