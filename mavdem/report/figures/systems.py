"""Systems: what the axis's command does to a vehicle, over frequency (Bode) and over time (step).

Each curve is of linear systems: the model or the physical parameters, and draws from their uncertainty, of which the
bands are percentiles.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray
from scipy.linalg import expm

from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import pack, unpack
from mavdem.report.figures.style import (
    HAIRLINE,
    Room,
    band,
    legend_above,
    not_blown_up,
    note,
    picture,
)
from mavdem.report.labels import AxisCommand, Labels
from mavdem.report.numbers import per, readable
from mavdem.report.palette import PHYSICAL, PREDICTED, TRUTH

Complex = NDArray[np.complex128]
Truth = tuple[Array, Array, float]

DRAWS = 400
MAX_WIDER = 4.0  # by which factor a band may widen the range of magnitudes


class Systems(NamedTuple):
    """N linear systems ẋ = A x + b c, y = C x that one command c drives, ``delay`` seconds late.

    The first is the estimate; others are draws from its uncertainty. A (N, n, n), b (N, n), C (N, m, n), delay (N,).
    """

    A: Array
    b: Array
    C: Array
    delay: Array

    def over_frequency(self, frequency: Array, output: int) -> Complex:
        """Returns (N, F) of one output to the command at ``frequency`` (F,), Hz."""
        s = 2j * np.pi * frequency
        resolvent = s[:, None, None] * np.eye(self.A.shape[-1]) - self.A[:, None]
        pushed = np.broadcast_to(self.b[:, None, :, None], (*resolvent.shape[:-1], 1))
        states = np.linalg.solve(resolvent, pushed)[..., 0]
        return np.asarray(
            (states * self.C[:, None, output]).sum(axis=-1) * np.exp(-self.delay[:, None] * s)
        )

    def after_step(self, time: Array) -> Array:
        """Returns (N, T, m): the outputs after the command's step from 0 to 1 at 0 s, at (T,) s evenly from 0 on."""
        n = self.A.shape[-1]
        generator = np.zeros((len(self.A), n + 1, n + 1))
        generator[:, :n, :n] = self.A
        generator[:, :n, n] = self.b
        flow = expm(generator * (time[1] - time[0]))
        states = [np.repeat(np.eye(n + 1)[-1:], len(self.A), axis=0)]
        for _ in time[1:]:
            states.append(np.einsum("nij,nj->ni", flow, states[-1]))
        outputs = np.einsum("nmi,tni->nmt", self.C, np.array(states)[..., :n])
        late = [
            [np.interp(time - wait, time, output, left=0.0) for output in system]
            for system, wait in zip(outputs, self.delay.tolist(), strict=True)
        ]
        return np.swapaxes(np.array(late), 1, 2)


def model_systems(learned: Learned, motors: Array, seed: int = 0) -> Systems:
    """Returns DEM's model and ``DRAWS`` of it, driven by a command that moves the ``motors`` (r,).

    By the posterior, with Student's distribution where it is that of a simulation-error fit.
    """
    A, B, C = learned.model[:3]
    theta = pack(A, B, C)
    found = learned.simulation_fit
    rng = np.random.default_rng(seed)
    away = _normal(rng, learned.theta_covariance)
    if found is not None:
        away /= np.sqrt(rng.chisquare(found.freedom, (DRAWS, 1)) / found.freedom)
    (n, r) = B.shape
    m = len(C)
    drawn = (unpack(row, n, r, m) for row in theta + np.vstack([0 * theta, away]))
    As, Bs, Cs = map(np.array, zip(*drawn, strict=True))
    return Systems(As, Bs @ motors, Cs, np.zeros(DRAWS + 1))


def physical_systems(physical: Physical, motors: Array, outputs: int, seed: int = 0) -> Systems:
    """Returns physical parameters and ``DRAWS`` of them; ``outputs`` are 2, angle and rate, or 1, the rate alone."""
    theta = physical.draws(DRAWS, seed)
    effect = theta[:, :-3] @ motors
    (damping, lag, delay) = theta[:, -3:].T
    A = np.zeros((len(theta), 3, 3))
    b = np.zeros((len(theta), 3))
    A[:, 0, 1] = A[:, 1, 2] = 1.0
    A[:, 1, 1] = -damping
    A[:, 2, 2] = -1 / lag
    b[:, 2] = effect / lag
    first = 2 - outputs
    C = np.broadcast_to(np.eye(outputs, 3 - first), (len(theta), outputs, 3 - first))
    return Systems(A[:, first:, first:], b[:, first:], C, delay)


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(DRAWS, k) about 0, of a covariance (k, k) that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray(
        rng.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(values.clip(0))).T
    )


class SystemPlots:
    """The figures of a model as a system; :class:`mavdem.report.figures.Plots` has them."""

    learned: Learned

    def bode(self, output: int = -1, truth: Truth | None = None, model: str = "physical") -> Figure:
        """Draws magnitude and phase of an ``output`` over frequency, from the axis's command, with 90 % bands.

        Of the physical plant; where it is not identifiable, or as ``model="dem"``, of DEM's model. The
        output is the last one, a rate, unless given; ``truth`` is A (n, n) and B (n, r) of a simulated vehicle, whose
        first states are the outputs, and its delay, s.
        """
        learned = self.learned
        command = AxisCommand.of(learned)
        labels = Labels.of(learned)
        output = range(len(labels.output_names))[output]
        unit = readable(labels.output_units[output])
        # What is faster than 0.4 of the sampling rate cannot be asked of the model.
        frequency = np.geomspace(0.1, min(20.0, 0.4 / learned.dt), 200)
        with picture(3.7, Room(left=0.75)) as figure:
            above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
            magnitudes = list[Array]()
            phases = list[Array]()
            for name, colour, systems in _curves(learned, command.motors, truth, model):
                response = systems.over_frequency(frequency, output)
                phase = np.degrees(
                    np.unwrap(np.angle(response[0])) + np.angle(response / response[0])
                )
                for axes, values, estimates in (
                    (above, unit.scale * np.abs(response), magnitudes),
                    (below, phase, phases),
                ):
                    draw(axes, frequency, values, name, colour)
                    estimates.append(values[0])
            above.set(xscale="log", yscale="log")
            above.set_ylabel(
                f"{labels.output_names[output]} by {command.name}\n({per(unit, command.unit)})"
            )
            lowest = np.min(magnitudes) / MAX_WIDER
            highest = np.max(magnitudes) * MAX_WIDER
            above.set_ylim(*np.clip(above.get_ylim(), lowest, highest))
            below.set(xlabel="frequency (Hz)", ylabel="phase (°)")
            below.set_ylim(*np.clip(below.get_ylim(), np.min(phases) - 90, np.max(phases) + 90))
            below.yaxis.set_major_locator(
                MultipleLocator(45 if np.ptp(below.get_ylim()) < 200 else 90)
            )
            for axis in (below.xaxis, above.yaxis):
                axis.set_major_formatter("{x:g}")
            legend_above(above)
            note(figure, _remark(learned, model))
        return figure

    def step(self, truth: Truth | None = None) -> Figure:
        """Draws each output after a step of the axis's command at 0 s, from trim, with 90 % bands.

        The step is as large as the standard deviation of the command in the flight, to one digit; ``truth`` is as for
        :meth:`bode`.
        """
        learned = self.learned
        command = AxisCommand.of(learned)
        labels = Labels.of(learned)
        size = float(f"{command.series(learned.record.inputs).std():.1g}") or 1.0
        time = np.linspace(0.0, 1.5, 151)
        outputs = len(labels.output_names)
        with picture(1.5 + 1.2 * outputs, Room()) as figure:
            rows = np.atleast_1d(figure.subplots(outputs, 1, sharex=True))
            drawn = _curves(learned, command.motors, truth)
            curves = [
                (name, colour, size * systems.after_step(time)) for name, colour, systems in drawn
            ]
            for output, axes in zip(reversed(range(outputs)), rows, strict=True):
                unit = readable(labels.output_units[output])
                axes.axhline(0, **HAIRLINE)
                for name, colour, values in curves:
                    draw(axes, time, unit.scale * values[..., output], name, colour)
                axes.set_ylabel(f"{labels.output_names[output]} ({unit.name})")
                not_blown_up(axes, [unit.scale * values[0, :, output] for *_, values in curves])
            step = f"{size:g} {command.unit}".rstrip()
            rows[-1].set_xlabel(f"time after a step of {step} in the {command.name} (s)")
            legend_above(rows[0])
            note(figure, _remark(learned))
        return figure


def _curves(
    learned: Learned, motors: Array, truth: Truth | None, model: str = "both"
) -> Iterator[tuple[str, str, Systems]]:
    """Name, colour and systems of each curve; DEM's model where there is no plant, whatever the ``model``."""
    outputs = learned.record.outputs.shape[1]
    physical = _plant(learned)
    if physical is not None and model != "dem":
        yield "physical parameters", PHYSICAL, physical_systems(physical, motors, outputs)
    if physical is None or model != "physical":
        yield "DEM's model", PREDICTED, model_systems(learned, motors)
    if truth is not None:
        A, B, delay = truth
        known = A, B @ motors, np.eye(outputs, len(A)), np.array(delay)
        yield "truth", TRUTH, Systems(*(one[None] for one in known))


def draw(axes: Axes, x: Array, values: Array, name: str, colour: str) -> None:
    """Draws the estimate, ``values`` (N, T)[0], and the band of the draws; dashed where there are none."""
    certain = len(values) == 1
    axes.plot(x, values[0], color=colour, label=name, linestyle=(0, (4, 2)) if certain else "-")
    if not certain:
        low, high = np.percentile(values[1:], (50 * (1 - LEVEL), 50 * (1 + LEVEL)), axis=0)
        band(axes, x, low, high, colour)


def _remark(learned: Learned, model: str = "both") -> str:
    if learned.physical is not None and not learned.physical.identifiable:
        return (
            "Control effectiveness is not identifiable in this flight: its response may be far off."
        )
    remark = "Bands: 90 %. That of DEM's model leaves out the bias of the closed loop."
    plant = _plant(learned)
    if plant is None:
        return remark
    doubts = ", ".join(
        f"{name} {status}" for name, status in plant.status.items() if status != "reported"
    )
    doubts = f" Of the plant: {doubts}." if doubts else ""
    if model == "physical":
        return f"Band: 90 %, of the posterior; the delay of the commands is in the phase.{doubts}"
    return (
        f"{remark} Where the two differ, the physical parameters are what the vehicle does.{doubts}"
    )


def _plant(learned: Learned) -> Physical | None:
    """The physical parameters, where they are identifiable, and their outputs are those of the model."""
    physical = learned.physical
    outputs = learned.record.outputs.shape[1]
    return physical if physical is not None and outputs <= 2 and physical.identifiable else None
