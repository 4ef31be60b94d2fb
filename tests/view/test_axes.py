"""Axes of plots: how far a range is widened until the viewer numbers two ticks."""

from pytest import mark

from mavdem.view.axes import MIN_TICK_DISTANCE, TAB_HEIGHT, range_with_ticks, tick_intervals


@mark.parametrize(
    ("values", "shown"),
    [
        # Multiples of ten are there.
        ((-4.0, 20.0), (-4.0, 20.0)),
        # The nearer next one is added; sizes are not extended below zero.
        ((-8.0, 7.0), (-10.0, 7.0)),
        ((0.0, 9.0), (0.0, 10.0)),
        # A constant.
        ((12.61, 12.61), (12.6, 12.7)),
    ],
)
def test_a_range_has_two_multiples_of_a_power_of_ten(values, shown):
    """The range of an axis is widened until it has two round numbers for ticks."""
    low, high = range_with_ticks(*values, intervals=4.0)
    assert (round(low, 6), round(high, 6)) == shown


def test_a_plot_of_half_a_tab_has_room_for_more_than_twice_the_ticks_of_a_quarter():
    assert tick_intervals(0.5) > 2 * tick_intervals(0.25)
    assert tick_intervals(1.0) * MIN_TICK_DISTANCE < TAB_HEIGHT
