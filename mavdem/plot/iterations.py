"""Learning: the free energy action F̄ with its terms and the parameters, by iteration."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.dem.engine.model import pack, unpack
from mavdem.dem.engine.trace import FreeEnergy
from mavdem.plot.style import HAIRLINE, picture
from mavdem.report.names import left_free
from mavdem.report.palette import MEASURED, PREDICTED, distinct

Array = NDArray[np.float64]

END = 1.06  # of the iterations, where the final parameters stand
SHOWN_TERMS = 6
LINEAR_NATS = 10.0  # below which the terms' axis is linear
SMALLEST_GAIN = 1e-3  # nats: less is no more learning


def learning(learned: Learned) -> Figure:
    """F̄ below its final value and the terms it is the sum of, then the free entries of A, B and C, by iteration.

    Iteration 0 is the prior. Each entry is in units of its largest magnitude; dots are the values after the
    simulation-error fit, which continues from the last iteration.

    Args:
        learned: the model with its iterations.
    """
    energy = learned.free_energy
    with picture(4.4) as figure:
        action, terms, parameters = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 4, 4]})
        gap = np.maximum(energy.total.max() - energy.total, SMALLEST_GAIN)
        action.plot(gap, color=PREDICTED, marker="o", markersize=2.5)
        action.set(
            yscale="log",
            ylabel="nats",
            title=f"F̄ below its maximum of {energy.total.max():,.0f} nats".replace("-", "−"),
        )
        _terms(terms, energy)
        _parameters(parameters, learned)
        parameters.xaxis.set_major_locator(MaxNLocator(integer=True))
        parameters.set(xlabel="iteration", xlim=(0, END * (len(energy) - 1)))
    return figure


def _terms(axes: Axes, energy: FreeEnergy) -> None:
    """Those that change most, less their last value: where F̄ increases, the sum of all does."""
    change = {name: term - term[-1] for name, term in energy.terms.items()}
    largest = sorted(change, key=lambda name: -np.abs(change[name]).max())[:SHOWN_TERMS]
    axes.axhline(0, **HAIRLINE)
    for number, name in enumerate(name for name in change if name in largest):
        axes.plot(change[name], color=distinct(number), label=name.replace("prediction error of", "error of"))
    axes.set_yscale("symlog", linthresh=LINEAR_NATS)
    axes.set(ylabel="nats", title="terms of F̄, less their last value")
    axes.yaxis.set_major_locator(FixedLocator([-1e6, -1e3, 0, 1e3, 1e6]))
    axes.yaxis.set_minor_locator(NullLocator())
    _legend_beside(axes)


def _parameters(axes: Axes, learned: Learned) -> None:
    model, last = learned.model, len(learned.free_energy) - 1
    (n, r), m = model.B.shape, len(model.C)
    values = np.vstack([learned.learning.theta, pack(*model[:3])])
    largest = np.abs(values).max(axis=0)
    values = values / np.where(largest > 0, largest, 1.0)
    end = last * END
    axes.axhline(0, **HAIRLINE)
    places = dict(zip("ABC", unpack(np.arange(values.shape[1]), n, r, m), strict=True))
    for number, (name, free) in enumerate(left_free(learned).items()):
        own = places[name].ravel()[free]
        if len(own):
            axes.plot(values[:-1, own], color=distinct(number), linewidth=1.1)
            axes.plot([], [], color=distinct(number), label=f"entries of {name}")
            axes.plot([last, end], values[-2:, own], color=distinct(number), linewidth=0.7, linestyle=":")
            axes.plot(np.full(len(own), end), values[-1, own], "o", color=distinct(number), markersize=4, clip_on=False)
    axes.plot([], [], "o", color=MEASURED, markersize=4, label="after the last fit")
    axes.set(ylabel="share of largest", title="parameters", ylim=(-1.08, 1.08))
    _legend_beside(axes)


def _legend_beside(axes: Axes) -> None:
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
