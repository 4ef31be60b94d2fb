"""The bars are what they say, of outcomes of which each is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bars import Bars
from bars_account import details, summary
from simulated import simulated

from mavdem import learn
from mavdem.account import Table
from mavdem.comparison import METHODS, Comparison, dem, judge
from mavdem.dem import Settings
from mavdem.windows import windows

FLIGHTS = {"a": simulated(0, samples=680, wind=2.0), "b": simulated(1, samples=680, wind=6.0)}
WINDOWS = [one for name, flight in FLIGHTS.items() for one in windows(name, flight, train=300, test=60, hop=160)]
SETTINGS = Settings(window=9, parameter_precision=1.0)
TRIED = (
    dem("DEM", SETTINGS),
    dem("DEM p=1", replace(SETTINGS, p=1, d=1)),
    *(method for method in METHODS if method.name in ("ARX(1)", "ARX(4)", "hold last", "constant mean")),
)
STEPS = (1, 5, 10, 25, 50, 60)


@pytest.fixture(scope="module")
def compared():
    return Comparison.of(WINDOWS, [judge(method, window) for window in WINDOWS for method in TRIED])


@pytest.fixture(scope="module")
def bars(compared):
    return Bars(compared, "DEM", "DEM p=1")


def medians(compared, method):
    return np.array(
        [
            [at.relative for one in compared.standings(flight) if one.method == method for at in one.horizons]
            for flight in compared.flights
        ]
    )


def reached(bars):
    return {bar.name: bar.reached for bar in bars.summary()}


@pytest.mark.slow
def test_errors_are_held_against_the_best_peer_of_each_flight_and_against_each(compared, bars):
    ours, one, four = (medians(compared, name) for name in ("DEM", "ARX(1)", "ARX(4)"))
    assert (len(WINDOWS), bars.steps, bars.peers) == (6, STEPS, ("ARX(1)", "ARX(4)"))
    best = np.minimum(one, four)
    assert (best == one).any() and (best == four).any()
    np.testing.assert_allclose(bars.over_best_peer, ours / best)
    over = reached(bars)
    np.testing.assert_allclose(
        over["median over the best peer's of each flight"], np.sqrt(np.prod(ours / best, axis=0))
    )
    single = [np.sqrt(np.prod(ours / peer, axis=0)) for peer in (one, four)]
    np.testing.assert_allclose(over["median over the best single peer's"], np.maximum(*single))


def test_generalized_coordinates_are_counted_by_flight_and_by_window(compared, bars):
    by_flight, by_window = bars.over_without
    np.testing.assert_allclose(by_flight, medians(compared, "DEM") / medians(compared, "DEM p=1"))
    better = [
        [with_them.relative < without.relative for with_them, without in zip(row[0].skill, row[1].skill, strict=True)]
        for row in compared.outcomes
    ]
    assert (by_window < 1).tolist() == better
    np.testing.assert_allclose(reached(bars)["flights on which it beats DEM p=1"], (by_flight < 1).mean(axis=0))


@pytest.mark.slow
def test_a_band_holds_what_the_model_says_it_does(bars):
    for window, inside in zip(WINDOWS, bars.inside, strict=True):
        lower, upper = learn(window.train, SETTINGS).forecast_band(window.test.inputs)
        measured = window.test.outputs
        np.testing.assert_array_equal(inside, ((lower <= measured) & (measured <= upper)).mean(axis=1))
    shares = reached(bars)["samples number k in the 90 % band"]
    np.testing.assert_allclose(shares, [bars.inside[:, steps - 1].mean() for steps in STEPS])


@pytest.mark.slow
def test_a_forecast_doubts_itself_by_what_it_expects_of_its_first_samples(compared):
    expected = [learn(one.train, SETTINGS).forecast_variance(one.test.inputs) for one in WINDOWS]
    share = np.array(
        [
            [(rows[:steps] / one.train.outputs.var(axis=0)).mean() for steps in STEPS]
            for rows, one in zip(expected, WINDOWS, strict=True)
        ]
    )
    # So much more doubt that some forecasts doubt themselves and some do not.
    more = 0.5 / np.median(share)
    doubting = replace(
        compared,
        outcomes=tuple((replace(row[0], expected=more * row[0].expected), *row[1:]) for row in compared.outcomes),
    )
    doubted = Bars(doubting, "DEM", None).doubted
    assert doubted.any() and not doubted.all()
    np.testing.assert_array_equal(doubted, more * share > 0.5)


def test_what_goes_wrong_is_counted_and_so_is_whether_it_was_flagged(compared):
    """Of a method that errs so much, and warns as it is told to."""
    hold = compared.methods.index("hold last")
    cautions = [("beware",), (), ("beware",), (), (), ()]
    warned = replace(
        compared,
        outcomes=tuple(
            (*row[:hold], replace(row[hold], cautions=one), *row[hold + 1 :])
            for row, one in zip(compared.outcomes, cautions, strict=True)
        ),
    )
    bars = Bars(warned, "hold last", None)
    relative = np.array([[skill.relative for skill in row[hold].skill] for row in compared.outcomes])
    worse, flagged = relative > 1, np.array([bool(one) for one in cautions])
    assert worse[:, -1].any() and not worse[:, 0].any()
    assert not bars.doubted.any() and np.isnan(bars.inside).all()
    over = reached(bars)
    np.testing.assert_allclose(over["windows worse than the constant mean"], worse.mean(axis=0))
    np.testing.assert_allclose(over["the worst window over the constant mean"], relative.max(axis=0))
    assert over["of them flagged beforehand"][-1] == worse[flagged, -1].sum() / worse[:, -1].sum()
    assert np.isnan(over["of them flagged beforehand"][0])
    assert over["others flagged alike"][0] == pytest.approx(2 / 6)


def test_they_are_told_by_horizon_and_by_flight(bars):
    (table,) = summary(bars)
    assert table.header == ["DEM, after steps", "asked", *map(str, STEPS)]
    assert "nan" not in str(table.rows)
    tables = [block for block in details(bars) if isinstance(block, Table)]
    assert all(len(row) == len(one.header) for one in tables for row in one.rows)
    assert sum({"a", "b"} <= {row[0] for row in one.rows} for one in tables) == 4
    document = bars.to_dict()
    assert (document["method"], document["steps"]) == ("DEM", list(STEPS))
    assert len(document) == 2 + len(table.rows)
