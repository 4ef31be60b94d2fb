"""Learning a flight: the fit, with what its settings leave open chosen by their forecasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.ascent import Climb
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.cautions import cautions
from mavdem.dem.choice import Candidate, candidates
from mavdem.dem.colour import Colour, estimate_colour
from mavdem.dem.fit import Fit, fit, generalized, trajectory_by_parts
from mavdem.dem.free_energy import free_energy
from mavdem.dem.generative import Samples
from mavdem.dem.innovations import with_innovations_by_parts
from mavdem.dem.learned import Learned
from mavdem.dem.one_thread import one_thread
from mavdem.dem.parts import at_once
from mavdem.dem.record import Record, Recorded
from mavdem.dem.scaling import known_inputs
from mavdem.dem.scatter import certainty_of
from mavdem.dem.settings import Settings
from mavdem.dem.trials import trials, unseen_forecasts

Array = NDArray[np.float64]

FEWEST_SAMPLES = 50
"""Below this there is nothing to learn and nothing left to try it on."""


def learn(train: Recorded | Sequence[Recorded], settings: Settings | None = None) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    Args:
        train: inputs (T, r), outputs (T, m), finite, and the sampling step dt in seconds: a ``Flight``; or a list of
            them, segments with gaps between: nothing is differentiated or forecast across a gap, and forecasts begin
            at the end of the last. Three inputs or more are taken for a multirotor's motors, unless a prior is given.
        settings: what decides the fit; ``Settings()``, for real flights, unless given.

    Returns:
        the model, its posterior, the free energy and the forecasts, in physical units.

    Raises:
        ValueError: too few samples, values that are not finite, or channels that do not vary, with their names; or
            data of which no model can be tried.
    """
    if not (settings is None or isinstance(settings, Settings)):
        raise ValueError(f"settings must be a Settings, or None for the default ones, not {settings!r}")
    settings = Settings() if settings is None else settings
    record = Record.of(train)
    if len(record) < FEWEST_SAMPLES:
        raise ValueError(f"train must have at least {FEWEST_SAMPLES} samples, not {len(record)}")
    with one_thread():
        return _learn(record, settings)


def _learn(record: Record, settings: Settings) -> Learned:
    _require_moving(record, settings)
    colour = None
    if settings.smoothness == "learn":
        colour = _colour(record)
        settings = replace(settings, smoothness=colour.smoothness)
    choices = candidates(settings, record)
    # Where there is a choice, only the chosen one is climbed to its end.
    attempts = [_attempt(record, choice, finish=len(choices) == 1) for choice in choices]
    best = min(attempts, key=lambda attempt: attempt.candidate.error)
    if best.fit is None or best.candidate.error == np.inf:
        raise ValueError(
            "no model of the training data, with these settings, can forecast any part of them: where a prior is "
            "given, its C must see the states"
        )
    try:
        unseen = unseen_forecasts(record, best.fit.settings)
    except np.linalg.LinAlgError:
        unseen = None
    if unseen is None or not np.isfinite(unseen.mse).all():
        raise ValueError("half of the training data do not determine a model that can forecast: more are needed")
    finished = best.fit if len(choices) == 1 else _finished(best.fit, record)
    segments = generalized(finished.settings, finished.scaling, record)
    certainty = certainty_of(finished.model, segments, finished.ascent)
    finished = _along_trajectories(finished, record, Samples.of(*segments))
    return Learned.of(
        finished,
        record,
        certainty,
        _free_energy(finished, segments),
        unseen,
        tuple(attempt.candidate for attempt in attempts),
        colour,
        cautions(finished, certainty, unseen, colour, record),
    )


def _require_moving(record: Record, settings: Settings) -> None:
    """Refuses channels that tell nothing, over the whole record."""
    inputs, outputs = record.spread
    known = known_inputs(settings, len(inputs.mean))
    for name, constant in (("inputs", ~inputs.moving & known), ("outputs", ~outputs.moving)):
        still = np.flatnonzero(constant)
        if len(still):
            raise ValueError(f"{name} column {still[0]} must vary: constant samples determine no model")


def _finished(fitted: Fit, record: Record) -> Fit:
    """The chosen fit, climbed to its end; as it was, if it breaks down on the way."""
    try:
        return fit(record, fitted.settings)
    except np.linalg.LinAlgError:
        return fitted


def _along_trajectories(fitted: Fit, record: Record, samples: Samples) -> Fit:
    """With θ climbed on along trajectories of the record, where that is asked for and can be; else as it was."""
    model, ascent, settings, scaling = fitted.model, fitted.ascent, fitted.settings, fitted.scaling
    try:
        with breaking_down():
            trajectory = at_once(
                trajectory_by_parts(model, settings, scaling, ascent.belief.theta, fitted.predictor.gain, record)
            )
            if trajectory is None:
                return fitted
            place = Climb(model, samples).around(trajectory.theta, ascent.belief)
            predictor = fitted.predictor.of_theta(trajectory.theta, model.sizes, record.dt)
            predictor = at_once(with_innovations_by_parts(predictor, scaling.scale_segments(record)))
    except np.linalg.LinAlgError:
        return fitted
    there = replace(ascent, belief=place.belief, state_map=place.state_map)
    onward = replace(fitted, ascent=there, predictor=predictor, trajectory=trajectory)
    mse = trials(onward, record).mse / scaling.output_scale**2
    return replace(onward, trajectory=replace(trajectory, mse=mse)) if np.isfinite(mse).all() else fitted


def _free_energy(fitted: Fit, segments: Sequence[Array]) -> Array:
    """F(t) of every generalized sample, at the end of the climb."""
    data = np.concatenate(segments)
    return free_energy(fitted.model, data, data @ fitted.ascent.state_map.T, fitted.ascent.belief)


def _colour(record: Record) -> Colour:
    try:
        return estimate_colour(record)
    except np.linalg.LinAlgError:
        raise ValueError("the training data do not determine the smoothness of their noise: set it") from None


@dataclass(frozen=True, eq=False)
class _Attempt:
    candidate: Candidate
    fit: Fit | None


def _attempt(record: Record, settings: Settings, finish: bool) -> _Attempt:
    assert settings.window and settings.parameter_precision
    choice = (settings.window, settings.parameter_precision)
    try:
        fitted = fit(record, settings, finish)
        error = float(np.mean(trials(fitted, record).mse / record.outputs.var(axis=0)))
    except np.linalg.LinAlgError:
        return _Attempt(Candidate(*choice, np.inf), None)
    return _Attempt(Candidate(*choice, error if np.isfinite(error) else np.inf), fitted)
