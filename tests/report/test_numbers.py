"""Numbers for people: digits that their intervals bear."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem.report.numbers import plus_minus, rounded


@pytest.mark.parametrize(
    ("value", "half", "shown"),
    [
        (-5.0, 0.07, "-5.00 ± 0.07"),
        (0.00155, 0.009, "0.002 ± 0.009"),
        (-0.0001, 0.01, "0.000 ± 0.010"),
        (3.5123, 1.149, "3.5 ± 1.1"),
        (1234.0, 32.0, "1230 ± 30"),
        (-2.457e-8, 3e-10, "(-24.6 ± 0.3)e-9"),
        (7.5e6, 2e4, "(7.500 ± 0.020)e6"),
        (0.25, np.nan, "-"),
        (0.25, 0.0, "0.25"),
    ],
)
def test_an_estimate_has_the_digits_of_its_interval(value, half, shown):
    assert plus_minus(value, half) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (1234.5, "1234"), (0.0123, "0.012"), (9.96, "10.0"), (np.inf, "infinite"), (1e9, "1e+09")],
)
def test_numbers_without_an_interval_have_two_digits(value, shown):
    assert rounded(value) == shown
