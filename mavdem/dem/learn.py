"""Learning a flight: the fit, with what its settings leave open chosen by their forecasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from mavdem.dem.choice import Candidate, candidates
from mavdem.dem.colour import Colour, estimate_colour
from mavdem.dem.fit import Fit, fit, generalized
from mavdem.dem.free_energy import free_energy
from mavdem.dem.learned import Learned
from mavdem.dem.positive import inverse
from mavdem.dem.record import Record, Recorded
from mavdem.dem.scatter import Scatter, scatter
from mavdem.dem.settings import Settings
from mavdem.dem.trials import Unseen, trials, unseen_forecasts

Array = NDArray[np.float64]

FEWEST_SAMPLES = 50
"""Below this there is nothing to learn and nothing left to try it on."""

HARDLY_BETTER = 0.9
"""Squared error of forecasts, in units of the training variance, from which a model is cautioned against."""

MOTORS_SHARE = 0.15
"""The motors must take this share off the squared error of forecasts, or the model is cautioned against: where they are
of another flight, or shifted by seconds, they rarely take so much by chance."""


def learn(train: Recorded | Sequence[Recorded], settings: Settings | None = None) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    Args:
        train: inputs (T, r), outputs (T, m), finite, and the sampling step dt in seconds: a ``Flight``; or a list of
            them, segments with gaps between: nothing is differentiated or forecast across a gap, and forecasts begin
            at the end of the last.
        settings: what decides the fit; ``Settings()``, for real flights, unless given.

    Returns:
        the model, its posterior, the free energy and the forecasts, in physical units.

    Raises:
        ValueError: too few samples, values that are not finite, or channels that do not vary, with their names; or
            data of which no model can be tried.
    """
    record = Record.of(train)
    if len(record) < FEWEST_SAMPLES:
        raise ValueError(f"train must have at least {FEWEST_SAMPLES} samples, not {len(record)}")
    with _one_thread, _linear_algebra().limit(limits=1, user_api="blas"):
        return _learn(record, settings or Settings())


_one_thread = Lock()
"""Linear algebra gets one thread, since the matrices are small: waking others takes several times as long as the work.
That holds for the whole process, so threads that learn take turns; they would hardly be faster together."""


@cache
def _linear_algebra() -> ThreadpoolController:
    """Looking for the libraries takes longer than a fit."""
    return ThreadpoolController()


def _learn(record: Record, settings: Settings) -> Learned:
    colour = None
    if settings.smoothness == "learn":
        colour = _colour(record, settings)
        settings = replace(settings, smoothness=colour.smoothness)
    attempts = [_attempt(record, choice) for choice in candidates(settings, record)]
    best = min(attempts, key=lambda attempt: attempt.candidate.error)
    if best.fit is None or best.candidate.error == np.inf:
        raise ValueError("no model of the training data can forecast any part of them: they determine none")
    try:
        unseen = unseen_forecasts(record, best.fit.settings)
    except np.linalg.LinAlgError:
        unseen = None
    if unseen is None or not np.isfinite(unseen.mse).all():
        raise ValueError("half of the training data do not determine a model that can forecast: more are needed")
    tried = tuple(attempt.candidate for attempt in attempts)
    segments = generalized(best.fit.settings, best.fit.scaling, record)
    return Learned.of(
        best.fit,
        record,
        _scatter(best.fit, segments),
        _free_energy(best.fit, segments),
        unseen,
        tried,
        colour,
        _cautions(best.fit, unseen, record),
    )


def _scatter(fitted: Fit, segments: Sequence[Array]) -> Scatter:
    """Where F̄ has no maximum that rounding can tell, nothing but the prior is known."""
    try:
        return scatter(fitted.model, segments, fitted.ascent)
    except np.linalg.LinAlgError:
        prior = fitted.model.prior.theta_precision
        return Scatter(inverse(prior), np.inf, np.zeros_like(prior))


def _free_energy(fitted: Fit, segments: Sequence[Array]) -> Array:
    """F(t) of every generalized sample, at the end of the climb."""
    data = np.concatenate(segments)
    return free_energy(fitted.model, data, data @ fitted.ascent.state_map.T, fitted.ascent.belief)


def _colour(record: Record, settings: Settings) -> Colour:
    """From the first candidate, whose window is the shortest: it averages the noise least."""
    try:
        return estimate_colour(record, replace(candidates(settings, record)[0], smoothness=None))
    except np.linalg.LinAlgError:
        raise ValueError("the training data do not determine the smoothness of their noise: set it") from None


@dataclass(frozen=True, eq=False)
class _Attempt:
    candidate: Candidate
    fit: Fit | None


def _attempt(record: Record, settings: Settings) -> _Attempt:
    assert settings.window and settings.parameter_precision
    choice = (settings.window, settings.parameter_precision)
    try:
        fitted = fit(record, settings)
    except np.linalg.LinAlgError:
        return _Attempt(Candidate(*choice, np.inf), None)
    error = float(np.mean(trials(fitted, record).mse / record.outputs.var(axis=0)))
    return _Attempt(Candidate(*choice, error if np.isfinite(error) else np.inf), fitted)


def _cautions(fitted: Fit, unseen: Unseen, record: Record) -> tuple[str, ...]:
    """What a user must know before trusting the model."""
    model = fitted.scaling.physical_model(fitted.ascent.belief.theta, fitted.model.n)
    error = (unseen.weighted_mse / record.outputs.var(axis=0)).mean(axis=1)
    judged = "Inside the training data, where each half was forecast from the other,"
    cautions = []
    if not error.mean() < HARDLY_BETTER:
        useful = int(np.argmin(error < HARDLY_BETTER)) * record.dt
        cautions.append(
            f"{judged} forecasts beyond {useful:.2g} s were hardly better than the constant mean: a good one after it "
            "is luck. Learn from more, or from a livelier stretch."
        )
    if not unseen.motors_share > MOTORS_SHARE:
        cautions.append(
            f"{judged} the motors took {max(unseen.motors_share, 0):.0%} off the squared error of forecasts: the model "
            "hardly ties the motion to them. Let them work more, in wind or with small sideways steps."
        )
    if model.spectral_abscissa > 0:
        cautions.append(f"The model is unstable: it grows e-fold in {1 / model.spectral_abscissa:.3g} s.")
    return tuple(cautions)
