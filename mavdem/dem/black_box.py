"""A recorded flight of whose model nothing is given but the number of states: the same priors for every order.

What makes F̄ of different orders compare:

- **Every order sees the same data**, generalized vectors read through one Gaussian kernel (``kernel``).
- **What is believed of X is a probability.** x has variance 1 at every sample, which also gives hidden states a unit;
  Eq. ``free_E`` alone says nothing of x, and each state more would change F̄ by as many nats as one likes.
- **Neighbours that tell the same are not counted as new.** Noise of width s repeats itself for √(2π) s/dt samples
  (Σₖ ρ(k dt)², as in ``colour``); counted as T samples, it would pay for any number of parameters.
- **Units in which a prior of variance 1 means the same for any flight**: outputs of variance 1, inputs of variance 1
  together, and a unit of time in which outputs change by as much as they vary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, e, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.kernel import NARROWEST, embed_through_kernel
from mavdem.dem.model import pack
from mavdem.dem.priors import Prior
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.dem.smoothness import temporal_precision

Array = NDArray[np.float64]

WIDTH = 0.6
"""Of the kernel, over the time in which the outputs change by as much as they vary: wide enough to hold motion against
noise, narrow enough to leave the fast states something to be seen by."""

FEWEST_SAMPLES = 100.0
"""That tell something new: the kernel is no wider than leaves so many."""

ENOUGH_TO_TELL = 20.0
"""Fewer are no flight to choose an order by."""

SPARE = 3
"""Numbers that a generalized output has more than the largest model has states: what is left tells the orders apart."""

LEAST_EMBEDDING = 2
"""p: of noise one must see how it turns."""

LAMBDA_Z, LAMBDA_W, LAMBDA_PRECISION = 8.0, 2.0, 0.1
"""Prior means of λ and their precision, in units of the data: sensors of a hundredth, disturbances of a third of what
moves the states, give or take a factor of five in size."""

UNIT = 1.0
"""Prior precision of every parameter about 0, and of every state."""

KNOWN_INPUT = e**12
"""P̃ᵛ of inputs that are known, as in ``Settings``."""


@dataclass(frozen=True, eq=False)
class BlackBox:
    """A flight in units of its own, as all orders see it.

    Attributes:
        data: moments of the generalized data.
        r, m: inputs, with the constant one at the end, and outputs.
        p: embedding order of the outputs; that of the inputs is p − 1.
        dt: sampling step, s.
        width: σ of the kernel they were read through, s.
        unit_of_time: s.
        input_precision: P̃ᵛ.
    """

    data: Samples
    r: int
    m: int
    p: int
    dt: float
    width: float
    unit_of_time: float
    input_precision: Array

    @classmethod
    def of(cls, record: Record, most: int, known_inputs: bool, input_precision: float) -> BlackBox:
        """That of a record.

        Args:
            record: the flight.
            most: states of the largest model.
            known_inputs: whether the recorded inputs are η̃ᵛ, or that is 0.
            input_precision: P̃ᵛ of inputs that are not known, and of each derivative, in units of the data.

        Raises:
            ValueError: samples too few, or channels that do not vary.
        """
        settings = replace(Settings.paper(), scaling="channel", known_inputs=known_inputs)
        scaling = Scaling.of(*record.spread, settings)
        width = kernel_width(record)
        m, r = record.outputs.shape[1], record.inputs.shape[1] + scaling.constant
        p = embedding_order(m, most)
        read = _read(record, scaling, p, width)
        new = len(read) / _repeated(width, record.dt)
        if not new >= ENOUGH_TO_TELL:
            raise ValueError(
                f"{len(record)} samples are too few: read {width:.2g} s wide they tell as much as {new:.0f}, and "
                f"{ENOUGH_TO_TELL:.0f} are the fewest to choose an order by"
            )
        unit = _time_of_change(read[:, :m], read[:, m : 2 * m])
        in_units = unit ** np.repeat(np.concatenate([np.arange(p + 1), np.arange(p)]), [m] * (p + 1) + [r] * p)
        each = np.full(r, KNOWN_INPUT if known_inputs else input_precision)
        each[r - scaling.constant :] = KNOWN_INPUT
        return cls(
            Samples.of(read * in_units), r, m, p, record.dt, width, unit, input_precision=np.diag(np.tile(each, p))
        )

    def counted(self, smoothness: float) -> Samples:
        """The data, counted as so many samples as tell something new in noise of that smoothness, s.

        Args:
            smoothness: kernel width of the noise before it is read.
        """
        share = min(1 / _repeated(float(np.hypot(smoothness, self.width)), self.dt), 1.0)
        return Samples(share * self.data.number, share * self.data.gram)

    def model(self, order: int, smoothness: float) -> GenerativeModel:
        """The generative model with so many states.

        Args:
            order: n.
            smoothness: kernel width of the noise before it is read, s.
        """
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


def _repeated(width: float, dt: float) -> float:
    """How many samples noise of that width repeats itself for: Σₖ ρ(k dt)²."""
    return sqrt(2 * pi) * width / dt


def embedding_order(outputs: int, most: int) -> int:
    """p, so that a generalized output has ``SPARE`` numbers more than the largest model has states.

    Args:
        outputs: m.
        most: states of the largest model.
    """
    return max(LEAST_EMBEDDING, ceil((most + SPARE) / outputs) - 1)


def kernel_width(record: Record) -> float:
    """σ of the kernel that a record is read through, s."""
    spread = record.spread[1]
    rates = [
        embed_through_kernel((outputs - spread.mean) / np.sqrt(spread.variance), 1, 2 * record.dt, record.dt)
        for _, outputs in record.segments
    ]
    m = len(spread.mean)
    read = np.concatenate(rates)
    widest = len(record) * record.dt / (_repeated(1.0, 1.0) * FEWEST_SAMPLES)
    if len(read):
        widest = min(widest, WIDTH * _time_of_change(read[:, :m], read[:, m:]))
    return max(NARROWEST * record.dt, widest)


def _time_of_change(values: Array, rates: Array) -> float:
    """The time in which signals change by as much as they vary."""
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
