"""Axes of plots: how far a range is widened until the viewer numbers three ticks."""

from pytest import mark

from mavdem.view.axes import range_with_ticks


@mark.parametrize(
    ("values", "shown"),
    [
        # Three multiples of ten are there.
        ((-4.0, 20.0), (-4.0, 20.0)),
        # The nearer next one is added; sizes are not extended below zero.
        ((-8.0, 8.0), (-10.0, 10.0)),
        ((0.0, 9.0), (0.0, 20.0)),
        # A constant.
        ((12.6, 12.6), (12.5, 12.7)),
    ],
)
def test_a_range_has_three_multiples_of_a_power_of_ten(values, shown):
    low, high = range_with_ticks(*values, intervals=4.0)
    assert (round(low, 6), round(high, 6)) == shown
