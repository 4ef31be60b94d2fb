"""Comparison: what goes wrong stays in its row, errors are those of the windows, the table names where DEM loses."""

from dataclasses import replace

import numpy as np
from pytest import approx, fixture, mark, raises
from simulated import simulated

from mavdem import Flight, baselines, learn
from mavdem.evaluate import HORIZONS, Paired
from mavdem.experiments.compared_methods import METHODS, Method
from mavdem.experiments.comparison import Comparison, compare
from mavdem.experiments.horizon_differences import horizon_differences, shown_differences
from mavdem.experiments.outcomes import evaluate_window
from mavdem.experiments.paired_test import are_significant_together
from mavdem.experiments.scores import FROM_STATE_ZERO, KNOWN_INPUTS, UNKNOWN_INPUTS
from mavdem.experiments.window import windows
from mavdem.experiments.worse_windows import worse_windows
from mavdem.facts import Fact
from mavdem.facts.forecasts import ForecastFact
from mavdem.report.blocks import Table, plain_text
from mavdem.report.charts.forecast_errors import forecast_error_chart
from mavdem.report.comparison import comparison_report, plan_report
from mavdem.report.pages.methods_page import methods_page

FLIGHTS = {name: simulated(seed, samples=1700, wind=2.0) for seed, name in enumerate("ab")}
WINDOWS = [window for name, flight in FLIGHTS.items() for window in windows(name, flight)]
MEAN = Method("constant mean", baselines.constant_mean, predicts=True)
HOLD = Method("hold", baselines.hold, predicts=True)
LAST = Method("hold last", baselines.hold, predicts=True)
SUBSPACE = Method("subspace", baselines.subspace)


def refuses(train):
    raise ValueError("train is not to my liking")


def breaks(train):
    raise ZeroDivisionError("division by zero")


def explodes(train):
    held = baselines.hold(train)
    return replace(held, model=replace(held.model, A=1e4 * held.model.A))


def is_off(train):
    mean = baselines.constant_mean(train)
    return replace(mean, model=replace(mean.model, output_trim=mean.model.output_trim + 100.0))


REFUSES, BREAKS, EXPLODES, IS_OFF = (
    Method(made.__name__, made) for made in (refuses, breaks, explodes, is_off)
)


@fixture(scope="module")
def compared():
    return compare(WINDOWS, [HOLD, MEAN, SUBSPACE, REFUSES, EXPLODES])


def row_of(rows, method):
    return next(row for row in rows if row["method"] == method)


def table_of(comparison, title):
    """The table of a report whose header begins with a title."""
    blocks = comparison_report(comparison)
    tables = (block for block in blocks if isinstance(block, Table))
    return next(table for table in tables if table.header[0].startswith(title))


SUMMARY = "inputs known: RMSE"
DETAILS = "inputs known: error ratio"


def error_ratio(outcome, kind=KNOWN_INPUTS):
    """The error ratio of the whole test part."""
    return outcome.scores[kind].ratio[-1]


@mark.parametrize(
    "method, error, text",
    [
        (REFUSES, "", "train is not to my liking"),
        (BREAKS, "ZeroDivisionError", "division by zero"),
        (
            SUBSPACE,
            "",
            "subspace(2) needs the inputs of the time it forecasts: use forecast(inputs), or mavdem.baselines.var for "
            "predictions without them",
        ),
    ],
)
def test_a_method_without_an_answer_says_why_and_errs_infinitely(method, error, text):
    """A method raises an error while it learns or forecasts.

    Its outcome has the error as a fact, and infinite errors.
    """
    outcome = evaluate_window(method._replace(predicts=True), WINDOWS[0])
    assert outcome.failure == Fact(ForecastFact.FAILED, error=error, text=text)
    assert (outcome.stable, outcome.forecasts) == (None, {})
    assert all(np.isinf(scores.ratio).all() for scores in outcome.scores.values())
    assert outcome.scores[UNKNOWN_INPUTS].steps == HORIZONS


def test_a_window_without_a_unit_of_error_fails_for_all_and_our_own_fault_is_raised():
    with raises(TypeError):
        evaluate_window(Method("hold", lambda: None), WINDOWS[0])
    flight = FLIGHTS["a"]
    still = replace(flight, outputs=flight.outputs * [1, 0])
    (window, *_) = windows("still", still)
    for method in (HOLD, MEAN, METHODS[0]):
        assert "vary" in str(evaluate_window(method, window).failure)


@mark.slow
def test_a_first_method_that_fails_everywhere_is_said_to_have_failed():
    headline, *_ = comparison_report(compare(WINDOWS[:1], [REFUSES, MEAN]))
    assert headline.lead == "Inputs known: refuses made no forecast in any window."


@mark.slow
def test_a_summary_is_the_median_of_its_windows(compared):
    """The summary of three windows of a flight, by a good, a trivial, a failing and a diverging method."""
    rows = compared.summaries("a")
    hold, mean, refused, exploded = (
        row_of(rows, name) for name in ("hold", "constant mean", "refuses", "explodes")
    )
    column = [row[0] for row in compared.outcomes if row[0].flight == "a"]
    ratios = [error_ratio(one) for one in column]
    assert hold["relative"] == np.median(ratios) == hold["horizons"][-1]["relative"]
    assert (hold["worst"], hold["worse_than_constant"]) == (max(ratios), sum(np.array(ratios) > 1))
    assert hold["mspe"] == np.mean([one.mspe() for one in column], axis=0).tolist()
    assert mean["relative"] == 1 and mean["worse_than_constant"] == 0
    assert (refused["failed"], refused["failure"].code) == (3, ForecastFact.FAILED)
    # The first wins all three windows, of which two do not overlap.
    assert refused["horizons"][-1]["reference"] == Paired(0.0, 3, 3, 2, 2, 0.5)
    assert (exploded["failed"], exploded["diverged"], exploded["unstable"]) == (0, 3, 3)


@mark.slow
def test_horizons_of_several_flights_are_matched_in_seconds():
    """A flight at 50 Hz has no horizons of 0.01 s and 0.05 s, and its 12th sample is after 0.24 s."""
    fast = FLIGHTS["a"]
    slow = Flight(2 * fast.time, fast.inputs, fast.outputs)
    both = compare(
        [*windows("fast", fast, hop=850), *windows("slow", slow, 700, 75, 850)],
        [MEAN, Method("hold last", baselines.hold)],
    )
    row = row_of(both.over_flights(), "hold last")
    # The fourth horizon of both flights is that of 0.25 s.
    ratios = [
        row_of(both.summaries(flight), "hold last")["horizons"][3]["relative"]
        for flight in both.flights
    ]
    assert row["horizon_seconds"] == approx([0.1, 0.245, 0.5, 1.5])
    assert row["horizons"][1] == approx(np.sqrt(np.prod(ratios)))
    rmse, errors = table_of(both, SUMMARY), table_of(both, DETAILS)
    by_flight = table_of(both, "error ratio over")
    assert rmse.header[1:4] == ["output 1 0.1", "output 1 0.5", "output 1 1.5"]
    assert errors.header[1:5] == ["0.1", "0.25", "0.5", "1.5"]
    assert by_flight.header == ["error ratio over 1.5 s", "constant mean", "hold last"]
    squared_errors = [
        row_of(both.summaries(flight), "hold last")["horizons"][-1]["mspe"][0]
        for flight in both.flights
    ]
    (row,) = (row for row in rmse.rows if row[0] == "hold last")
    assert float(row[3]) == approx(np.mean(np.sqrt(squared_errors)), rel=0.06)


def test_before_a_long_run_stand_its_time_its_independent_windows_and_how_to_shorten_it():
    parts = windows("a", FLIGHTS["a"])
    plan, advice = plan_report(parts, METHODS, workers=2)
    assert "15 methods on 3 windows, 2 of them independent" in plan.text
    assert "takes 6" in plan.text and "--train 133" in advice.text
    quick, *_ = plan_report(parts, METHODS[:1], workers=2)
    assert "about" not in quick.text
    # The time of a long run stands there whatever methods are named.
    slow, *_ = plan_report(6 * parts, [method for method in METHODS if "PEM" in method.name], 1)
    assert "about 60 s on 1 free core, most of it PEM(4)." in slow.text
    plan, *_ = plan_report(6 * parts, METHODS, workers=1)
    assert "about 2 min on 1 free core" in plan.text
    assert '`--methods "joint VAR (Bayesian),DEM plant,constant mean,hold last"`' in plan.text


@mark.slow
def test_over_flights_each_counts_once(compared):
    rows = compared.over_flights()
    ours = row_of(rows, "subspace")
    refused = row_of(rows, "refuses")
    medians = [row_of(compared.summaries(flight), "subspace")["relative"] for flight in ("a", "b")]
    assert ours["relative"] == approx(np.sqrt(np.prod(medians)))
    assert (ours["flights"], ours["windows"], ours["reference"].windows) == (2, 6, 2)
    assert refused["relative"] == np.inf and refused["failed"] == 6


@mark.slow
def test_of_six_flights_each_is_a_pair():
    """With at least six flights, the test compares the methods flight by flight."""
    parts = [
        window
        for name, start in zip("abcdef", range(0, 600, 100), strict=True)
        for window in windows(name, FLIGHTS["a"][start : start + 400], 200, 50)
    ]
    outcome = compare(parts, [HOLD, IS_OFF])
    assert outcome.tests()["is_off"] == outcome.over_flights()[1]["reference"]
    assert outcome.tests()["is_off"].tested == 6


@mark.slow
def test_predictions_are_compared_of_the_methods_that_make_them(compared):
    assert compared.methods_of(UNKNOWN_INPUTS) == ("hold", "constant mean")
    assert compared.to_dict()["predictions"]["methods"] == ("hold", "constant mean")
    assert compare(WINDOWS[:1], [SUBSPACE]).to_dict()["predictions"] is None
    # A method that is not among them is said to be missing, also the first one, and the last value has its RMSE.
    text = plain_text(comparison_report(compare(WINDOWS[:2], [SUBSPACE, MEAN, LAST])))
    assert "subspace needs the inputs." in text
    assert "\nconstant mean *" in text and "\nsubspace *" in text
    # Where only a constant makes them, there is nothing to draw.
    with_constant = compare(WINDOWS[:1], [SUBSPACE, MEAN])
    assert "<h2>Forecasts without the inputs" not in methods_page(with_constant)
    short_text = plain_text(comparison_report(with_constant, verbose=False))
    assert "1 independent window; significant" in short_text.replace("\n", " ")


@fixture(scope="module")
def predicted():
    return compare(WINDOWS, [Method("joint VAR (Bayesian)", learn, predicts=True), HOLD, MEAN])


def test_the_horizon_up_to_which_forecasts_are_useful_is_stated():
    """Errors are set: the constant is beaten in all windows up to 0.5 s, in one of three at 1.5 s."""
    outcomes = []
    for outcome in compare(WINDOWS[:3], [SUBSPACE, MEAN]).outcomes:
        errors = np.full_like(outcome[0].scores[KNOWN_INPUTS].squared_error, 1e-6)
        errors[-1] = 1e-6 if not outcomes else 1e6
        scores = outcome[0].scores[KNOWN_INPUTS]._replace(squared_error=errors)
        subspace = replace(outcome[0], scores={**outcome[0].scores, KNOWN_INPUTS: scores})
        outcomes.append((subspace, outcome[1]))
    known = Comparison(tuple(WINDOWS[:3]), ("subspace", "constant mean"), tuple(outcomes))
    text = plain_text(comparison_report(known))
    assert (
        "Useful, inputs known: subspace to at least 0.5 s (RMSE of output 1 0.0010); at 1.5 s 2 of "
        "3 windows are worse than a constant."
    ) in text
    assert (
        text.count("an error ratio of at most 0.5, and below 1 in at least 90 % of the windows")
        == 1
    )
    details = table_of(known, DETAILS)
    (row,) = (row for row in table_of(known, SUMMARY).rows if row[0] == "subspace *")
    assert row[1:4] == ["0.001", "0.001", "820"]
    # Without --verbose there is one table, whose figures one sentence defines.
    short = list(comparison_report(known, verbose=False))
    assert [block.header[0] for block in short if isinstance(block, Table)] == ["RMSE to (s)"]
    assert [block.lead for block in short[2:] if not isinstance(block, Table)] == [
        "Worse than a constant, inputs known:",
        "Figures:",
        "More:",
        "Next:",
    ]
    # The curve over the horizon has the figures of the table, and the constant as a level.
    chart = forecast_error_chart(known, KNOWN_INPUTS)
    (line,) = chart.lines
    (ratios,) = (row["horizons"] for row in known.over_flights() if row["method"] == "subspace")
    assert (line.name, line.x[-1], chart.levels[0]) == ("subspace", approx(1.5), 1.0)
    assert line.y.tolist() == ratios
    # Where the errors are set to be large, the constant's error shows how much the vehicle moves.
    worse = worse_windows(known, "subspace", KNOWN_INPUTS)
    constant_errors = [
        np.mean(outcome.scores[KNOWN_INPUTS].baseline / outcome.scores[KNOWN_INPUTS].variance)
        for outcome, _ in outcomes
    ]
    assert (worse.windows, worse.unstable) == (2, 0)
    assert worse.constant_error == approx(np.median(constant_errors[1:]))
    assert worse.constant_error_elsewhere == approx(constant_errors[0])
    assert "subspace in 2 windows, where the vehicle moves little: the constant's own" in text
    assert details.header[7] == ">1" and details.rows[-1][7] == "2"


def relabelled(comparison, names):
    """The comparison with other names of its methods."""
    return Comparison(
        comparison.windows,
        names,
        tuple(
            tuple(replace(outcome, method=name) for outcome, name in zip(row, names, strict=True))
            for row in comparison.outcomes
        ),
    )


@mark.slow
def test_the_report_begins_with_the_losses_of_the_model_of_dem_and_of_the_default(predicted):
    """Where DEM's model is compared its losses come first, then those of the first method, by the tests of each."""
    names = ("joint VAR (Bayesian)", "hold", "DEM plant")
    known, known_ranking, unknown, *_ = comparison_report(relabelled(predicted, names))
    assert known.lead == (
        "Inputs known: whether DEM plant, DEM's model alone, or joint VAR (Bayesian), by which mavdem "
        "forecasts, has the smaller errors cannot be shown: that takes 6 independent windows, and there "
        "are 4."
    )
    assert known_ranking.text == (
        "Inputs known: over 1.5 s joint VAR (Bayesian) has the smallest error of 3 methods, 0.25 of a "
        "constant's; DEM plant has 1."
    )
    assert unknown.lead.startswith("Inputs unknown: whether DEM plant, ")
    # Six flights that are alike make each difference significant.
    copies = 6 * predicted.of_flight("a").outcomes[:1]
    parts = [replace(predicted.windows[0], flight=name) for name in "abcdef"]
    compared = relabelled(Comparison(tuple(parts), predicted.methods, tuple(copies)), names)
    headline, ranking, *_ = comparison_report(compared)
    assert headline.lead == (
        "Inputs known: DEM plant, DEM's model alone, loses to joint VAR (Bayesian), by which mavdem "
        "forecasts, up to 1.5 s ahead, with 1.2 to >1000 times its squared error."
    )
    assert ranking.text == (
        "Inputs known: over 1.5 s joint VAR (Bayesian) has the smallest error of 3 methods, 0.83 of a "
        "constant's; DEM plant has 1 and loses to joint VAR "
        "(Bayesian) (0.83, p = 0.031)."
    )
    # What the table shows as equal is not called smaller.
    default, hold, mean = copies[0]
    scores = {
        kind: one._replace(squared_error=0.9999 * one.squared_error)
        for kind, one in default.scores.items()
    }
    equal = ((default, replace(hold, scores=scores), mean),)
    headline, *_ = comparison_report(Comparison(tuple(parts[:1]), predicted.methods, equal))
    assert "joint VAR (Bayesian) has the smallest error of 3 methods, 0.83 of" in headline.lead
    rows = table_of(compared, SUMMARY).rows
    ratios = [float(row[-2]) for row in rows]
    assert ratios == sorted(ratios)
    assert [row[-1] for row in rows].count("0.031") == 2


def test_horizons_are_tested_from_the_shortest_on_until_one_shows_no_difference(predicted):
    """Errors are set: the second method's are twice as large, but in one horizon equally often half as large."""
    ratios = np.full((6, len(HORIZONS)), 2.0)
    ratios[::2, 2] = 0.5
    outcomes = []
    default, hold, mean = predicted.outcomes[0]
    for row in ratios:
        scores = default.scores[KNOWN_INPUTS]
        larger = scores._replace(squared_error=scores.squared_error * row[:, None])
        outcomes.append(
            (default, replace(hold, scores={**hold.scores, KNOWN_INPUTS: larger}), mean)
        )
    flights = [replace(predicted.windows[0], flight=name) for name in "abcdef"]
    comparison = Comparison(tuple(flights), predicted.methods, tuple(outcomes))
    differences = horizon_differences(comparison, "hold", comparison.methods[0], KNOWN_INPUTS)
    assert [difference.is_shown for difference in differences] == [True, True, *[False] * 4]
    assert [difference.test.p_value < 0.05 for difference in differences] == [
        *[True] * 2,
        False,
        *[True] * 3,
    ]
    assert [difference.seconds for difference in shown_differences(differences)] == approx(
        [0.01, 0.05]
    )
    # Windows that overlap are no pairs of their own: four of one flight are too few.
    few = horizon_differences(predicted, "hold", predicted.methods[0], KNOWN_INPUTS)
    assert {difference.test.tested for difference in few} == {4}
    assert not shown_differences(few)


def test_several_tests_are_significant_together_by_the_correction_of_holm():
    """Of three tests 0.02 must be below 0.05 / 2, and 0.03 below 0.05; the largest is compared last."""
    assert are_significant_together([0.03, 0.001, 0.02]) == [True, True, True]
    assert are_significant_together([0.03, 0.001, 0.026]) == [False, True, False]
    assert are_significant_together([]) == []


@mark.slow
def test_most_samples_are_inside_the_band_of_90_percent(predicted):
    inside = [row[0].scores[KNOWN_INPUTS].inside[-1] for row in predicted.outcomes]
    assert 0.7 < np.mean(inside) < 1


@mark.slow
def test_a_band_that_failed_is_cautioned_against(predicted):
    """A 90 % band that contains less than 75 % of the samples gives a caution."""

    def cautions(comparison):
        return [
            block.text
            for block in comparison_report(comparison)
            if getattr(block, "lead", "") == "Caution:"
        ]

    def held(share, unknown):
        def changed(one):
            held = {KNOWN_INPUTS: share, UNKNOWN_INPUTS: unknown, FROM_STATE_ZERO: np.nan}
            scores = {
                kind: outcome._replace(inside=outcome.inside * 0 + held[kind])
                for kind, outcome in one.scores.items()
            }
            return replace(one, scores=scores)

        rows = tuple(tuple(map(changed, row)) for row in predicted.outcomes)
        return Comparison(predicted.windows, predicted.methods, rows)

    assert cautions(held(0.75, 0.9)) == []
    assert ["holds 50 %" in one for one in cautions(held(0.9, 0.5))] == [True]
    assert "holds 74 %" in cautions(held(0.74, 0.9).of_flight("a"))[0]


def test_methods_of_the_same_kind_have_the_order_in_their_name():
    """Their functions take it as ``order``; it stands in brackets in the name."""
    orders = {
        method.name: method.learn.keywords["order"]
        for method in METHODS
        if "order" in getattr(method.learn, "keywords", {})
    }
    assert orders == {name: int(name.partition("(")[2].rstrip(")")) for name in orders}
    assert {"joint VAR(4)", "joint VAR(10)", "PEM(4)", "EM(2)"} <= orders.keys()
