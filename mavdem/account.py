"""Account: what is told of a learnt flight, in sentences and tables, the verdict first; who tells it lays it out."""

from __future__ import annotations

from math import floor, inf, isfinite, log10, pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavdem.dem import Learned
from mavdem.dem.model import unpack
from mavdem.flight import Flight
from mavdem.naming import named, parameter_names, readable, short, state_names, states_are_outputs

LEVEL = 0.9
"""Probability of the intervals that are told."""

NAMED, SHARE = 4, 0.3
"""Of a combination of parameters so many are named at most, if they have this share of the largest weight."""


class Sentence(NamedTuple):
    """Something said; ``lead`` are words to set off at its beginning, where there are any."""

    text: str
    lead: str = ""


class Table(NamedTuple):
    """Cells as they are to be read: the first column names the rows, the others are numbers."""

    header: list[str]
    rows: list[list[str]]


def account(report: dict[str, Any], train: Flight, test: Flight, learned: Learned) -> list[Sentence | Table]:
    """What a user must know of a learnt flight, then what can be known, in this order.

    Args:
        report: of ``mavdem.evaluate.report``.
        train, test, learned: what it is about.
    """
    return [
        Sentence("", lead=_verdict(report["forecast_mspe"], test.duration)),
        *(Sentence(caution, "Caution:") for caution in learned.cautions),
        Sentence(
            f"{Path(str(train.provenance.get('source', 'the arrays'))).name}, {len(train)} samples "
            f"({train.duration:.2f} s at {1 / train.dt:.0f} Hz), and tried on the {len(test)} after them.",
            "Learnt from",
        ),
        _errors(f"{len(test)} steps ahead, rms", report["forecast_mspe"], train),
        _errors("one step ahead, rms", report["one_step_mspe"], train),
        Sentence(
            "Over constant mean: mean square, each output in units of its training variance, over the constant mean's. "
            f"{100 * report['inside_90_percent_band']:.0f} % of the held-out samples lie in the forecast's 90 % band. "
            f"With these inputs it expected a mean square error of {_ratio(report['expected_error'])} training "
            "variances."
        ),
        *_model(train, learned),
        *_physical(train, learned),
        Sentence(
            f"The free energy action F̄ rose by {learned.free_energy.gained:,.0f} nats in "
            f"{len(learned.free_energy) - 1} iterations, to {learned.free_energy[-1]:,.0f}."
        ),
        *_trajectories(train, learned),
    ]


def _trajectories(train: Flight, learned: Learned) -> list[Sentence | Table]:
    """How θ climbed on, and what was taken for granted."""
    trajectory = learned.trajectory
    if trajectory is None:
        return []
    turning = None if trajectory.layout is None else trajectory.layout.turning
    layout = ""
    if turning is not None:
        up, down = (
            " and ".join(short(name) for name, way in zip(train.input_names, turning, strict=True) if sign * way > 0)
            for sign in (1, -1)
        )
        layout = f" Of the ways rotors may stand, {up} against {down} fits best, and was leant on."
    log_joint = [sum(term[i] for term in trajectory.terms.values()) for i in (0, -1)]
    return [
        Sentence(
            f"Along trajectories of {trajectory.horizon * learned.dt:.2g} s, in which {trajectory.numbers:.0f} numbers "
            f"are news to {len(trajectory.places)} parameters, it rose by {log_joint[1] - log_joint[0]:.3g} nats more."
            + layout
        )
    ]


def _verdict(errors: dict[str, Any], seconds: float) -> str:
    """What the forecast is worth, beside the forecasts that know nothing."""
    ours = errors["DEM"]["relative"]
    if not ours < 1:
        return (
            f"On the held-out {seconds:.3g} s this model is worse than a constant ({_ratio(ours)}): do not use it; "
            "try another --start, more --train, or a livelier stretch."
        )
    told = f"On the held-out {seconds:.3g} s this model errs {_ratio(ours)} times as much as the constant mean"
    best = next(iter(errors))
    if best != "DEM":
        return f"{told}, but “{best}”, which needs no model, errs less ({_ratio(errors[best]['relative'])})."
    return f"{told}."


def _errors(title: str, errors: dict[str, Any], train: Flight) -> Table:
    """Root mean squared errors, which have the unit of what is predicted, and the one figure to rank by."""
    units = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, units, strict=True)]
    rows = []
    for prediction, error in errors.items():
        rms = [unit.scale * sqrt(square) for unit, square in zip(units, error["per_output"], strict=True)]
        rows.append([prediction, *(f"{value:.3g}" for value in rms), _ratio(error["relative"])])
    return Table([title, *columns, "over constant mean"], rows)


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
        ["times", *(f"d {state}/dt" for state in states)],
        [[cause, *cells] for cause, cells in zip([*states, *map(short, train.input_names)], A + B, strict=True)],
    )
    if learned.scaling.constant:
        derivatives.rows.append(["constant", *(f"{value:.3g}" for value in model.offset)])
    units = ", ".join(dict.fromkeys(unit for unit in (*train.output_units, *train.input_units) if unit))
    blocks: list[Sentence | Table] = [
        Sentence(
            f"x' = A x + B (u - trim){' + constant' if learned.scaling.constant else ''}, y = C x + trim"
            f"{', C = [I 0]' if states_are_outputs(learned) else ''}, in {units or 'the units of the arrays'} and s. "
            "A derivative is the sum down its column, each entry times what its row names:",
            "Model:",
        ),
        derivatives,
    ]
    if not states_are_outputs(learned):
        blocks.append(Sentence("An output is the sum down its column, and its trim:", "Outputs:"))
        blocks.append(
            Table(
                ["times", *train.output_names],
                [[state, *cells] for state, cells in zip(states, C, strict=True)],
            )
        )
    return [
        *blocks,
        *_precision(learned),
        *_undetermined(train, learned),
        Sentence(
            "; ".join(
                ", ".join(f"{name} {value:.4g} {unit}".rstrip() for name, value, unit in zip(*trims, strict=True))
                for trims in (
                    (train.output_names, model.output_trim, train.output_units),
                    (train.input_names, model.input_trim, train.input_units),
                )
            )
            + ".",
            "Trim:",
        ),
        *(Sentence(sentence) for sentence in [_stability(model.A)] if sentence),
    ]


def _physical(train: Flight, learned: Learned) -> list[Sentence]:
    """What the vehicle is made of, as far as the flight tells."""
    read = learned.physical
    if read is None:
        return []
    if read.caution is not None:
        return [Sentence(read.caution, "Physical reading:")]
    motors, damping, lag = read.interval(LEVEL)
    each = ", ".join(
        f"{short(name)} {effect:.3g} ± {half:.1g}"
        for name, effect, half in zip(train.input_names, read.motors, motors, strict=True)
    )
    unit = f" rad/s² per {train.input_units[0]}" if train.input_units[0] else ""
    return [
        Sentence(
            f"Motors, once settled, {each}{unit}; damping {read.damping:.3g} ± {damping:.1g} 1/s; "
            f"lag {1e3 * read.lag:.3g} ± {1e3 * lag:.1g} ms; ± as above. Read by a model of no more than "
            "these numbers and the wind, beside DEM's.",
            "Physical reading:",
        )
    ]


def _precision(learned: Learned) -> list[Sentence]:
    if learned.scatter is None:
        return []
    return [
        Sentence(
            f"± is half the interval that holds the parameter with probability {LEVEL:.0%}, were it not for motors "
            "that answer the very wind which is called noise (see Limits in the README)."
        )
    ]


def _undetermined(train: Flight, learned: Learned) -> list[Sentence]:
    if not learned.undetermined:
        return []
    directions, entries = learned.undetermined, parameter_names(train, learned)
    least = directions[0].weights
    largest = np.argsort(-np.abs(least))[:NAMED]
    least = least * np.sign(least[largest[0]])
    combination = " ".join(
        f"{'-' if least[i] < 0 else '+'} {abs(least[i]):.2g} ({entries[i]})"
        for i in largest
        if abs(least[i]) > SHARE * np.abs(least).max()
    ).removeprefix("+ ")
    return [
        Sentence(
            f"the data tell less than the prior about {_count(len(directions), 'combination')} of parameters, least "
            f"about {combination}, in units of the prior's deviations.",
            "Undetermined:",
        )
    ]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' if number > 1 else ''}"


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


def _stability(A: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    """Each motion of its own that the model has, as the time in which it dies out or grows e-fold.

    A model's cautions tell that it is unstable and the fastest growth: those are not told again.
    """
    # One of each complex pair.
    modes = sorted((value for value in np.linalg.eigvals(A) if value.imag >= 0), key=lambda value: -value.real)
    growing, dying = ([_mode(value) for value in modes if (value.real > 0) == grows] for grows in (True, False))
    constants = f"with time constant{'s' if len(dying) > 1 else ''} {_listed(dying)}"
    if not growing:
        return f"It is stable: disturbances die out {constants}."
    rest = f"What does not grow dies out {constants}." if dying else ""
    if len(growing) == 1 and not modes[0].imag:
        return rest
    return f"What grows does so e-fold in {_listed(growing)}. {rest}".rstrip()


def _mode(eigenvalue: complex) -> str:
    """1/|Re| and, for a complex pair, |Im|/2π."""
    seconds = 1 / abs(eigenvalue.real) if eigenvalue.real else inf
    swing = f" (swinging at {eigenvalue.imag / (2 * pi):.2g} Hz)" if eigenvalue.imag else ""
    return f"{seconds:.2g} s{swing}"


def _listed(parts: list[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
