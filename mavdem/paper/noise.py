"""Section V.C: is the process noise Gaussian, and is it coloured?"""

from __future__ import annotations

from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from mavdem.dem import learn
from mavdem.evaluate import Noise, analyse_noise, process_noise
from mavdem.evaluate.windows import Window
from mavdem.paper.checks import Check
from mavdem.paper.claims import NOISE
from mavdem.paper.drawing import DEM, MEASURED, ONE_STEP, ink
from mavdem.paper.flights import REAL
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import PAPER, Runner
from mavdem.paper.words import number
from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.truth import axis

LEVEL = 0.01  # of each test; with five tests, one report in twenty rejects a true hypothesis

ROLL_RATE = 1
SHARED = 3  # samples that a second-order derivative is estimated from; values farther apart share none

LEARNT, KNOWN = "learnt", "System 2"


def run(runner: Runner) -> ItemResult:
    """Tests the process noise of the learnt models and of the known System 2."""
    named = {f"experiment {number}": window for number, window in runner.experiments.items()}
    # Every other window: those next to each other share a half.
    apart = runner.recorded.get(REAL, ())[::2]
    found = runner.each(of_learnt_model, (*named.values(), *apart))
    learnt, real = dict(zip(named, found, strict=False)), found[len(named) :]
    known = {name: of_known_model(window) for name, window in named.items()}
    by_p = sorted(real, key=lambda noise: noise.normality.p_value)
    shown = learnt | ({"real AR.Drone": by_p[len(by_p) // 2]} if by_p else {})
    return ItemResult(
        checks=(
            *checks(list(learnt.values()), "w^φ̇ of the learnt models", "flights"),
            *checks(list(known.values()), "w^φ̇ of the known System 2", "flights"),
            *(checks(real, "w^φ̇ of the real AR.Drone", "windows") if real else ()),
        ),
        numbers={
            LEARNT: {name: noise.to_dict() for name, noise in learnt.items()},
            KNOWN: {name: noise.to_dict() for name, noise in known.items()},
            "real AR.Drone, learnt": [noise.to_dict() for noise in real],
        },
        tables=(_table(shown, known),),
        pictures=(
            Picture(
                "noise-histograms",
                "Histograms of the process noise w^φ̇ under DEM’s models (the paper’s settings), in units of its "
                "standard deviation; line: a Gaussian. Of the real AR.Drone, the window with the median p.",
                partial(_histograms, shown),
            ),
            Picture(
                "noise-autocorrelation",
                "Autocorrelation of w^φ̇; dashed: 95 % bounds of white noise. Values at lags below three (shaded) "
                "share samples, so they correlate even if the noise is white.",
                partial(_autocorrelation, shown),
            ),
        ),
        remarks=(
            "The test for Gaussian noise is that of Lobato and Velasco, which is valid for coloured noise; the plain "
            "Jarque–Bera test rejects coloured noise for its colour. The test for colour is that of Ljung and Box on "
            "every third value, since neighbouring derivatives share samples.",
            "The simulated turbulence is Gaussian and coloured by construction. The test is whether it still is after "
            "rotors, body, autopilot, sensors and estimation. The real flight’s roll rate comes from an inertial "
            "sensor, so w contains its noise and vibration too.",
        ),
    )


def of_learnt_model(window: Window) -> Noise:
    """w^φ̇ = (C(x′ − Ax − Bv))^φ̇ under DEM with the paper's settings, in the training data, rad/s²."""
    return process_noise(learn(window.train, PAPER))[ROLL_RATE]


def of_known_model(window: Window) -> Noise:
    """φ̈ − B(u − ū), rad/s², with the B of System 2, which is known for the simulated vehicle."""
    train = window.train
    B = axis(VehicleSpec(model="ardrone2"), lag=False).B[ROLL_RATE]
    rate = train.outputs[:, ROLL_RATE]
    acceleration = (rate[2:] - rate[:-2]) / (2 * train.dt)
    driven = (train.inputs - train.inputs.mean(axis=0))[1:-1] @ B
    return analyse_noise(acceleration - driven, train.dt, overlap=SHARED)


def checks(noises: list[Noise], whose: str, pieces: str) -> tuple[Check, ...]:
    """Whether each is Gaussian, and whether each is coloured; ``whose`` and ``pieces`` are for the sentences."""
    gaussian = sum(noise.normality.p_value >= LEVEL for noise in noises)
    coloured = sum(is_coloured(noise) for noise in noises)
    return (
        Check(
            f"{whose}: the test for Gaussian noise of any colour has p ≥ {LEVEL} every time",
            gaussian == len(noises),
            f"{whose} is Gaussian in {gaussian} of {len(noises)} {pieces}",
        ),
        Check(
            f"{whose}: its autocorrelation lies above the 95 % bound at the first lag that shares no samples, and the "
            f"test for white noise of values that share none has p < {LEVEL}, every time",
            coloured == len(noises),
            f"{whose} is coloured in {coloured} of {len(noises)}",
        ),
    )


def is_coloured(noise: Noise) -> bool:
    """Whether its autocorrelation exceeds the bound and the test rejects white noise."""
    return noise.autocorrelation[noise.overlap] > noise.bound and noise.whiteness.p_value < LEVEL


def _table(learnt: dict[str, Noise], known: dict[str, Noise]) -> PageTable:
    rows = []
    for model, noises in ((LEARNT, learnt), (KNOWN, known)):
        for name, noise in noises.items():
            tests = (noise.normality, noise.normality_if_white, noise.whiteness)
            values = (noise.sd, noise.skewness, noise.excess_kurtosis, *(test.p_value for test in tests))
            texts = (f"{name}, {model}", *map(number, values), f"{noise.smoothness * 1000:.0f}")
            rows.append(tuple(map(Cell, texts)))
    return PageTable(
        "Process noise w^φ̇ of 700 samples, by flight and model",
        (
            *("flight, model", "sd, rad/s²", "skewness", "excess kurtosis", "p Gaussian", "p Gaussian if white"),
            *("p white", "s, ms"),
        ),
        tuple(rows),
    )


def _histograms(noises: dict[str, Noise]) -> Figure:
    figure, (panels,) = plt.subplots(1, len(noises), figsize=(11, 2.3), sharex=True, sharey=True, squeeze=False)
    grid = np.linspace(-4, 4, 161)
    for axes, (name, noise) in zip(panels, noises.items(), strict=True):
        axes.stairs(noise.histogram, noise.edges, fill=True, color=ONE_STEP, alpha=0.55)
        axes.plot(grid, norm.pdf(grid), color=ink(), linewidth=1.1)
        axes.set(title=name, xlabel="w^φ̇ / sd")
        axes.text(0.02, 0.97, f"p = {number(noise.normality.p_value)}", transform=axes.transAxes, va="top", fontsize=8)
    panels[0].set_ylabel("density")
    return figure


def _autocorrelation(noises: dict[str, Noise]) -> Figure:
    figure, axes = plt.subplots(figsize=(8, 3.2))
    colours = plt.get_cmap("viridis")(np.linspace(0.15, 0.85, len(noises)))
    for colour, (name, noise) in zip(colours, noises.items(), strict=True):
        real = not name.startswith("experiment")
        axes.plot(
            noise.autocorrelation,
            ".-",
            markersize=3,
            linewidth=1.8 if real else 1,
            color=MEASURED if real else colour,
            label=name,
        )
    bound = max(noise.bound for noise in noises.values())
    for side in (-bound, bound):
        axes.axhline(side, color=DEM, linestyle="--", linewidth=1)
    axes.axvspan(0, SHARED, color="#888888", alpha=0.15, linewidth=0)
    axes.set(xlabel="lag, samples", ylabel="autocorrelation of w^φ̇", xlim=(0, 60))
    axes.legend(ncols=2)
    return figure


ITEM = Item(NOISE, run)
