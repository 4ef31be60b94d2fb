from __future__ import annotations

from math import ceil, floor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdem.view.lines import LABELS, LABELS_IF_LOW, readable_range

numbers = st.floats(-1e6, 1e6)


@given(numbers, numbers, st.sampled_from([LABELS, LABELS_IF_LOW]))
def test_a_range_holds_the_values_and_two_numbers(one: float, other: float, labels: int) -> None:
    low, high = sorted((one, other))
    start, end = readable_range(low, high, labels)
    assert start < low <= high < end
    steps = [10.0**k for k in range(-18, 9)]
    assert any((end - start) / s <= labels + 1 and floor(end / s) - ceil(start / s) >= 1 for s in steps)


def test_it_does_not_grow_where_the_numbers_are_there_already() -> None:
    assert readable_range(0.9, 2.1) == pytest.approx((0.84, 2.16))
