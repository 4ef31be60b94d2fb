"""Details: the model, its uncertainty and how it was learned: all that the screen leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, pi, sqrt
from typing import Any

import numpy as np

from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import unpack
from mavdem.dem.graybox.identifiability import CHANGED
from mavdem.report import numbers
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import TORQUE, Labels, listed, plus_minus, readable, short
from mavdem.report.screen import parameter_reasons


def detail_blocks(learned: Learned, report: dict[str, Any] | None = None) -> list[Block]:
    """Returns cautions, errors one step ahead by ``report``, ``LogAnalysis.as_dict()``, and the ``learned`` model."""
    labels, energy = Labels.of(learned), learned.free_energy
    converged = "Converged." if learned.converged else "Not converged."
    end = "" if learned.simulation_fit is not None else f" {converged}"
    return [
        *(Sentence(caution, "Caution:") for caution in learned.cautions),
        *([] if report is None else _one_step(report, labels)),
        *_model(labels, learned),
        *_physical(learned.physical, bool((report or {}).get("overrides"))),
        Sentence(
            f"increased by {energy.gained:,.0f} nats in {len(energy) - 1} iterations, to {energy[-1]:,.0f}.{end}",
            "Free energy action F̄ of A, B and C:",
        ),
        *_simulation_fit(learned, converged),
        *_joint(labels, learned),
    ]


def _one_step(report: dict[str, Any], labels: Labels) -> list[Block]:
    """RMSE by output on the training data, and how far ahead predictions are worth something without the inputs."""
    names, units = numbers.outputs_of(labels)
    rows = []
    for name, error in report["one_step_mspe"].items():
        rmse = (unit.scale * sqrt(square) for unit, square in zip(units, error["per_output"], strict=True))
        rows.append([name, *(f"{value:.3g}" for value in (*rmse, error["relative"]))])
    seconds = zip(labels.output_names, report["prediction"]["half_explained_seconds"], strict=True)
    ahead = ", ".join(f"{name} up to {s:.2g} s ahead" if s else f"{name} at no horizon" for name, s in seconds)
    text = f"they explain at least half of the variance of {ahead}, by predictions inside the training data."
    return [
        Table(["RMSE, one step ahead, training data", *names, "error ratio"], rows),
        Sentence(text, "Predictions without the inputs:"),
    ]


def _model(labels: Labels, learned: Learned) -> list[Block]:
    """The model with all it takes to use it elsewhere: a table a matrix, a row a derivative."""
    model, outputs = learned.model, numbers.states_are_outputs(learned)
    states = numbers.state_names(labels.output_names, learned)
    (n, r), m, half = model.B.shape, len(model.C), learned.model_interval(LEVEL)
    known = unpack(learned.known, n, r, m)
    derivatives, inputs = [f"d/dt {state}" for state in states], [short(name) for name in labels.input_names]

    def table(which: int, columns: Sequence[str], rows: Sequence[str]) -> Table:
        cells = zip(rows, model[which], half[which], known[which], strict=True)
        return Table(["ABC"[which], *columns], [[head, *map(_entry, *row)] for head, *row in cells])

    A, B, C = table(0, states, derivatives), table(1, inputs, derivatives), table(2, states, labels.output_names)
    constant = learned.scaling.constant
    if constant:
        B.header.append("d")
        for row, value in zip(B.rows, model.offset, strict=True):
            row.append(f"{value:.3g}")
    units = ", ".join(dict.fromkeys(unit for unit in (*labels.output_units, *labels.input_units) if unit))
    blocks: list[Block] = [
        Sentence(
            f"ẋ = A x + B (u − u₀){' + d' if constant else ''}, y = C x + y₀{', C = [I 0]' if outputs else ''}, in "
            f"{units or 'the units of the arrays'} and s. ± is the half width of the {100 * LEVEL:.0f} % interval, "
            "without the bias of the closed loop. Entries without ± are held by the prior.",
            "Model:",
        ),
        A,
        B,
    ]
    if outputs and len(states) == len(labels.output_names) + 1:
        blocks.append(Sentence(f"hidden 1 is the motors' lag. {numbers.THREE_STATES}", "States:"))
    if not outputs:
        blocks.append(C)
    if count := len(learned.undetermined):
        text = (
            f"{count} combination{'s' * (count > 1)} of parameters: the data contain less information than the prior."
        )
        blocks.append(Sentence(text, "Not identifiable:"))
    return [
        *blocks,
        Sentence(f"{_trim(labels.output_names, model.output_trim, labels.output_units)}.", "y₀:"),
        Sentence(f"{_trim(labels.input_names, model.input_trim, labels.input_units)}.", "u₀:"),
        Sentence(_poles(model.A), "Poles of A (1/s):"),
    ]


def _entry(value: float, half: float, fixed: bool) -> str:
    """An estimate with its interval; alone where it is fixed or has none."""
    return f"{value:.3g}" if fixed or not isfinite(half) else plus_minus(value, half)


def _trim(names: Sequence[str], values: Array, units: Sequence[str]) -> str:
    """Each value in its own unit, and that of an angle in degrees too."""
    shown = []
    for name, value, unit in zip(names, values, units, strict=True):
        degrees = readable(unit)
        also = f" ({numbers.with_unit(value, degrees, 3)})" if degrees.name != unit else ""
        shown.append(f"{name} {value:.4g} {unit}{also}".rstrip())
    return ", ".join(shown)


def _poles(A: Array) -> str:
    """The eigenvalues of A, the slowest first, one of each complex pair, and whether the model is stable."""
    poles = sorted((value for value in np.linalg.eigvals(A) if value.imag >= 0), key=lambda value: -value.real)
    return f"{'; '.join(map(_pole, poles))}. The model is {'unstable' if poles[0].real > 0 else 'stable'}."


def _pole(pole: complex) -> str:
    """With natural frequency |p|/2π and damping ratio −Re p/|p| if complex, else with the time constant 1/|p|."""
    size = abs(pole)
    if pole.imag:
        damping = -pole.real / size + 0.0
        return f"{pole.real:.3g} ± {pole.imag:.3g}j: {size / (2 * pi):.2g} Hz, damping ratio {damping:.2g}"
    if not pole.real:
        return "0: integrator"
    seconds = float(f"{1 / size:.2g}")
    return f"{pole.real:.3g}: {'grows with ' if pole.real > 0 else ''}time constant {seconds:g} s"


def _physical(physical: Physical | None, doubted: bool) -> list[Block]:
    """How the physical parameters were fitted, and each window's own, where they differ by more than chance."""
    if physical is None:
        return []
    windows, reasons = physical.windows, parameter_reasons(physical, doubted)
    refinements = listed(physical.refinements)
    refined = f" Unseen windows are predicted better with: {refinements}." if refinements else ""
    count = f"{len(windows.start)} windows, fitted together," if len(windows.start) > 1 else "one window"
    text = f"{count} by a model of these parameters and the wind only, beside DEM's.{refined} {' '.join(reasons)}"
    blocks: list[Block] = [Sentence(text.rstrip(), "Physical parameters (gray-box model):")]
    if CHANGED in " ".join(physical.reasons.values()):
        columns = (windows.start, TORQUE.scale * windows.effect, windows.damping, 1e3 * windows.lag)
        rows = [
            [f"{start:.0f} s", f"{effect:.3g}", f"{damping:.2g}", f"{lag:.2g}", f"{wind:.3g}"]
            for start, effect, damping, lag, wind in zip(*columns, TORQUE.scale * windows.wind, strict=True)
        ]
        header = ["mean effectiveness", "rate damping (1/s)", "time constant (ms)", "wind torque (°/s²)"]
        blocks.append(Table(["window from", *header], rows))
    return blocks


def _joint(labels: Labels, learned: Learned) -> list[Block]:
    """What F̄ chose of the joint model, and which motors it takes to turn the axis."""
    joint, record = learned.joint, learned.record
    form = "smooth" if joint.choice.smooth else "plain"
    text = (
        f"each sample from the {joint.choice.lags} before it ({1e3 * joint.choice.lags * learned.dt:.0f} ms), {form} "
        f"prior of precision {joint.choice.ridge:g}; F̄ {joint.free_energy:,.0f} nats, the highest of those tried."
    )
    blocks: list[Block] = [Sentence(text, "Joint model of outputs and motors:")]
    if joint.combinations.shape[1] < record.inputs.shape[1]:
        up, down = (
            " and ".join(
                short(name)
                for name, way in zip(labels.input_names, joint.combinations[:, 0], strict=True)
                if sign * way > np.abs(joint.combinations).max() / 4
            )
            for sign in (1, -1)
        )
        source = "Chosen by F̄" if record.effect_directions is None else "Known for these inputs"
        blocks.append(Sentence(f"{up} against {down}. {source}.", "Motors that turn the axis:"))
    return blocks


def _simulation_fit(learned: Learned, converged: str) -> list[Block]:
    """The simulation-error fit after DEM."""
    fit = learned.simulation_fit
    if fit is None:
        return []
    start, end = (sum(term[i] for term in fit.terms.values()) for i in (0, -1))
    text = (
        f"over {fit.horizon * learned.dt:.2g} s: {len(fit.free)} parameters, effective sample size "
        f"{fit.effective_samples:.0f}; F̄ increased by another {end - start:.3g} nats. {converged}"
    )
    return [Sentence(text, "Simulation-error (output-error) fit of A, B and C")]
