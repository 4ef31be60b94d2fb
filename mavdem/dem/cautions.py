"""Cautions: what a user must know before trusting a learnt model, one sentence for each."""

from __future__ import annotations

import numpy as np

from mavdem.dem.colour import Colour
from mavdem.dem.fit import Fit
from mavdem.dem.record import Record
from mavdem.dem.scatter import Certainty
from mavdem.dem.trials import Unseen

HARDLY_BETTER = 0.9
"""Squared error of forecasts, in units of the training variance, from which a model is cautioned against."""

MOTORS_SHARE = 0.15
"""The motors must take this share off the squared error of forecasts, or the model is cautioned against: where they are
of another flight, or shifted by seconds, they rarely take so much by chance."""


def cautions(
    fitted: Fit, certainty: Certainty, unseen: Unseen, colour: Colour | None, record: Record
) -> tuple[str, ...]:
    """The sentences.

    Args:
        fitted: the model.
        certainty: of its parameters.
        unseen: forecasts of data that a fit has not seen.
        colour: of the noise, where it was learnt.
        record: the training data.
    """
    model = fitted.scaling.physical_model(fitted.ascent.belief.theta, fitted.model.n)
    error = (unseen.weighted_mse / record.outputs.var(axis=0)).mean(axis=1)
    judged = "Inside the training data, where each half was forecast from the other,"
    told = []
    if not error.mean() < HARDLY_BETTER:
        useful = int(np.argmin(error < HARDLY_BETTER)) * record.dt
        told.append(
            f"{judged} forecasts beyond {useful:.2g} s were hardly better than the constant mean: a good one after it "
            "is luck. Learn from more, or from a livelier stretch."
        )
    if fitted.scaling.known.any() and not unseen.motors_share > MOTORS_SHARE:
        told.append(
            f"{judged} the motors took {max(unseen.motors_share, 0):.0%} off the squared error of forecasts: the model "
            "hardly ties the motion to them. Let them work more, in wind or with small sideways steps."
        )
    if model.spectral_abscissa > 0:
        told.append(f"The model is unstable: it grows e-fold in {1 / model.spectral_abscissa:.3g} s.")
    if fitted.trajectory is None and certainty.scatter is None:
        told.append(
            "F̄ has no maximum at these parameters: how far they are off is not known. More iterations, or a firmer "
            "prior, may find one."
        )
    if not fitted.settled:
        told.append(_unsettled(fitted))
    if colour is not None and not np.isfinite(colour.log_sd):
        told.append(
            f"F̄ tells no smoothness of the noise from others: {colour.smoothness:.2g} s, which was taken, is at an end "
            "of what was tried."
        )
    if fitted.settings.state_rate is not None and not fitted.ascent.flowed[1:].all():
        exact = np.count_nonzero(~fitted.ascent.flowed[1:])
        told.append(
            f"In {exact} of {len(fitted.ascent.flowed) - 1} rounds the states' flow at state_rate was unstable or led "
            "down, and its exact limit was taken instead."
        )
    return tuple(told)


def _unsettled(fitted: Fit) -> str:
    """How the last climb ended, if not at a maximum."""
    if fitted.trajectory is not None:
        return (
            f"The climb of F̄ along trajectories had not settled after {fitted.trajectory.rounds} steps: "
            "learn from more samples, or ask for fewer states."
        )
    ascent, rounds = fitted.ascent, len(fitted.ascent.free_energy) - 1
    if rounds >= fitted.settings.iterations:
        return (
            f"F̄ had not settled at the limit of {rounds} iterations, nor have the parameters: learn from more samples, "
            "ask for fewer states, or set a higher limit (Settings.iterations)."
        )
    if np.isnan(ascent.left):
        return (
            f"The climb of F̄ broke down after {rounds} iterations, before parameters had settled: learn from more "
            "samples, or ask for fewer states."
        )
    return (
        f"After {rounds} iterations no step led F̄ higher, though its curvature promises {ascent.left:.2g} nats more: a "
        "flat ridge, or rounding. Forecasts are determined, parameters along the ridge are not: read none of them off "
        "the model, learn from more samples, or ask for fewer states."
    )
