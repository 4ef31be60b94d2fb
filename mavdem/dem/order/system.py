"""A recorded flight as a black-box system: only the number of states differs, under the same priors.

F̄ of different orders is comparable because:

- **Every order has the same data**, generalized vectors filtered by one Gaussian kernel.
- **x has a prior**: variance 1 at every sample, which also gives hidden states a unit. Eq. ``free_E`` has none, and
  each further state could change F̄ by any number of nats.
- **The effective sample size is counted.** Noise of width s is correlated over √(2π) s/dt samples (Σₖ ρ(k dt)², as in
  ``smoothness``); counted as T independent samples, it would justify any number of parameters.
- **A prior of variance 1 means the same for any flight**, by the units: outputs of variance 1, inputs of variance 1
  together, and a unit of time in which outputs change by as much as they vary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, e, pi, sqrt

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from scipy.ndimage import correlate1d

from mavdem.dem.engine.coordinates import temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior, SufficientStatistics
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import pack
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings

WIDTH = 0.6
"""Of the kernel, over the time in which the outputs change by their standard deviation: wide enough to average noise,
narrow enough to keep fast states visible."""

KERNEL_SAMPLES = 100.0  # effective samples that the widest kernel leaves
MIN_EFFECTIVE_SAMPLES = 20.0  # of a flight, to choose an order
SPARE_VALUES = 3  # that a generalized output has more than the largest model has states: they distinguish the orders
LEAST_EMBEDDING = 2  # p: of noise the second derivative is needed

LAMBDA_Z, LAMBDA_W, LAMBDA_PRECISION = 8.0, 2.0, 0.1
"""Prior means of λ and their precision, in units of the data: sensor noise of a hundredth, disturbances of a third of
the states' rates, within a factor of five."""

UNIT = 1.0  # prior precision of every parameter about 0, and of every state
KNOWN_INPUT = e**12  # P̃ᵛ of inputs that are known, as in ``Settings``


@dataclass(frozen=True, eq=False)
class BlackBox:
    """A flight in units of its own, the same for all orders."""

    data: SufficientStatistics  # of the generalized data
    r: int  # inputs, with the constant one at the end
    m: int  # outputs
    p: int  # embedding order of the outputs; that of the inputs is p − 1
    dt: float  # sampling step, s
    width: float  # σ of the kernel, s
    unit_of_time: float  # s
    input_precision: Array  # P̃ᵛ

    @classmethod
    def of(cls, record: Record, most: int, known_inputs: bool, input_precision: float) -> BlackBox:
        """That of a record, for models of at ``most`` so many states; P̃ᵛ of unknown inputs is ``input_precision``.

        ``ValueError`` for too few samples, or channels that do not vary.
        """
        settings = replace(Settings.paper(), scaling="channel", known_inputs=known_inputs)
        scaling = Scaling.of(*record.spread, settings)
        width = kernel_width(record)
        m, r = record.outputs.shape[1], record.inputs.shape[1] + scaling.constant
        p = embedding_order(m, most)
        read = _read(record, scaling, p, width)
        new = len(read) / _repeated(width, record.dt)
        if not new >= MIN_EFFECTIVE_SAMPLES:
            raise ValueError(
                f"{len(record)} samples are too few: with a kernel of {width:.2g} s they are worth {new:.0f}, and "
                f"{MIN_EFFECTIVE_SAMPLES:.0f} are the fewest to choose an order by"
            )
        unit = _time_of_change(read[:, :m], read[:, m : 2 * m])
        in_units = unit ** np.repeat(np.concatenate([np.arange(p + 1), np.arange(p)]), [m] * (p + 1) + [r] * p)
        each = np.full(r, KNOWN_INPUT if known_inputs else input_precision)
        each[r - scaling.constant :] = KNOWN_INPUT
        return cls(
            SufficientStatistics.of(read * in_units),
            r,
            m,
            p,
            record.dt,
            width,
            unit,
            input_precision=np.diag(np.tile(each, p)),
        )

    def counted(self, smoothness: float) -> SufficientStatistics:
        """The data with the effective sample size of noise of that smoothness, s, before filtering."""
        share = min(1 / _repeated(float(np.hypot(smoothness, self.width)), self.dt), 1.0)
        return SufficientStatistics(share * self.data.number, share * self.data.gram)

    def model(self, order: int, smoothness: float) -> GenerativeModel:
        """The generative model of so many states, with noise of that smoothness, s, before filtering."""
        n, r, m = order, self.r, self.m
        mean = pack(np.zeros((n, n)), np.zeros((n, r)), np.zeros((m, n)))
        read = float(np.hypot(smoothness, self.width)) / self.unit_of_time
        return GenerativeModel(
            n,
            r,
            m,
            self.p,
            self.p - 1,
            self.p - 1,
            output_correlation=temporal_precision(self.p, read),
            state_correlation=temporal_precision(self.p - 1, read),
            output_groups=np.zeros(m, np.intp),
            state_groups=1 + np.arange(n),
            input_precision=self.input_precision,
            prior=Prior(
                mean,
                UNIT * np.eye(len(mean)),
                np.array([LAMBDA_Z] + [LAMBDA_W] * n),
                LAMBDA_PRECISION * np.eye(1 + n),
            ),
            state_precision=UNIT * np.eye(n),
        )


REACH_WIDTHS = 6.0  # of the kernel to either side, beyond which even its eighth derivative is below 5e-5
NARROWEST_STEPS = 1.5  # the derivatives of a narrower kernel are undersampled
ROUNDING = 1e-9  # of a width that is meant to be a number of steps


def kernel_weights(order: int, width: float, dt: float) -> Array:
    """(order + 1, window) weights: row k gives the k-th derivative, at the centre, of the filtered signal.

    The kernel is exp(−t²/2σ²)/√(2π)σ, of ``width`` σ, s; ``ValueError`` where that is too narrow for the samples.
    """
    if not width >= NARROWEST_STEPS * dt * (1 - ROUNDING):
        raise ValueError(f"width must be at least {NARROWEST_STEPS:g} steps of {dt:g} s, not {width:g} s")
    reach = ceil(REACH_WIDTHS * width / dt * (1 - ROUNDING))
    at = np.arange(-reach, reach + 1) * dt / width
    kernel = np.exp(-(at**2) / 2) * dt / (np.sqrt(2 * np.pi) * width)
    # The k-th derivative of the kernel is (−1/σ)ᵏ Heₖ(t/σ) times it; a convolution reverses it, t → −t.
    return np.stack([hermeval(at, np.eye(order + 1)[k]) * kernel / width**k for k in range(order + 1)])


def embed_through_kernel(samples: Array, order: int, width: float, dt: float) -> Array:
    """Generalized vectors of samples (T, m) convolved with a Gaussian kernel, where the whole kernel fits.

    Derivatives by a polynomial over a window are not those of one signal: y″ is not quite the derivative of y′, and an
    additional state may explain the difference. These are exact: convolution leaves ẋ = Ax + Bv + w and y = Cx + z as
    they are (Young 1981, Automatica 17, 23), and noise of smoothness s becomes that of √(s² + σ²), so that Eq.
    ``Smatrix`` holds. Derivatives of Gaussians: Koenderink and van Doorn 1987, Biological Cybernetics 55, 367.

    (T − window + 1, (order + 1)·m), order-major; none where the window is longer than the signal.
    """
    weights = kernel_weights(order, width, dt)
    reach = weights.shape[1] // 2
    if len(samples) <= 2 * reach:
        return np.empty((0, (order + 1) * samples.shape[1]))
    return np.hstack([correlate1d(samples, row, axis=0)[reach:-reach] for row in weights])


def _repeated(width: float, dt: float) -> float:
    """Samples per effective sample in noise of that width: Σₖ ρ(k dt)²."""
    return sqrt(2 * pi) * width / dt


def embedding_order(outputs: int, most: int) -> int:
    """p, so that a generalized output has ``SPARE_VALUES`` numbers more than the largest model has states."""
    return max(LEAST_EMBEDDING, ceil((most + SPARE_VALUES) / outputs) - 1)


def kernel_width(record: Record) -> float:
    """σ of the kernel that filters a record, s."""
    spread = record.spread[1]
    rates = [
        embed_through_kernel((outputs - spread.mean) / np.sqrt(spread.variance), 1, 2 * record.dt, record.dt)
        for _, outputs in record.segments
    ]
    m = len(spread.mean)
    read = np.concatenate(rates)
    widest = len(record) * record.dt / (_repeated(1.0, 1.0) * KERNEL_SAMPLES)
    if len(read):
        widest = min(widest, WIDTH * _time_of_change(read[:, :m], read[:, m:]))
    return max(NARROWEST_STEPS * record.dt, widest)


def _time_of_change(values: Array, rates: Array) -> float:
    """The time in which signals change by their standard deviation."""
    return float(np.sqrt(values.var(axis=0).mean() / rates.var(axis=0).mean()))


def _read(record: Record, scaling: Scaling, p: int, width: float) -> Array:
    """Generalized data [ỹ; η̃], (T′, ·), of the samples whose whole kernel lies inside their segment."""
    return np.concatenate(
        [
            np.hstack(
                [
                    embed_through_kernel(scaling.scale_outputs(outputs), p, width, record.dt),
                    embed_through_kernel(scaling.scale_inputs(inputs), p - 1, width, record.dt),
                ]
            )
            for inputs, outputs in record.segments
        ]
    )
