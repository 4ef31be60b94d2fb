"""Parameters: the entries of A, B and C by name, and how surely, and from what, an estimate is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem.dem import Learned
from mavdem.dem.priors import hyperparameter_prior
from mavdem.view.outlook import LEVEL


def prior_outweighs_data(learned: Learned) -> NDArray[np.bool_]:
    """Which λ, (g,), owe the greater part of their precision to the prior: in effect it fixes them."""
    posterior = 1 / learned.learning.lambda_sd[-1] ** 2
    m, n = learned.model.C.shape
    _, prior = hyperparameter_prior(learned.settings, n, m)
    return np.asarray(posterior < 2 * np.diag(prior))


def estimate_band(
    mean: NDArray[np.float64], sd: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The edges between which a Gaussian posterior holds an estimate to lie with probability ``LEVEL``."""
    half = norm.ppf(0.5 + LEVEL / 2) * sd
    return mean - half, mean + half


def by_group(noise: str, channels: Sequence[str], groups: NDArray[np.intp]) -> list[str]:
    """What each λ of a noise, "z" or "w", is about: the channels that share it."""
    names = [
        " and ".join(channel for channel, group in zip(channels, groups, strict=True) if group == own)
        for own in np.unique(groups)
    ]
    return (
        [{"z": "z, measurement", "w": "w, process"}[noise]] if len(names) == 1 else [f"{noise} of {n}" for n in names]
    )
