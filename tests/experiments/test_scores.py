"""Scores: what counts at which horizon, and beside what; the paired test at the level it says; and windows."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from partial_records import partial_record
from pytest import approx, mark, raises
from scipy.stats import wilcoxon

from mavdem import Flight, baselines, evaluate
from mavdem.evaluate import HORIZONS, horizons
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.outcomes import evaluate_window
from mavdem.experiments.paired_test import SIGNIFICANCE, Paired, paired, typical_ratio
from mavdem.experiments.scores import KNOWN_INPUTS
from mavdem.experiments.window import Window, disjoint_windows, windows
from mavdem.facts.forecasts import TestResult

RNG = default_rng(0)
WALK = RNG.standard_normal((850, 2)).cumsum(axis=0) * [1, 10]
FLIGHT = Flight(0.01 * np.arange(850), RNG.standard_normal((850, 2)), WALK)
TRAIN = FLIGHT[:700]
TEST = FLIGHT[700:]


def scores_of(model, flight=FLIGHT):
    window = Window("", 0, flight[:700], flight[700:])
    return evaluate_window(Method("", model), window).scores[KNOWN_INPUTS]


def test_mspe_is_per_output_and_summed():
    error = evaluate.mspe([[0.0, 0.0], [2.0, 1.0]], np.zeros((2, 2)))
    assert_array_equal(error.per_output, [2.0, 0.5])
    assert error.total == 2.5


@mark.parametrize("shape", [(2,), (3, 2), (2, 1), (0, 2)])
def test_shapes_that_disagree_are_refused(shape):
    with raises(ValueError, match=r"must be \(H, m\) alike"):
        evaluate.mspe(np.zeros((2, 2)) if shape != (0, 2) else np.zeros(shape), np.zeros(shape))
    with raises(ValueError, match="predicted must be real numbers"):
        evaluate.mspe([[0.0]], [[1j]])


@mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e200])
def test_a_prediction_beyond_all_numbers_errs_infinitely(wild):
    error = evaluate.mspe(np.zeros((3, 2)), [[0.0, 1.0], [wild, 1.0], [0.0, 1.0]])
    assert error.per_output.tolist() == [np.inf, 1.0] and error.total == np.inf
    assert evaluate.relative_mspe(TRAIN, TEST, np.full_like(TEST.outputs, wild)) == np.inf


def test_the_constant_mean_has_one_at_every_horizon_and_the_truth_none():
    scores = scores_of(baselines.constant_mean)
    assert_allclose(scores.ratio, 1)
    assert evaluate.relative_mspe(TRAIN, TEST, TEST.outputs) == 0.0
    still = replace(TEST, outputs=np.tile(TRAIN.outputs.mean(axis=0), (150, 1)))
    assert evaluate.relative_mspe(TRAIN, still, still.outputs) == 1  # Both errors are 0.
    # Outputs count in units of their training variance.
    scaled = replace(FLIGHT, outputs=FLIGHT.outputs * [57.3, 0.01] + 5)
    assert_allclose(scores_of(baselines.hold).ratio, scores_of(baselines.hold, scaled).ratio)
    # One that is constant in training has none.
    train = replace(TRAIN, outputs=TRAIN.outputs * [1, 0] + [0, 0.1])
    with raises(ValueError, match="^train must vary"):
        evaluate.relative_mspe(train, TEST, TEST.outputs)


def test_horizons_are_those_of_the_test_part():
    assert horizons(150, 0.01) == HORIZONS
    # They last as long at 50 Hz, to the nearest sample; at 20 Hz the two shortest are one sample ahead.
    assert horizons(200, 0.02) == (1, 2, 5, 12, 25, 75, 200)
    assert horizons(30, 0.05) == (1, 2, 5, 10, 30)
    assert horizons(1, 0.01) == (1,)
    assert horizons(600, 1 / 400) == (4, 20, 40, 100, 200, 600)


INF = np.inf


def overlapping(count, hop=425, flight="a"):
    """Windows of 850 samples, each of which begins so many after the one before."""
    starts = range(0, hop * count, hop)
    return [
        partial_record(Window, flight=flight, start=start, stop=start + 850) for start in starts
    ]


def test_windows_that_overlap_are_not_tested_together():
    assert disjoint_windows(overlapping(4, hop=300)).tolist() == [0, 3]
    assert disjoint_windows([*overlapping(3), *overlapping(3, flight="b")]).tolist() == [0, 2, 3, 5]
    assert disjoint_windows(overlapping(5)[::-1]).tolist() == [0, 2, 4]
    assert disjoint_windows([]).tolist() == []


def test_the_test_is_wilcoxons_on_log_ratios():
    rng = default_rng(0)
    ours, theirs = rng.lognormal(size=(2, 15))
    found = paired(ours, theirs, overlapping(15))
    assert found.p_value == wilcoxon(np.log(ours / theirs)[::2]).pvalue
    assert found.ratio == approx(np.median(ours / theirs))
    assert (found.less, found.windows, found.tested) == (int((ours < theirs).sum()), 15, 8)
    assert found.tested_less == int((ours < theirs)[::2].sum())
    # Errors whose typical ratio is just above the one that would be significant are, just below it not.
    ratio = typical_ratio(ours, theirs)
    centred = ours / theirs / ratio.measured
    assert typical_ratio(centred, np.ones(15)).measured == approx(1)
    assert paired(1.001 * ratio.significant * centred, np.ones(15)).p_value < SIGNIFICANCE
    assert paired(0.999 * ratio.significant * centred, np.ones(15)).p_value >= SIGNIFICANCE
    # Half of the significant distance takes about four times as many windows.
    half_way = ratio.significant**0.5 * centred
    sufficient_windows = typical_ratio(half_way, np.ones(15)).sufficient_windows
    assert sufficient_windows in (60, 61)
    for count, is_significant in ((sufficient_windows // 2, False), (2 * sufficient_windows, True)):
        repeated = np.resize(half_way, count)
        assert (paired(repeated, np.ones(count)).p_value < SIGNIFICANCE) is is_significant
    assert typical_ratio(1 / half_way, np.ones(15)).sufficient_windows is None
    nearly_equal = 1.001 * np.exp(np.linspace(-1, 1, 15))
    assert typical_ratio(nearly_equal, np.ones(15)).sufficient_windows is None
    assert typical_ratio(ours[:5], theirs[:5]).significant == INF
    assert typical_ratio([1, INF], [1, 1]) is None


@mark.slow
def test_a_method_that_diverged_lost_that_window():
    found = paired(np.ones(7), [INF, INF, 2, 3, 4, 0.5, INF])
    assert (found.less, found.ratio) == (6, 0.25)
    assert found.p_value < 0.1
    assert paired([INF, INF, 1], [INF, INF, 1]) == Paired(1.0, 0, 3, 3, 0, 1.0)
    assert paired([INF, INF], [1, 1]).ratio == INF
    # Nothing to compare is no evidence.
    none = paired([], [], [])
    assert np.isnan(none.ratio) and (none.windows, none.tested, none.p_value) == (0, 0, 1.0)


@mark.parametrize("ours, theirs", [([1, 2], [1]), ([1, np.nan], [1, 1]), ([1, -1], [1, 1]), (1, 1)])
def test_what_are_no_errors_of_the_same_windows_is_refused(ours, theirs):
    with raises(ValueError, match="^ours"):
        paired(ours, theirs)


@mark.slow
def test_what_is_distinguished_takes_six_pairs_and_a_side():
    assert (
        paired([1.0] * 6, [2.0] * 6).result is TestResult.LOWER
        and paired([2.0] * 6, [1.0] * 6).result is TestResult.HIGHER
    )
    assert paired([1.0] * 5, [2.0] * 5).result is TestResult.NOT_DISTINGUISHABLE
    assert paired([1.0, 2.0] * 10, [2.0, 1.0] * 10).result is TestResult.NOT_DISTINGUISHABLE


def uniform(samples, rate=100):
    values = np.arange(samples, dtype=float)
    return Flight(values / rate, values, values)


def test_every_window_that_fits_is_cut():
    """By default a window has 700 samples of training and 150 of test, and begins 425 after the one before."""
    flight_windows = windows("a", uniform(1700))
    assert [(window.flight, window.start, window.stop) for window in flight_windows] == [
        ("a", 0, 850),
        ("a", 425, 1275),
        ("a", 850, 1700),
    ]
    assert_array_equal(flight_windows[1].train.outputs[:, 0], np.arange(425, 1125))
    assert_array_equal(flight_windows[1].test.outputs[:, 0], np.arange(1125, 1275))
    stops = [window.stop for window in windows("a", uniform(30), train=10, test=5, hop=5)]
    assert stops == [15, 20, 25, 30]
    assert windows("a", uniform(849)) == () and len(windows("a", uniform(850))) == 1
    for samples in ({"train": 0}, {"test": 0}, {"hop": 0}):
        with raises(ValueError, match="at least 1"):
            windows("a", uniform(900), **samples)


@mark.parametrize("rate, train, test", [(20, 140, 30), (120, 840, 180), (400, 2800, 600)])
def test_windows_last_as_long_at_every_rate(rate, train, test):
    (window, *_) = windows("a", uniform(6000, rate=rate))
    assert (len(window.train), len(window.test)) == (train, test)
