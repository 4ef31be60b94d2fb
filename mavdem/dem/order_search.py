"""F̄ by model order: one flight fitted as a black box with one state, two, and so on.

docs/order.md says why F̄ of different orders is comparable. The effective sample size is counted: noise of width s is
correlated over √(2π) s/dt samples (Σₖ ρ(k dt)²). A prior of variance 1 means the same for any flight, by the units:
outputs and all inputs together of variance 1, and a unit of time in which outputs change by as much as they vary.

F̄ of a model with hidden states has many maxima, most of them far below the highest. So each order starts from the data:
a linear map from them to the states and their rates; θ follows by regression, in the coordinates of the priors: states
of variance 1, independent noises.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, e, pi, sqrt

import numpy as np
from numpy.linalg import LinAlgError
from scipy.ndimage import gaussian_filter1d

from mavdem.arrays import Array
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dem.engine.ascent import Iterate, initial_iterate, run_rounds
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    temporal_precision,
)
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, raise_on_overflow
from mavdem.dem.engine.model import pack
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal

KERNEL_WIDTH = 0.6
"""Of the kernel, over the time in which the outputs change by their standard deviation: wide enough to average noise,
narrow enough to keep fast states visible."""

KERNEL_SAMPLES = 100.0  # effective samples that the widest kernel leaves
# that a generalized output has more than the largest model has states: they distinguish the orders
SPARE_VALUES = 3
LEAST_EMBEDDING = 2  # p: of noise the second derivative is needed

LAMBDA_Z = 8.0
LAMBDA_W = 2.0
LAMBDA_PRECISION = 0.1
"""Prior means of λ and their precision, in units of the data: sensor noise of a hundredth, disturbances of a third of
the states' rates, within a factor of five."""

# P̃ᵛ of recorded inputs, as in ``Settings``, and of others, as in the paper
KNOWN_INPUT = Settings.input_precision
UNKNOWN_INPUT = e**2


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
    def from_record(cls, record: Record, most: int, known_inputs: bool) -> BlackBox:
        """Returns that of a record, for models of at ``most`` so many states."""
        settings = replace(Settings.paper(), scaling="channel", known_inputs=known_inputs)
        scaling = Scaling.from_record(record, settings)
        width = kernel_width(record)
        m = record.outputs.shape[1]
        r = record.inputs.shape[1] + scaling.constant
        p = max(LEAST_EMBEDDING, ceil((most + SPARE_VALUES) / m) - 1)
        # [ỹ; η̃] of the samples whose whole kernel lies inside their segment.
        pairs = [
            (
                embed_through_kernel(y, p, width, record.dt),
                embed_through_kernel(u, p - 1, width, record.dt),
            )
            for u, y in scaling.scale_segments(record)
        ]
        read = np.concatenate([np.hstack(pair) for pair in pairs])
        new = len(read) / _repeated(width, record.dt)
        if not new >= MIN_SAMPLES_FOR_STATISTICS:
            raise NotLearnable(
                ModelRefusal.TOO_FEW_TO_CHOOSE_ORDER,
                samples=len(record),
                width=width,
                effective_samples=new,
                least_samples=float(MIN_SAMPLES_FOR_STATISTICS),
            )
        unit = _time_of_change(read[:, :m], read[:, m : 2 * m])
        in_units = unit ** np.repeat(
            np.concatenate([np.arange(p + 1), np.arange(p)]), [m] * (p + 1) + [r] * p
        )
        each = np.full(r, KNOWN_INPUT if known_inputs else UNKNOWN_INPUT)
        each[r - scaling.constant :] = KNOWN_INPUT
        precision = np.diag(np.tile(each, p))
        return cls(
            SufficientStatistics.from_segments(read * in_units),
            r,
            m,
            p,
            record.dt,
            width,
            unit,
            precision,
        )

    @property
    def smoothness(self) -> float:
        """Kernel width of the noise after the filter, s: it is taken to be a sampling step before it."""
        return np.hypot(self.dt, self.width)

    @property
    def counted(self) -> SufficientStatistics:
        """The data with their effective sample size."""
        share = 1 / _repeated(self.smoothness, self.dt)
        return SufficientStatistics(share * self.data.sample_count, share * self.data.gram)

    def model(self, order: int) -> GenerativeModel:
        """Returns the generative model of so many states."""
        n = order
        m = self.m
        mean = pack(np.zeros((n, n)), np.zeros((n, self.r)), np.zeros((m, n)))
        read = self.smoothness / self.unit_of_time
        lambda_mean = np.array([LAMBDA_Z] + [LAMBDA_W] * n)
        lambda_precision = LAMBDA_PRECISION * np.eye(1 + n)
        return GenerativeModel(
            *(n, self.r, m, self.p, self.p - 1, self.p - 1),
            output_temporal_precision=temporal_precision(self.p, read),
            state_temporal_precision=temporal_precision(self.p - 1, read),
            output_groups=np.zeros(m, int),
            state_groups=1 + np.arange(n),
            input_precision=self.input_precision,
            prior=Prior(mean, np.eye(len(mean)), lambda_mean, lambda_precision),
            state_precision=np.eye(n),
        )


# of the kernel to either side, beyond which even its eighth derivative is below 5e-5
REACH_WIDTHS = 6.0
NARROWEST_STEPS = 1.5  # the derivatives of a narrower kernel are undersampled


def embed_through_kernel(
    samples: Array,
    order: int,
    width: float,
    dt: float,
) -> Array:
    """Returns generalized vectors of samples (T, m) convolved with a Gaussian kernel, where the whole kernel fits.

    Derivatives by a polynomial over a window are not quite those of one signal, and an additional state may explain the
    difference. These are exact: convolution leaves ẋ = Ax + Bv + w and y = Cx + z as they are (Young 1981, Automatica
    17, 23), and noise of smoothness s becomes that of √(s² + σ²), so that Eq. ``Smatrix`` holds.

    (T − window + 1, (order + 1)·m), order-major; none where the window is longer than the signal. The kernel is
    exp(−t²/2σ²)/√(2π)σ, of ``width`` σ, s, ``NARROWEST_STEPS`` at least.
    """
    reach = ceil(REACH_WIDTHS * width / dt * (1 - ROUNDING_TOLERANCE))
    if len(samples) <= 2 * reach:
        return np.empty((0, (order + 1) * samples.shape[1]))
    orders = [
        gaussian_filter1d(samples, width / dt, 0, k, radius=reach) / dt**k for k in range(order + 1)
    ]
    return np.hstack(orders)[reach:-reach]


def _repeated(width: float, dt: float) -> float:
    """Samples per effective sample in noise of that width: Σₖ ρ(k dt)²."""
    return sqrt(2 * pi) * width / dt


def kernel_width(record: Record) -> float:
    """Returns σ of the kernel that filters a record, s."""
    spread = record.channel_statistics[1]
    m = record.outputs.shape[1]
    units = ((outputs - spread.mean) / np.sqrt(spread.variance) for _, outputs in record.segments)
    read = np.concatenate(
        [embed_through_kernel(outputs, 1, 2 * record.dt, record.dt) for outputs in units]
    )
    widest = len(record) * record.dt / (_repeated(1.0, 1.0) * KERNEL_SAMPLES)
    if len(read):
        widest = min(widest, KERNEL_WIDTH * _time_of_change(read[:, :m], read[:, m:]))
    return max(NARROWEST_STEPS * record.dt, widest)


def _time_of_change(values: Array, rates: Array) -> float:
    """The time in which signals change by their standard deviation."""
    return np.sqrt(values.var(axis=0).mean() / rates.var(axis=0).mean())


ROUNDS = 200  # at most


def fits_by_order(box: BlackBox, most: int) -> tuple[Iterate | None, ...]:
    """Returns the iterate of highest F̄ᵒ of each order from 1 to ``most``; None where the fit broke down."""
    fits: list[Iterate | None] = []
    for order in range(1, most + 1):
        try:
            with raise_on_overflow():
                fits.append(_fitted(box, order))
        except LinAlgError:
            fits.append(None)
    return tuple(fits)


def _fitted(box: BlackBox, order: int) -> Iterate:
    """The fit of an order, from the data, with the noise at its prior."""
    model = box.model(order)
    samples = box.counted
    prior = model.prior
    given = chain(box, order), prior.lambda_mean
    start = initial_iterate(model, samples, given, np.zeros_like(prior.lambda_precision))
    return run_rounds(start, ROUNDS)[0][-1]


def chain(box: BlackBox, order: int) -> Array:
    """Returns θ of states that are the outputs, then parts of their derivatives.

    The parts are those that these states and the inputs do not explain. ``LinAlgError`` where there are too few
    derivatives.
    """
    y, v = _channels(box)
    states = rates = np.zeros((0, len(box.data.gram)))
    for k in range(box.p):
        left = y[k]
        rate = y[k + 1]
        if k:
            regressors = np.vstack([states, *v[:k]])
            coefficients = _regression(box, y[k], regressors, ROUNDING_TOLERANCE)
            left = left - coefficients @ regressors
            rate = rate - coefficients @ np.vstack([rates, *v[1 : k + 1]])
        unit = np.sqrt(np.diag(_moments(box, y[k], y[k])))
        # Its largest directions, in units of the derivative itself.
        most = (
            _directions(_moments(box, left / unit[:, None], left / unit[:, None]))[
                : order - len(states)
            ]
            / unit
        )
        states = np.vstack([states, most @ left])
        rates = np.vstack([rates, most @ rate])
        if len(states) == order:
            return _theta(box, states, rates)
    raise LinAlgError("too few derivatives for as many states")


def _channels(box: BlackBox) -> tuple[list[Array], list[Array]]:
    """Selects y, y′, … and v, v′, … from the data."""
    every = np.eye(len(box.data.gram))
    outputs, inputs = np.split(every, [box.m * (box.p + 1)])
    return np.split(outputs, box.p + 1), np.split(inputs, box.p)


def _moments(box: BlackBox, left: Array, right: Array) -> Array:
    """Mean products of two linear functions of the data."""
    return left @ box.data.gram @ right.T / box.data.sample_count


def _regression(
    box: BlackBox,
    wanted: Array,
    regressors: Array,
    ridge: float,
) -> Array:
    """Coefficients by least squares, with a ridge in units of the regressors' variances."""
    unit = np.sqrt(np.diag(_moments(box, regressors, regressors)))
    unit = np.where(unit > 0, unit, 1.0)[:, None]
    scaled = regressors / unit
    square = _moments(box, scaled, scaled) + ridge * np.eye(len(scaled))
    return (np.linalg.solve(square, _moments(box, scaled, wanted)) / unit).T


def _directions(symmetric: Array) -> Array:
    """Its eigenvectors as rows, the largest eigenvalues first."""
    return np.linalg.eigh(symmetric)[1].T[::-1]


def _theta(box: BlackBox, states: Array, rates: Array) -> Array:
    """θ by regression, in the coordinates in which states have variance 1 and their noises are independent.

    ``states`` and ``rates`` (n, dim [ỹ; η̃]) are linear functions of the data.
    """
    n = len(states)
    y, v = _channels(box)
    values, modes = np.linalg.eigh(_moments(box, states, states))
    whitening = (modes / np.sqrt(np.maximum(values, ROUNDING_TOLERANCE * values.max()))).T
    states = whitening @ states
    rates = whitening @ rates
    regressors = np.vstack([states, v[0]])
    # Like the priors, it has the weight of one sample.
    ridge = 1 / box.data.sample_count
    dynamics = _regression(box, rates, regressors, ridge)
    noise = rates - dynamics @ regressors
    turn = _directions(_moments(box, noise, noise))
    A, B = np.split(turn @ dynamics, [n], axis=1)
    # Unrecorded inputs appear as noise only: a fit from B = 0 would never attribute it to them.
    unknown = np.flatnonzero(np.diag(_moments(box, v[0], v[0])) == 0)
    B[unknown % n, unknown] = np.sqrt(
        np.diag(turn @ _moments(box, noise, noise) @ turn.T)[unknown % n]
    )
    return pack(A @ turn.T, B, _regression(box, y[0], turn @ states, ridge))
