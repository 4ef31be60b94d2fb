"""The estimates that the online learner returns for each sample: predictions, model, disturbance and anomaly."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.model import LinearModel
from mavdem.facts.online import SurpriseCause

if TYPE_CHECKING:
    from mavdem.plant.parameters import Physical

USEFUL_ERROR_RATIO = 0.5
"""Mean squared error, relative to a trivial prediction's, below which a prediction is worth showing; a choice."""


class SurpriseMark(NamedTuple):
    """A mark of samples whose surprise stayed high."""

    time: float
    """Time of the marked sample, s."""

    cause: SurpriseCause | None
    """What made the free energy drop; ``None`` if that is undecided."""


class Estimate(NamedTuple):
    """All estimates at one sample; those that do not exist yet are NaN or ``None``.

    The shapes have H horizons and m outputs; all numbers are in physical units.

    Attributes:
        time: Time of the sample, s.
        expected: (m,) the sample, predicted from the samples before it and from its own inputs.
        expected_band: (m,) half width of the 90 % band about it: the quantile of the latest errors.
        ahead_times: (H,) times that ``ahead`` predicts, s: the learner's horizons after this sample.
        ahead: (H, m) predictions at these times by the joint model, inputs unknown. Before the model's first fit they
            repeat this sample, so that there are predictions from the first sample on.
        ahead_band: (H, m) half width of the 90 % band about ``ahead``: the quantile of the latest errors.
        ahead_ratio: (H, m) squared error of ``ahead``, averaged over about 10 s, relative to the better of two
            trivial predictions: the last sample held, and the mean so far. NaN before errors are known.
        window_center: Time to which ``free_energy`` and ``surprise`` belong, s: that of the centre of the latest
            embedding window.
        free_energy: F(t), nats, by the current model: the same function whose sum over the model's training samples is
            ``free_energy_action``.
        free_energy_terms: (10,) terms of F(t), nats, in the order of ``mavdem.dem.engine.free_energy.Term``; ``None``
            if there is no F(t).
        free_energy_action: F̄ of the current model, nats: the result of the learning run on the samples up to
            ``training_end_time``.
        surprise: Standardised drop of F(t) below the median of its last 10 s. The unit is the distance of its 5 %
            quantile: above 1 in about one of 20 samples without a change, tens to thousands with a failing motor.
        model: The current model.
        training_end_time: Time of the last sample that the model was learned from, s.
        unusual: Whether this sample is marked because surprise stays above what is usual in this flight. Without a
            change, one mark in five minutes is expected; see ``AnomalyMarks``.
        latest_mark: The latest mark, up to this sample, with its cause; ``None`` before any.
        wind_torque: Torque of the wind, rad/s², steady part included, as of ``wind_time``, by the physical parameters
            of the last fit; NaN before the first.
        wind_torque_band: Half width of its 90 % band, rad/s².
        wind_time: Time that ``wind_torque`` belongs to, s:
            ``mavdem.plant.online_wind_torque.DELAY_SECONDS`` before this sample.
        physical: Physical parameters as of the last fit.
    """

    time: float
    expected: Array
    expected_band: Array
    ahead_times: Array
    ahead: Array
    ahead_band: Array
    ahead_ratio: Array
    window_center: float = np.nan
    free_energy: float = np.nan
    free_energy_terms: Array | None = None
    free_energy_action: float = np.nan
    surprise: float = np.nan
    model: LinearModel | None = None
    training_end_time: float = np.nan
    unusual: bool = False
    latest_mark: SurpriseMark | None = None
    wind_torque: float = np.nan
    wind_torque_band: float = np.nan
    wind_time: float = np.nan
    physical: Physical | None = None

    @property
    def longest_useful_horizon(self) -> int | None:
        """Index of the longest horizon with useful predictions (mean ``ahead_ratio`` below 0.5); None without one."""
        useful_horizons = np.flatnonzero(self.ahead_ratio.mean(axis=-1) < USEFUL_ERROR_RATIO)
        return int(useful_horizons[-1]) if len(useful_horizons) else None
