"""Estimate: what the online learner knows as of a sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import LinearModel
from mavdem.dem.graybox.parameters import Physical

USEFUL_RATIO = 0.5  # of squared errors, below which a prediction is worth showing


class Estimate(NamedTuple):
    """Predictions, model and disturbance as of a sample; NaN, or ``None``, where there is none yet.

    H horizons, m outputs, n states, g noise precisions; physical units.

    Attributes:
        time: of the sample, s.
        expected: (m,) the sample, predicted from those before it and from its own inputs.
        expected_band: (m,) half width of its 90 % band: the quantile of the latest errors.
        ahead_times: (H,) times of the next two, s: the learner's horizons from here.
        ahead: (H, m) predictions of the samples then, inputs unknown: a mixture of a joint autoregression, the last
            sample, the mean and the model, by their own past errors. From the first sample on, also without a model.
        ahead_band: (H, m) likewise, of the errors of ``ahead``.
        ahead_ratio: (H, m) squared error of ``ahead``, averaged over about 10 s, over that of the better of the last
            sample held and the mean so far; NaN before errors are known.
        seen: time of the next three, s: the centre of the latest embedding window.
        free_energy: F(t) without the prior and entropy terms of θ and λ, which are the same at every sample and change
            only with the model.
        surprise: standardised drop of F(t) below the median of its last 10 s, in units of its 5 % quantile's: above 1
            in about one of 20 samples without a change; tens to thousands of units with a failing motor.
        disturbance: (n,) w of each state, in its unit per second; of a rate, rad/s².
        free_energy_action: F̄ᵒ of the memory.
        model: the current one.
        model_sd: DEM's own posterior standard deviations of A, B and C; too small, see ``Learned.model_sd``.
        log_precisions: (g,) λ of the noises.
        until: time of the last sample the model was learnt from, s.
        unusual: whether this sample is marked: surprise stays above what is usual in this flight. Without a change, one
            mark in five minutes is expected; see ``mavdem.dem.online.surprise.Marks``.
        wind_torque: the wind's torque, rad/s², steady part included, ``mavdem.dem.online.wind.DELAY_SECONDS`` before
            this sample; by the physical parameters as of the last fit, NaN before the first.
        wind_torque_band: half width of its 90 % band.
        wind_time: the time it is of, s.
        physical: the physical parameters as of the last fit.
    """

    time: float
    expected: Array
    expected_band: Array
    ahead_times: Array
    ahead: Array
    ahead_band: Array
    ahead_ratio: Array
    seen: float
    free_energy: float
    surprise: float
    disturbance: Array
    free_energy_action: float
    model: LinearModel | None
    model_sd: LinearModel | None
    log_precisions: Array
    until: float
    unusual: bool = False
    wind_torque: float = np.nan
    wind_torque_band: float = np.nan
    wind_time: float = np.nan
    physical: Physical | None = None

    @property
    def useful(self) -> int | None:
        """Index of the longest horizon with a mean ``ahead_ratio`` below ``USEFUL_RATIO``; ``None`` without one."""
        places = np.flatnonzero(self.ahead_ratio.mean(axis=-1) < USEFUL_RATIO)
        return int(places[-1]) if len(places) else None

    def __repr__(self) -> str:
        if self.model is None:
            return f"<Estimate: at {self.time:.6g} s, no model yet>"
        expected, band = (np.array2string(values, precision=3) for values in (self.expected, self.expected_band))
        return (
            f"<Estimate: at {self.time:.6g} s, expected {expected} ± {band}, surprise {self.surprise:.3g}, by a model "
            f"learnt until {self.until:.6g} s>"
        )
