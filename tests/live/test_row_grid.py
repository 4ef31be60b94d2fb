"""The grid of live rows: when a point is complete; and the rates of the streams that rows are made of."""

import numpy as np
from pytest import approx, mark

from mavdem.dataset.resampling import FILTER_EDGE_STEPS, STAMP_RESOLUTION
from mavdem.live.flight_phase import FlightPhase
from mavdem.live.recent_messages import RecentMessages
from mavdem.live.row_builder import RowBuilder
from mavdem.live.row_grid import StreamSampling, value_at
from mavdem.live.samples import SampleStream

RATE = 400.0
DT = 0.01
POINT = 10.0
FILTER_EDGE = FILTER_EDGE_STEPS * DT - STAMP_RESOLUTION


def stream_until(end_time):
    """A stream of a constant 2 at 400 Hz, whose last stamp is the end time."""
    stream = SampleStream()
    for number in range(round(1.0 * RATE), -1, -1):
        stream.add(end_time - number / RATE, (2.0,))
    return stream


@mark.parametrize(
    "seconds_after_point, is_complete", [(FILTER_EDGE + 1e-6, True), (FILTER_EDGE - 1e-6, False)]
)
def test_a_low_passed_point_waits_for_the_edge_of_the_filter(seconds_after_point, is_complete):
    reach = round(FILTER_EDGE_STEPS * DT * RATE)
    weights = np.full(2 * reach + 1, 1 / (2 * reach + 1))
    offsets = np.arange(-reach, reach + 1) / RATE
    sampling = StreamSampling(weights, offsets, keeps_samples=False)
    values = value_at(stream_until(POINT + seconds_after_point), sampling, POINT, DT)
    assert values == (approx((2.0,)) if is_complete else None)


def test_an_interpolated_point_waits_for_the_next_sample_only():
    sampling = StreamSampling(np.ones(1), np.zeros(1), keeps_samples=False)
    assert value_at(stream_until(POINT), sampling, POINT, DT) == approx((2.0,))
    assert value_at(stream_until(POINT - 1 / RATE), sampling, POINT, DT) is None


def test_rates_are_in_ascending_order_with_the_fastest_port_of_each_message():
    rows = RowBuilder("roll", FlightPhase(RecentMessages()), report=[].append)
    for name, port, rate in (("SLOW", 0, 4.0), ("TWO_PORTS", 0, 2.0), ("TWO_PORTS", 1, 20.0)):
        for time in np.arange(0.0, 5.0, 1 / rate):
            rows.add_sample(name, port, time, (0.0,))
    rates = rows.rates(5.0)
    assert list(rates) == ["SLOW", "TWO_PORTS"]
    assert list(rates.values()) == approx([4.0, 20.0])
