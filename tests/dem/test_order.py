"""The order by free energy: which order is chosen for given free energies, and which data have one."""

from unittest.mock import Mock

import numpy as np
from pytest import approx, mark, raises
from refusals import refused
from simulated import simulated

from mavdem import Flight
from mavdem.dem import order_choice
from mavdem.dem.order_choice import (
    STANDARD_ERRORS,
    FlightFreeEnergy,
    OrderChoice,
    free_energy_by_order,
)
from mavdem.facts.model import ModelRefusal, OrderFact
from mavdem.report.comparison import order_report


def choice(*flights):
    return OrderChoice(
        tuple(
            FlightFreeEnergy(np.array(free_energies), 0.1, 100.0, ()) for free_energies in flights
        )
    )


@mark.parametrize(
    "flights, chosen",
    [
        ([[0.0, 100.0, 95.0, 90.0]], 2),  # The highest F̄.
        # A further state does not raise the highest by as much as is strong evidence.
        ([[0.0, 100.0, 102.9, 90.0]], 2),
        ([[0.0, 100.0, 103.1, 90.0]], 3),
        ([[0.0, 100.0, 99.0, 110.0]], 4),  # A higher order than one that gains nothing.
        # One flight alone does not determine an order.
        ([[0.0, 500.0], [0.0, -5.0], [0.0, -5.0]], 1),
        # The limit is two standard errors of the mean, 100 each.
        ([[0.0, 110.0], [0.0, 310.0]], 2),
        ([[0.0, 90.0], [0.0, 290.0]], 1),
        ([[0.0, 10.0, np.nan]], 2),  # An order that could not be learned.
        ([[np.nan, 10.0, 20.0]], 3),
        ([[0.0, 10.0, np.nan], [0.0, 10.0, 30.0]], 3),  # The flights that have both orders decide.
    ],
)
def test_the_order_is_the_lowest_that_no_higher_one_is_strongly_better_than(flights, chosen):
    """The order is chosen by the free energies, nats, of orders 1, 2, … in each flight."""
    assert choice(*flights).chosen == chosen


def test_a_choice_says_why():
    """The reason states how much the next order gains, and with several flights its standard errors."""
    told = choice([0.0, 100.0, 95.0])
    assert told.saturated and told.reason.code is OrderFact.ORDER_CHOSEN
    assert told.reason.figures["order"] == 2 and told.reason.figures["free_energy_gain"] == -5.0
    assert told.reason.figures["standard_errors"] is None
    rising = choice([0.0, 100.0], [0.0, 110.0])
    assert not rising.saturated and rising.reason.figures["free_energy_gain"] is None
    assert rising.reason.figures["standard_errors"] == STANDARD_ERRORS
    assert rising.gain(2, reference=1) == approx((105.0, 5.0))
    assert told.gain(2, reference=1) == (100.0, 0.0)
    assert rising.spread == approx([0.0, np.sqrt(50)])
    assert np.isnan(told.spread).all()
    assert (rising.mean.tolist(), rising.chosen) == ([0.0, 105.0], 2)
    table = order_report(rising, "ab", True)[1]
    assert table.rows[0] == ["1", "-100.0", "-110.0", "-105.0", "0.0"]


@mark.parametrize("arguments", [{"max_order": 0}, {"max_order": 9}])
def test_what_is_no_argument_is_named(arguments):
    with raises(ValueError, match=next(iter(arguments))):
        free_energy_by_order(simulated(samples=200), **arguments)


@mark.slow
def test_orders_that_the_data_do_not_allow_or_that_break_down_are_said(monkeypatch):
    """100 samples are too few for high orders, and the fit of one order overflows."""
    free_energies = free_energy_by_order(simulated(samples=100, wind=1.0), max_order=6)
    is_fitted = np.isfinite(free_energies.free_energy)
    assert is_fitted[0] and not is_fitted[-1]
    (remark,) = free_energies.remarks
    assert remark.code is OrderFact.ORDERS_NOT_FITTED
    assert (
        remark.figures["order"]
        == is_fitted.sum() + 1
        == int(free_energies.effective_samples * 2 / 7) + 1
    )
    fits = (Mock(free_energy=5.0), None)
    monkeypatch.setattr(order_choice, "fits_by_order", lambda *_: fits)
    (remark,) = free_energy_by_order(simulated(samples=200), max_order=2).remarks
    assert (remark.code, remark.figures["order"]) == (OrderFact.ORDER_BROKE_DOWN, 2)
    refusal = refused(free_energy_by_order, simulated(samples=40, wind=1.0))
    assert refusal.code is ModelRefusal.TOO_FEW_TO_CHOOSE_ORDER


def test_a_ramp_whose_rate_never_changes_has_no_order():
    flight = simulated(samples=700)
    ramp = Flight(flight.time, flight.inputs, flight.time)
    assert refused(free_energy_by_order, ramp, max_order=1).code is ModelRefusal.NO_ORDER_FITTED
