"""Learning: F̄ and its terms, A, B and λ by iteration, each ending at the result with its interval."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.confidence import LEVEL, quantile
from mavdem.dem import Learned
from mavdem.dem.engine.model import pack
from mavdem.dem.priors import hyperparameter_groups, hyperparameter_prior
from mavdem.report.numbers import (
    Labelled,
    Labels,
    entries,
    left_free,
    place,
    plus_minus,
    readable,
    state_names,
    state_rate_units,
)
from mavdem.report.palette import MEASURED, distinct
from mavdem.view.chart import IterationCurve, iteration_chart

SIGMAS = quantile()  # half width of a Gaussian's interval, in standard deviations


def learning_view(recording: rr.RecordingStream, learned: Learned) -> rrb.Container:
    """Draws how a model was learnt; returns the charts, two by two."""
    charts = [
        ("free_energy", "F̄ and its terms by iteration, each minus its final value, nats", _free_energy(learned)),
        ("lambda", "λ by iteration: log precisions of the noise that the prior leaves free", _precisions(learned)),
        *((f"parameters/{name}", title, curves) for name, title, curves in _parameters(learned)),
    ]
    views = [iteration_chart(recording, f"learning/{origin}", title, curves) for origin, title, curves in charts]
    return rrb.Grid(*views, grid_columns=2, name="Learning")


def _free_energy(learned: Learned) -> list[IterationCurve]:
    """The total, then each term; DEM's own, before the simulation-error fit."""
    energy = learned.free_energy
    series = {"F̄": energy.total, **{name.removeprefix("prediction "): term for name, term in energy.terms.items()}}
    return [
        IterationCurve(
            name,
            distinct(i - 1) if i else MEASURED,
            term - term[-1],
            0.0,
            0.0,
            f"{name} {round(float(term[-1])) + 0:,}",
        )
        for i, (name, term) in enumerate(series.items())
    ]


def _precisions(learned: Learned) -> list[IterationCurve]:
    learning, labels = learned.learning, Labels.of(learned)
    names, fixed = precision_names(labels, learned), prior_outweighs_data(learned)
    curves = []
    for i in np.flatnonzero(fixed if fixed.all() else ~fixed):
        values, half = learning.lambda_[:, i], SIGMAS * float(learning.lambda_sd[-1, i])
        label = f"{names[i]} {plus_minus(values[-1], half)}"
        curves.append(IterationCurve(names[i], distinct(int(i)), values, float(values[-1]), half, label))
    return curves


def _parameters(learned: Learned) -> Iterator[tuple[str, str, list[IterationCurve]]]:
    """Of each matrix with free entries: its name, a title, and its curves; angles in degrees."""
    labels, learning = Labels.of(learned), learned.learning
    final, halves = (pack(*model[:3]) for model in (learned.model, learned.model_interval(LEVEL)))
    factors, first = scales(labels, learned), 0
    for matrix, free in left_free(learned).items():
        curves = []
        for colour, i in enumerate(np.flatnonzero(free)):
            row, column = entries(labels, learned)[matrix][i]
            at, scale = first + int(i), factors[matrix][i]
            value, half, name = scale * final[at], scale * halves[at], f"{place(row)} ← {place(column)}"
            label = f"{name} {plus_minus(value, half) if np.isfinite(half) else format(value, '.3g')}"
            curves.append(IterationCurve(name, distinct(colour), scale * learning.theta[:, at], value, half, label))
        first += len(free)
        if curves:
            yield (
                matrix,
                f"{matrix} by iteration of DEM, then the result ± {100 * LEVEL:.0f} % interval (degrees, s)",
                curves,
            )


def scales(labels: Labelled, learned: Learned) -> dict[str, NDArray[np.float64]]:
    """What each entry of A, B and C is multiplied with for degrees, in the order of θ."""
    rows = [readable(unit).scale for unit in state_rate_units(labels, learned)]
    inputs, outputs = [1.0] * len(labels.input_names), [readable(unit).scale for unit in labels.output_units]
    return {
        "A": np.divide.outer(rows, rows).ravel(),
        "B": np.divide.outer(rows, inputs).ravel(),
        "C": np.divide.outer(outputs, rows).ravel(),
    }


def precision_names(labels: Labelled, learned: Learned) -> list[str]:
    """The name of each λ: of the measurement noise z, then of the process noise w."""
    states, outputs = state_names(labels, learned), labels.output_names
    of_outputs, of_states = hyperparameter_groups(learned.settings, len(states), len(outputs))
    return _by_group("z", outputs, of_outputs) + _by_group("w", states, of_states)


def _by_group(noise: str, channels: Sequence[str], groups: NDArray[np.intp]) -> list[str]:
    """The channels that share each λ of a noise, "z" or "w"."""
    names = [
        " and ".join(channel for channel, group in zip(channels, groups, strict=True) if group == own)
        for own in np.unique(groups)
    ]
    return (
        [{"z": "z, measurement", "w": "w, process"}[noise]] if len(names) == 1 else [f"{noise} of {n}" for n in names]
    )


def prior_outweighs_data(learned: Learned) -> NDArray[np.bool_]:
    """Which λ, (g,), have more precision from the prior than from the data: the prior fixes them in effect."""
    posterior = 1 / learned.learning.lambda_sd[-1] ** 2
    m, n = learned.model.C.shape
    _, prior = hyperparameter_prior(learned.settings, n, m)
    return np.asarray(posterior < 2 * np.diag(prior))
