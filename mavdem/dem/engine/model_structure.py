"""Indices of parameters, errors and regressors of the generative model in its vectors and matrices.

The equations of ``generative.py`` are used: prediction errors ε̃ = E(θ) [ỹ; η̃; X] with the precision Π̃(λ).
"""

from __future__ import annotations

from typing import NamedTuple

from mavdem.arrays import Array, Indices


class ErrorRows(NamedTuple):
    """Rows of the vector of prediction errors ε̃, by what is predicted."""

    outputs: slice
    """ỹ − C̃ x̃."""

    inputs: slice
    """ṽ − η̃."""

    states: slice
    """D x̃ − Ã x̃ − B̃ ṽ."""

    state_prior: slice
    """x itself, if x has a prior about 0; empty if it has none."""


class OperatorStructure(NamedTuple):
    """Positions of the parameters in the error operator E: P entries of it are −θ, all others are constants."""

    constant: Array
    """E at θ = 0."""

    rows: Indices
    """(P,) row of each entry that is a parameter."""

    columns: Indices
    """(P,) column of each such entry."""

    parameters: Indices
    """(P,) index in θ of each such entry."""


class RegressorLayout(NamedTuple):
    """Positions of the regressors of [A B] and of C, with their derivatives, in the joint vector [ỹ; η̃; X]."""

    state_columns: Indices
    """(q + 1, n + r) columns of [x; v] by order; one past the last column for derivatives that inputs do not have."""

    output_columns: Indices
    """(p + 1, n) columns of x by order."""

    state_parameters: Indices
    """(n, n + r) indices in θ of the rows of [A B]."""

    output_parameters: Indices
    """(m, n) indices in θ of the rows of C."""


class RegressorMoments(NamedTuple):
    """Second moments of the regressors, summed over the samples, and over their orders with the weights S."""

    states: Array
    """(n + r, n + r) moments of [x; v], which [A B] multiplies."""

    outputs: Array
    """(n, n) moments of x, which C multiplies."""


class PrecisionStructure(NamedTuple):
    """How the precision Π̃ of the errors depends on λ: each column is scaled by one noise precision e^λ."""

    precision_at_zero: Array
    """(dim ε̃, dim ε̃) Π̃ at λ = 0."""

    noise_of_error: Indices
    """(dim ε̃,) index in λ of the noise of each error; −1 for errors whose precision does not depend on λ."""
