"""Slow motion: whether a model of it, at 8 to 40 Hz, predicts better than no model."""

from __future__ import annotations

import numpy as np

from mavdem.evaluate.held_out import BASELINES, HeldOut
from mavdem.evaluate.paired_test import SIGNIFICANCE, paired

MOST_OF_BASELINE = 0.9
"""Squared error over that of a forecast without a model, up to which a model is worth having: an RMSE 5 % lower."""
CAUTION = "The model is of the slow motion only: what shows at several Hz, such as the motors' effect, is not in it."


def objection(held_out: HeldOut) -> str:
    """Why a model is none of the slow motion: a baseline that it does not beat beyond chance; empty if it beats all."""
    for name in BASELINES:
        ratio = held_out.error_ratio() / held_out.error_ratio(name)
        test = paired(held_out.error_ratios(baseline=name), np.ones(len(held_out)))
        of = (
            f"A model of the slow motion has {ratio:.2g} times the squared error of “{name}” in {len(held_out)} windows"
        )
        if not ratio <= MOST_OF_BASELINE:
            return f"{of} that it has not seen: at most {MOST_OF_BASELINE:g} times would make it worth having."
        if test.verdict != "lower":
            return f"{of} that it has not seen, which may be luck (p = {test.p_value:.2g}, needed {SIGNIFICANCE:g})."
    return ""
