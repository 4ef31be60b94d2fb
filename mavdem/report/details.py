"""Details: the model, its uncertainty and how it was learnt: all that the screen leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, pi, sqrt
from typing import Any

import numpy as np

from mavdem.confidence import LEVEL
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import unpack
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import (
    THREE_STATES,
    Labels,
    named,
    parameter_names,
    plus_minus,
    readable,
    short,
    state_names,
    states_are_outputs,
    with_unit,
)
from mavdem.report.screen import answer_blocks, physical_blocks

MAX_NAMED, MIN_WEIGHT = 4, 0.3
"""Of a combination of parameters that is not identifiable: how many are named at most, and from what share of the
largest weight."""


def detail_blocks(learned: Learned, report: dict[str, Any]) -> list[Block]:
    """Cautions, the errors of ``mavdem.analysis.figures`` one step ahead, the model, and how it was learnt."""
    labels, energy = Labels.of(learned), learned.free_energy
    return [
        *(Sentence(caution, "Caution:") for caution in learned.cautions),
        _one_step(report["one_step_mspe"], labels),
        _prediction(report["prediction"], labels),
        *_model(labels, learned),
        *physical_blocks(learned.physical),
        *answer_blocks(learned.wind),
        Sentence(
            f"increased by {energy.gained:,.0f} nats in {len(energy) - 1} iterations, to {energy[-1]:,.0f}."
            f"{_convergence(learned) if learned.simulation_fit is None else ''}",
            "Free energy action F̄:",
        ),
        *_simulation_fit(labels, learned),
    ]


def _convergence(learned: Learned) -> str:
    """Whether the last fit converged."""
    return " Converged." if learned.converged else " Not converged."


def _simulation_fit(labels: Labels, learned: Learned) -> list[Block]:
    """The simulation-error fit after DEM, and the mixer geometry in its prior."""
    fit = learned.simulation_fit
    if fit is None:
        return []
    start, end = (sum(term[i] for term in fit.terms.values()) for i in (0, -1))
    blocks: list[Block] = [
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
            " and ".join(short(name) for name, way in zip(labels.input_names, turning, strict=True) if sign * way > 0)
            for sign in (1, -1)
        )
        source = "Estimated from the data" if learned.record.effect_directions is None else "Known for these inputs"
        blocks.append(Sentence(f"{up} against {down}. {source}.", "Mixer geometry, used as a prior:"))
    return blocks


def _prediction(found: dict[str, Any], labels: Labels) -> Sentence:
    """How far ahead predictions are worth something without the inputs."""
    each = ", ".join(
        f"{name} up to {seconds:.2g} s ahead" if seconds else f"{name} at no horizon"
        for name, seconds in zip(labels.output_names, found["half_explained_seconds"], strict=True)
    )
    return Sentence(
        f"they explain at least half of the variance of {each}, by predictions inside the training data.",
        "Predictions without the inputs:",
    )


def _one_step(errors: dict[str, Any], labels: Labels) -> Table:
    """RMSE by output on the training data, and the error ratio, by which the rows are ranked."""
    units = [readable(unit) for unit in labels.output_units]
    names = [named(name, unit.name) for name, unit in zip(labels.output_names, units, strict=True)]
    rows = [
        [
            name,
            *(f"{unit.scale * sqrt(square):.3g}" for unit, square in zip(units, error["per_output"], strict=True)),
            f"{error['relative']:.3g}",
        ]
        for name, error in errors.items()
    ]
    return Table(["RMSE, one step ahead, training data", *names, "error ratio"], rows)


def _in_degrees(value: float, unit: str) -> str:
    shown = readable(unit)
    return f" ({with_unit(value, shown, 3)})" if shown.name != unit else ""


def _model(labels: Labels, learned: Learned) -> list[Block]:
    """The model with all it takes to use it elsewhere: a table a matrix, a row a derivative."""
    model, states = learned.model, state_names(labels, learned)
    (n, r), m = model.B.shape, len(model.C)
    known = unpack(learned.known, n, r, m)
    A, B, C = (
        [[_entry(*cell) for cell in zip(*row, strict=True)] for row in zip(values, half, fixed, strict=True)]
        for values, half, fixed in zip(model[:3], learned.model_interval(LEVEL)[:3], known, strict=True)
    )
    derivatives, inputs = [f"d/dt {state}" for state in states], [short(name) for name in labels.input_names]
    constant = learned.scaling.constant
    if constant:
        inputs.append("d")
        B = [[*row, f"{value:.3g}"] for row, value in zip(B, model.offset, strict=True)]
    units = ", ".join(dict.fromkeys(unit for unit in (*labels.output_units, *labels.input_units) if unit))
    blocks: list[Block] = [
        Sentence(
            f"ẋ = A x + B (u − u₀){' + d' if constant else ''}, y = C x + y₀"
            f"{', C = [I 0]' if states_are_outputs(learned) else ''}, in {units or 'the units of the arrays'} and s. "
            f"± is the half width of the {100 * LEVEL:.0f} % interval, without the bias of the closed loop. Entries "
            "without ± are held by the prior.",
            "Model:",
        ),
        Table(["A", *states], [[name, *cells] for name, cells in zip(derivatives, A, strict=True)]),
        Table(["B", *inputs], [[name, *cells] for name, cells in zip(derivatives, B, strict=True)]),
    ]
    if states_are_outputs(learned) and len(states) == len(labels.output_names) + 1:
        blocks.append(Sentence(f"hidden 1 is the lag of the motors. {THREE_STATES}", "States:"))
    if not states_are_outputs(learned):
        blocks.append(
            Table(["C", *states], [[name, *cells] for name, cells in zip(labels.output_names, C, strict=True)])
        )
    return [
        *blocks,
        *_not_identifiable(labels, learned),
        Sentence(f"{_trim(labels.output_names, model.output_trim, labels.output_units)}.", "y₀:"),
        Sentence(f"{_trim(labels.input_names, model.input_trim, labels.input_units)}.", "u₀:"),
        Sentence(_poles(model.A), "Poles of A (1/s):"),
    ]


def _trim(names: Sequence[str], values: Array, units: Sequence[str]) -> str:
    return ", ".join(
        f"{name} {value:.4g} {unit}{_in_degrees(value, unit)}".rstrip()
        for name, value, unit in zip(names, values, units, strict=True)
    )


def _not_identifiable(labels: Labels, learned: Learned) -> list[Sentence]:
    if not learned.undetermined:
        return []
    directions, entries = learned.undetermined, parameter_names(labels, learned)
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


def _entry(value: float, half: float, fixed: bool) -> str:
    """An estimate with its interval; alone where it is fixed or has none."""
    return f"{value:.3g}" if fixed or not isfinite(half) else plus_minus(value, half)


def _poles(A: Array) -> str:
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
