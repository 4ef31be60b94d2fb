"""The result of ``mavdem learn`` for people: cautions first, then the errors, the free energy and the model."""

from __future__ import annotations

import math
from typing import Any

import click
from rich.table import Table

from mavdem.cli.output import print_table
from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.view.parameters import left_free
from mavdem.view.units import readable, state_names


def print_summary(report: dict[str, Any], train: Flight, test: Flight, learned: Learned) -> None:
    """Prints what ``report`` says of ``learned``, with angles in degrees and everything else in the unit of the model.

    Args:
        report: of ``mavdem.evaluate.report``, with the ``seconds`` and ``files`` that ``mavdem learn`` adds.
        train, test, learned: what it is about.
    """
    for caution in report["cautions"]:
        click.echo(f"Caution: {caution}")
    click.echo(
        f"Learnt from {len(train)} samples ({train.duration:.2f} s at {1 / train.dt:.0f} Hz), forecast the {len(test)} "
        f"after ({test.duration:.2f} s).\n"
    )
    print_table(_errors("one step ahead", report["one_step_mspe"], train))
    print_table(_errors(f"{len(test)} steps ahead", report["forecast_mspe"], train))
    click.echo(
        f"The forecast errs {report['forecast_over_constant_mean']:.2f} times as much as the constant mean, and "
        f"{report['inside_90_percent_band']:.0%} of the samples lie in its 90% band.\n"
    )
    click.echo(
        "Model dx/dt = A x + B (u - trim) + constant, y = C x + trim, in rad, s and the unit of the motors, +- sd:\n"
    )
    print_table(_dynamics(train, learned))
    if left_free(learned)["C"].any():
        print_table(_outputs(train, learned))
    stability = report["spectral_abscissa"]
    click.echo(
        f"It is {'unstable' if stability > 0 else 'stable'}: the largest real part of its eigenvalues is "
        f"{stability:.3g} 1/s."
    )
    energy = report["free_energy"]
    click.echo(
        f"The free energy action rose by {energy['gained']:,.0f} nats in {len(learned.free_energy) - 1} iterations, to "
        f"{energy['end']:,.0f}."
    )
    click.echo(f"Took {report['seconds']:.1f} s. Written: {', '.join(report['files'].values())}")


def _errors(title: str, errors: dict[str, Any], train: Flight) -> Table:
    units = [readable(unit) for unit in train.output_units]
    table = _table(f"error {title}")
    for name, unit in zip(train.output_names, units, strict=True):
        table.add_column(f"{name}, rms {unit.name}".rstrip(), justify="right")
    table.add_column("MSPE, summed", justify="right")
    for forecast, error in errors.items():
        rms = [unit.scale * math.sqrt(value) for unit, value in zip(units, error["per_output"], strict=True)]
        table.add_row(forecast, *(f"{value:.3g}" for value in (*rms, error["total"])))
    return table


def _dynamics(train: Flight, learned: Learned) -> Table:
    model, sd = learned.model, learned.model_sd
    states = state_names(train, learned)
    table = _table("drives", *(f"d {state}/dt" for state in states))
    for matrix, deviations, causes in ((model.A, sd.A, states), (model.B, sd.B, train.input_names)):
        for cause, values, spread in zip(causes, matrix.T, deviations.T, strict=True):
            table.add_row(cause, *map(_estimate, values, spread))
    table.add_row("constant", *(f"{value:.3g}" for value in model.offset))
    return table


def _outputs(train: Flight, learned: Learned) -> Table:
    table = _table("shows in", *train.output_names)
    for state, values, spread in zip(state_names(train, learned), learned.model.C.T, learned.model_sd.C.T, strict=True):
        table.add_row(state, *map(_estimate, values, spread))
    return table


def _estimate(value: float, deviation: float) -> str:
    return f"{value:.3g} +- {deviation:.1g}"


def _table(first: str, *others: str) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column(first)
    for other in others:
        table.add_column(other, justify="right")
    return table
