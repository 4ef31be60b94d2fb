"""Random generative models and data for the engine's tests."""

import numpy as np
from hypothesis import strategies as st
from numpy.random import default_rng

from mavdem.dem.engine.free_energy import Posterior
from mavdem.dem.engine.generalized_coordinates import temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics


def positive_definite(rng, size):
    factor = rng.standard_normal((size, size))
    return factor @ factor.T / size + np.eye(size)


def random_model(
    seed,
    n,
    r,
    m,
    p,
    d,
    drop,
    groups,
    bounded=False,
):
    """A model with random priors: coupled parameters, coupled hyperparameters, one λ each or one for each channel.

    ``bounded``: whether something is known of x before it is seen.
    """
    rng = default_rng(seed)
    # Without the highest order's dynamics there must be another's, and outputs must reach every state.
    drop = drop and p > 0 and n <= m * (p + 1)
    k = n * n + n * r + m * n
    g = m + n if groups else 2
    return GenerativeModel(
        n,
        r,
        m,
        p,
        d,
        p - drop,
        output_temporal_precision=temporal_precision(p, rng.uniform(0.3, 3.0)),
        state_temporal_precision=temporal_precision(p - drop, rng.uniform(0.3, 3.0)),
        output_groups=np.arange(m) if groups else np.zeros(m, np.intp),
        state_groups=m + np.arange(n) if groups else np.ones(n, np.intp),
        input_precision=10 * positive_definite(rng, r * (d + 1)),
        prior=Prior(
            rng.standard_normal(k),
            rng.uniform(0.1, 10) * positive_definite(rng, k),
            rng.standard_normal(g),
            # Firm enough that no noise can vanish altogether where hidden states explain everything.
            rng.uniform(20, 50) * positive_definite(rng, g),
        ),
        state_precision=positive_definite(rng, n) if bounded else None,
    )


def random_samples(seed, model):
    rng = default_rng(seed + 1)
    return SufficientStatistics.from_segments(rng.standard_normal((40, model.hidden_columns.start)))


def random_posterior(seed, model, samples):
    """Anything a posterior may be, not only what the steps arrive at; and the linear map its X comes of."""
    rng = default_rng(seed + 2)
    k = len(model.prior.theta_mean)
    g = len(model.prior.lambda_mean)
    size = model.error_operator(model.prior.theta_mean).shape[1] - model.hidden_columns.start
    state_map = rng.standard_normal((size, model.hidden_columns.start))
    return state_map, Posterior(
        GeneralizedMoments.from_state_map(model, samples, state_map),
        0.1 * positive_definite(rng, size),
        rng.standard_normal(k),
        0.1 * positive_definite(rng, k),
        rng.standard_normal(g),
        0.1 * positive_definite(rng, g),
    )


seeds = st.integers(0, 10**6)
models = st.builds(
    random_model,
    seed=seeds,
    n=st.integers(1, 3),
    r=st.integers(1, 3),
    m=st.integers(1, 3),
    p=st.integers(0, 6),
    d=st.integers(0, 6),
    drop=st.booleans(),
    groups=st.booleans(),
    bounded=st.booleans(),
)
