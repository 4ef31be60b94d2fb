"""Section IV: the manifold of F̄ᵒ over A and B as it is maximised, and ascents from a circle of priors.

The system is ẋ = A x + B v + w, y = x + z. Its input and noises are sums of harmonics, so states and outputs are exact,
whatever the sampling step. At each iteration the states x̃ and λ are held as that iteration left them.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import ceil, e

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.random import Generator, default_rng

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.ascent import posterior_after_each_round
from mavdem.dem.engine.free_energy import Posterior, free_energy_terms
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    embed,
    temporal_precision,
)
from mavdem.dem.engine.steps import with_optimal_covariances
from mavdem.experiments.paper.runner import Check, ExperimentResult, Runner
from mavdem.loops.margins import Complex
from mavdem.report.figures.style import Picture, new_figure
from mavdem.report.numbers import rounded
from mavdem.report.palette import INK_ON_LIGHT, TRUTH

# the true ones, 1/s
A = -2.0
B = 2.0
# rad/s; about the corner at 2 rad/s, to distinguish A and B
INPUT_FREQUENCIES = np.array([0.7, 1.9, 3.1])
INPUT_HARMONICS = np.array([1.0, -1.0j, 0.6])

CERTAIN_PRECISION = (
    e**32
)  # precision of a parameter that is known: C, in the authors' own examples too


@dataclass(frozen=True)
class ScalarWorld:
    """The true system and its noises."""

    duration: float = 576.0  # s
    step: float = 0.1  # between samples, s
    smoothness: float = 0.5  # kernel width of both noises, s
    lambda_z: float = 6.0  # log precision of the outputs' noise
    lambda_w: float = 3.0  # log precision of the process noise
    amplitude: float = 3.0  # of the input; 1 moves the state about as far as its own unit

    def signals(self, seed: int) -> ArrayPair:
        """Returns exact y and v at every sample, (T, 1) each."""
        rng = default_rng(seed)
        number = round(self.duration / self.step)
        # At half a kernel width a step, e^-39 of the noise's power lies beyond what the steps can hold.
        finer = ceil(2 * self.step / self.smoothness)
        # Harmonics repeat: over twice the duration, so that the end does not correlate with the beginning.
        total = 2 * number * finer
        omega = 2 * np.pi * np.asarray(np.fft.rfftfreq(total, self.step / finer), float)
        w = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_w / 2))
        z = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_z / 2))
        tones = np.exp(1j * np.outer(self.step * np.arange(number), INPUT_FREQUENCIES))
        v = self.amplitude * INPUT_HARMONICS
        forced = B * v / (1j * INPUT_FREQUENCIES - A)
        disturbed = w / (1j * omega - A)
        noise = np.fft.irfft(disturbed + z, total, norm="forward")[: number * finer : finer]
        return ((tones @ forced).real + noise)[:, None], (tones @ v).real[:, None]


def _harmonics(rng: Generator, omega: Array, smoothness: float, deviation: float) -> Complex:
    """Random harmonics, up to the Nyquist frequency, of a noise whose power is that of a Gaussian kernel."""
    power = np.exp(-((omega * smoothness) ** 2))
    power[0] = 0.0
    phases = rng.standard_normal((2, len(omega))) / 2
    return deviation * np.sqrt(power / power.sum()) * (phases[0] + 1j * phases[1])


@dataclass(frozen=True)
class ScalarSettings:
    """What the model assumes, and which data it uses. The defaults suit the default :class:`ScalarWorld`.

    The sensor's noise is known; the process noise is learned, from a prior two standard deviations off.
    """

    p: int = 2  # embedding order of outputs and states
    d: int = 1  # of the input
    # of the process noise; q = p counts D's last row, which is zero, as evidence, q = p − 1 leaves it out
    q: int = 1
    smoothness: float = 0.5  # kernel width, s
    lambda_mean: tuple[float, float] = (6.0, 1.0)  # prior of [λᶻ, λʷ]
    lambda_precision: tuple[float, float] = (e**25, 1.0)
    theta_mean: tuple[float, float, float] = (-8.0, 8.0, 1.0)  # prior of A, B and C
    theta_precision: tuple[float, float, float] = (e**-4, e**-4, CERTAIN_PRECISION)  # for each
    input_precision: float = e**16  # of the input and of its derivatives
    # s between the samples that are used; noise is uncorrelated after 3.5 kernel widths
    spacing: float = 1.8

    def samples(self, world: ScalarWorld, seed: int) -> SufficientStatistics:
        """Returns the data that the engine gets."""
        # Inputs are embedded in the order of the outputs, so that the errors of both are of one filter and cancel.
        outputs, inputs = (
            embed(each, self.p, world.step, self.p + 1, self.p // 2) for each in world.signals(seed)
        )
        every = round(self.spacing / world.step)
        return SufficientStatistics.from_segments(
            np.hstack([outputs[::every], inputs[::every, : self.d + 1]])
        )

    def model(self) -> GenerativeModel:
        """Returns the generative model whose F̄ is maximised."""
        return GenerativeModel(
            n=1,
            r=1,
            m=1,
            p=self.p,
            d=self.d,
            q=self.q,
            output_temporal_precision=temporal_precision(self.p, self.smoothness),
            state_temporal_precision=temporal_precision(self.q, self.smoothness),
            output_groups=np.array([0]),
            state_groups=np.array([1]),
            input_precision=self.input_precision * np.eye(self.d + 1),
            prior=Prior(
                np.array(self.theta_mean),
                np.diag(self.theta_precision),
                np.array(self.lambda_mean),
                np.diag(self.lambda_precision),
            ),
        )


PAPER_WORLD = ScalarWorld(duration=32.0, smoothness=0.1, lambda_z=20.0, amplitude=1.0)
"""The paper's noises, as its settings describe them, and an input about as large as its scaling leaves one; as many
samples as the default world has."""

PAPER = ScalarSettings(
    q=2,
    smoothness=0.1,
    lambda_mean=(20.0, 3.0),
    lambda_precision=(e**25, e**20),
    theta_precision=(e**4, e**4, CERTAIN_PRECISION),
    spacing=0.1,
)
"""The paper's section on algorithm settings, with η = (−8, 8) as in its figure."""


def value_at(model: GenerativeModel, belief: Posterior, a: float, b: float) -> float:
    """Returns F̄ᵒ (nats) at A = a, B = b, with the belief's states, λ and C held, and every covariance optimal there."""
    moments = replace(belief.moments, model=model)
    there = belief._replace(moments=moments, theta=np.array([a, b, belief.theta[2]]))
    return sum(free_energy_terms(with_optimal_covariances(there)).values())


def peak(model: GenerativeModel, belief: Posterior) -> float:
    """Returns F̄ᵒ (nats) at the belief's own A and B."""
    return value_at(model, belief, *belief.theta[:2])


def curvature(belief: Posterior) -> float:
    """Returns the curvature of F̄ᵒ along A at the belief: the A entry of Π^θ, Eq. ``Picurvature``."""
    return float(np.linalg.inv(belief.theta_covariance[:2, :2])[0, 0])


SAME_POINT = 0.1  # posterior standard deviations: ascents whose ends scatter less end at one point
DRAWN = (0, 1, 2, 3, 10)  # iterations
AXIS_A = np.linspace(-10, 4, 71)
AXIS_B = np.linspace(-4, 10, 71)
CONTOUR_LEVELS = [1e3, 1e4, 1e5, 1e6]  # contours, nats below the peak

# of the circle; iterations from each
PRIOR_COUNT = 50
RADIUS = 5.0
ROUNDS = 40
CENTRE = np.array([-3.0, 3.0])  # not the truth, or the mean of the priors would be the solution


def run(runner: Runner) -> ExperimentResult:
    """Maximises F̄ᵒ of the scalar system and draws it; the runner is not needed."""
    settings = ScalarSettings()
    samples = settings.samples(ScalarWorld(), seed=0)
    model = settings.model()
    beliefs = [
        posterior_after_each_round(model, samples, max(DRAWN))[iteration] for iteration in DRAWN
    ]
    peaks = [peak(model, belief) for belief in beliefs]
    sharpness = [curvature(belief) for belief in beliefs]
    paths = {
        "our": ascents(settings, samples),
        "the paper’s": ascents(PAPER, PAPER.samples(PAPER_WORLD, seed=0)),
    }
    reached = {name: ends(path) for name, path in paths.items()}
    scatter = {
        name: float((points.std(axis=0) / sd).max()) for name, (points, sd) in reached.items()
    }
    return ExperimentResult(
        checks=(
            Check(
                "the peak of F̄ᵒ rises and sharpens from iteration to iteration",
                bool((np.diff(peaks) > 0).all() and (np.diff(sharpness) > 0).all()),
                f"the peak rises from {rounded(peaks[0], 3)} to {rounded(peaks[-1], 3)} nats, and its curvature along "
                f"A from {rounded(sharpness[0], 3)} to {rounded(sharpness[-1], 3)}",
            ),
            *(
                Check(
                    f"with {name} settings, ascents from fifty priors on a circle end within {SAME_POINT:g} posterior "
                    "standard deviations of each other",
                    deviations < SAME_POINT,
                    f"with {name} settings, the ends from fifty priors scatter by {rounded(deviations, 3)} posterior "
                    "standard deviations",
                )
                for name, deviations in scatter.items()
            ),
        ),
        numbers={"peak": peaks, "curvature_along_A": sharpness, "ends_over_posterior_sd": scatter},
        pictures=(
            Picture(
                "The manifold",
                "F̄ᵒ over A and B by iteration, from above; cross: the truth, dot: the estimate.",
                partial(manifold, model, beliefs),
            ),
            Picture(
                "Fifty priors on a circle",
                "Their ascents, each iteration on its own manifold.",
                partial(circle, model, paths["our"]),
            ),
        ),
    )


def ascents(settings: ScalarSettings, samples: SufficientStatistics) -> list[list[Posterior]]:
    """Returns the beliefs after each iteration, from each prior of the circle."""
    angles = default_rng(0).uniform(0, 2 * np.pi, PRIOR_COUNT)
    priors = CENTRE + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    models = [replace(settings, theta_mean=(a, b, 1.0)).model() for a, b in priors.tolist()]
    return [posterior_after_each_round(model, samples, ROUNDS) for model in models]


def ends(paths: list[list[Posterior]]) -> ArrayPair:
    """Returns (priors, 2) the A and B at which ascents end, and (2,) the posterior standard deviation of one."""
    return np.array([beliefs[-1].theta[:2] for beliefs in paths]), np.sqrt(
        np.diag(paths[0][-1].theta_covariance)[:2]
    )


def _from_above(axes: Axes, model: GenerativeModel, belief: Posterior) -> None:
    """Shades F̄ᵒ by its distance from the peak, with contours at ``CONTOUR_LEVELS``, the truth and the estimate."""
    values = np.array([[value_at(model, belief, a, b) for a in AXIS_A] for b in AXIS_B])
    # Half a nat keeps the peak's own grid point on the logarithmic scale.
    depth = np.maximum(values.max() - values, 0.5)
    filled = axes.contourf(
        AXIS_A, AXIS_B, depth, [0.4, *CONTOUR_LEVELS, 1e8], cmap="viridis_r", norm=LogNorm(1e2, 1e7)
    )
    filled.set_rasterized(True)
    axes.plot(A, B, "+", color=TRUTH, markersize=9)
    axes.plot(*belief.theta[:2], "o", color="white", markeredgecolor=INK_ON_LIGHT, markersize=4)
    axes.set(xlabel="A", aspect="equal")


def manifold(model: GenerativeModel, beliefs: list[Posterior]) -> Figure:
    """Draws the manifold at each of the ``DRAWN`` iterations."""
    with new_figure(1.8) as figure:
        panels = figure.subplots(1, len(beliefs), sharey=True)
        for axes, number, belief in zip(panels, DRAWN, beliefs, strict=True):
            _from_above(axes, model, belief)
            axes.set_title(f"iteration {number}" if number else "prior")
        panels[0].set_ylabel("B")
        return figure


def circle(model: GenerativeModel, paths: list[list[Posterior]]) -> Figure:
    """Draws ascents on the last manifold of one."""
    with new_figure(2.8) as figure:
        axes = figure.subplots()
        _from_above(axes, model, paths[0][-1])
        for beliefs in paths:
            theta = np.array([belief.theta[:2] for belief in beliefs])
            axes.plot(*theta.T, ".-", color="white", linewidth=0.5, markersize=2)
        axes.set_ylabel("B")
        return figure
