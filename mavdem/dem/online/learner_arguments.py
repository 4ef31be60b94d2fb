"""Checks of the arguments of the online learner: horizons, samples and mixers."""

from __future__ import annotations

from typing import Any

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.validation import (
    MAX_STEPS,
    require_finite_and_bounded,
    validated_count,
    validated_table,
)

DEFAULT_HORIZONS = (1, 5, 10, 25, 50)
"""Steps ahead that are predicted unless others are given."""

MIN_MIXER_COSINE = 0.9
"""Cosine of the angle between two estimates of the axis mixer, above which they differ by chance only; a choice."""


def validated_horizons(horizons: tuple[int, ...]) -> tuple[int, ...]:
    """Checks the horizons of the predictions.

    Args:
        horizons: Steps ahead to predict.

    Returns:
        The steps as integers.

    Raises:
        ValueError: There are no horizons, they do not increase, or one is not an integer from 1 to ``MAX_STEPS``.
    """
    steps: list[int] = []
    if np.ndim(horizons):
        steps = [validated_count(number, "horizons", MAX_STEPS) for number in horizons]
    if not steps or steps != sorted(set(steps)):
        raise ValueError(f"horizons must be steps, increasing, not {horizons!r}")
    return tuple(steps)


def checked_row(values: Any, name: str, columns: int) -> Array:
    """Checks the values of one sample, in the same way as a table of samples for ``learn``.

    Args:
        values: The values; one number is accepted for a single column.
        name: Name of the argument, for the message of an error.
        columns: Required number of values.

    Returns:
        The values as an array, (columns,).

    Raises:
        ValueError: There are more or fewer values, or one is not finite or larger than ``MAX_ABS_VALUE``.
    """
    if isinstance(values, np.ndarray) and values.shape == (columns,) and values.dtype == float:
        # The rows of a live stream are such arrays, which need no conversion.
        row = values
    else:
        row = validated_table([values], name, columns)[0]
    require_finite_and_bounded(row, name)
    return row


def is_same_mixer(mixer: Array, other_mixer: Array) -> bool:
    """Returns whether two axis mixers are so similar, apart from signs, that their difference may be due to chance.

    Args:
        mixer: (r, c) combinations of the inputs, as columns of unit length.
        other_mixer: (r, c) combinations of the other mixer.
    """
    cosines = np.sum(mixer * other_mixer, axis=0)
    return bool(abs(cosines).min() >= MIN_MIXER_COSINE)
