"""The order by free energy: it is found, the rule is what it says, and what cannot be tried is said."""

from __future__ import annotations

import numpy as np
import pytest
from order_systems import paper_flight, random_flight
from scipy.stats import binom
from simulated import simulated

from mavdem import Flight
from mavdem.dem.order import STRONG, FlightOrders, OrderChoice, choose_order, orders_of


def told(*heights: list[float]) -> OrderChoice:
    return OrderChoice(tuple(FlightOrders(np.array(each), 0.1, np.ones(len(each)), 100.0, ()) for each in heights))


def test_the_lowest_order_that_none_beats_by_more_than_strong_evidence():
    assert told([0.0, 50.0, 50.0 + STRONG - 0.1, 40.0]).chosen == 2
    assert told([0.0, 50.0, 50.0 + STRONG + 0.1, 40.0]).chosen == 3
    # A step that gains nothing by itself does not stop the search.
    assert told([0.0, -1.0, 30.0]).chosen == 3
    rising = told([0.0, 10.0, 20.0])
    assert rising.chosen == 3 and not rising.saturated and "still rises" in rising.reason
    assert told([np.nan, 5.0, np.nan]).chosen == 2


def test_over_flights_a_gain_must_be_of_more_than_one():
    one_flight_only = told([0.0, 50.0, 80.0], [0.0, 50.0, 46.0], [0.0, 50.0, 47.0], [0.0, 50.0, 46.0])
    assert one_flight_only.mean[2] > one_flight_only.mean[1] + STRONG
    assert one_flight_only.chosen == 2
    np.testing.assert_allclose(one_flight_only.spread, np.std(one_flight_only.free_energy, axis=0, ddof=1))


@pytest.mark.slow
def test_the_order_is_found():
    """In nine of ten runs at least, by what so few runs can tell (a false alarm in a thousand)."""
    runs = [(order, random_flight(order, 2, seed, disturbance=0.02)) for order in (1, 2, 3, 4) for seed in (201, 202)]
    runs += [(order, paper_flight(order, 203)) for order in (2, 3, 4)]
    right = sum(OrderChoice((orders_of(flight, 5),)).chosen == order for order, flight in runs)
    assert right >= binom.ppf(1e-3, len(runs), 0.9)


@pytest.mark.slow
def test_orders_that_the_data_do_not_allow_are_not_tried_and_said():
    choice = choose_order(simulated(samples=100, wind=1.0), max_order=8)
    told_orders = np.isfinite(choice.free_energy[0])
    assert told_orders[0] and not told_orders[-1]
    assert any("not tried" in remark for remark in choice.remarks)
    with pytest.raises(ValueError, match="^40 samples are too few"):
        choose_order(simulated(samples=40, wind=1.0))


def test_arguments_that_do_not_fit_are_named():
    flight = simulated(samples=150)
    with pytest.raises(ValueError, match="^max_order must be"):
        choose_order(flight, max_order=0)
    with pytest.raises(ValueError, match="^flights must have the same numbers"):
        choose_order([flight, Flight(flight.time, flight.inputs[:, :2], flight.outputs)])
    with pytest.raises(ValueError, match="^flights must be at least one"):
        choose_order([])
