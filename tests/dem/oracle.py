"""The results of the paper's authors' own code, and their simulated case a as this engine's model and data."""

import numpy as np
from pytest import mark
from recorded_flights import SHARED

from mavdem.dem.engine.generalized_coordinates import embed, temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.model import pack

ORACLE = SHARED / "oracle"

needs_oracle = mark.skipif(not ORACLE.is_dir(), reason=f"the authors' results are not in {ORACLE}")

EDGE = 7
"""Samples at either end of case a, p + 1 of them, whose derivatives the authors set to zero."""

WITHOUT_EDGES = slice(EDGE, -EDGE - 1)
"""The rows they did not: their last window ends one sample early."""


def load(name):
    """The arrays of one file; matrices of one row or column stay as they were saved."""
    with np.load(ORACLE / f"{name}.npz") as saved:
        return dict(saved)


def case_a_model(data):
    """What the authors assume of case a, whose ``data`` are those of ``case_a_data``."""
    correlation = temporal_precision(6, data["s"].item())
    return GenerativeModel(
        n=2,
        r=1,
        m=4,
        p=6,
        d=2,
        q=6,
        output_temporal_precision=correlation,
        state_temporal_precision=correlation,
        output_groups=np.zeros(4, np.intp),
        state_groups=np.ones(2, np.intp),
        # A sub-block of the larger S, not the S of d = 2.
        input_precision=correlation[:3, :3] / data["sigma_v"].item() ** 2,
        prior=Prior(
            pack(data["A_prior"], data["B_prior"], data["C_prior"]),
            data["P_theta"],
            data["h0"].ravel(),
            data["P_lambda"],
        ),
    )


def case_a_generalized(data):
    """[ỹ; η̃] of case a, (320, 31): with p = 6 and d = 2, and the derivatives at the edges set to zero."""
    dt = data["dt"].item()
    outputs = np.zeros((320, 28))
    inputs = np.zeros((320, 3))
    outputs[:, :4] = data["y"]
    inputs[:, 0] = data["u"][0]
    outputs[WITHOUT_EDGES] = embed(data["y"], 6, dt, 7, 3)[EDGE - 3 : -EDGE + 2]
    inputs[WITHOUT_EDGES] = embed(data["u"].T, 2, dt, 3, 1)[EDGE - 1 : -EDGE]
    return np.hstack([outputs, inputs])


def case_a_truth(data):
    """θ that case a was simulated with."""
    return pack(data["A"], data["B"], data["C"])
