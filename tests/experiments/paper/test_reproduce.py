"""The report on the paper's experiments: each status follows from its checks, and the report holds all claims."""

import re

import numpy as np
from click import Command, Context
from command_line import document_of, run, strict_json
from golden_figures import figures, hold
from numpy.random import default_rng
from partial_records import partial_record
from pytest import fail, mark
from scipy.ndimage import gaussian_filter1d

import mavdem
from mavdem.cli.commands import main
from mavdem.cli.output import json_text
from mavdem.dem import Learned
from mavdem.dem.engine.ascent import FreeEnergy, Learning
from mavdem.experiments.methods import maximum_likelihood
from mavdem.experiments.paper import CLAIMS, authors_code, benchmark, model_order, prediction
from mavdem.experiments.paper.checks import Check, ClaimStatus, ExperimentResult
from mavdem.experiments.paper.generalized_coordinates import (
    PAPER_MSPE_P1,
    PAPER_MSPE_P2,
    ErrorsByOrder,
    lower_error_check,
)
from mavdem.experiments.paper.noise import noise_checks
from mavdem.experiments.paper.noise_tests import analyse_noise
from mavdem.experiments.paper.report import ITEMS, PAGE, ItemReport, document, write
from mavdem.experiments.paper.runner import DEM_P2, PEER_METHODS, Runner
from mavdem.experiments.window import Window, windows
from mavdem.report.figures import style
from sitl_scenarios.files import load

HELD = Check("a rule", True, "this is so")
FAILED = Check("a rule", False, "that is not")


def test_failing_checks_come_first_in_the_sentence():
    report = ItemReport(CLAIMS[0], ExperimentResult(checks=(HELD, FAILED)))
    assert report.status is ClaimStatus.PARTLY
    assert report.sentence == "Partly: that is not; but this is so."
    held = ItemReport(CLAIMS[0], ExperimentResult(checks=(HELD,)))
    assert held.status is ClaimStatus.REPRODUCED and held.sentence == "Reproduced: this is so."
    untried = ItemReport(CLAIMS[0], ExperimentResult(remarks=("Nothing is there.",)))
    assert untried.sentence == "Not tried: Nothing is there."
    assert (
        ItemReport(CLAIMS[0], ExperimentResult(checks=(FAILED,))).status
        is ClaimStatus.NOT_REPRODUCED
    )


@mark.slow
def test_the_command_writes_the_page_and_the_numbers_that_it_prints(monkeypatch, tmp_path, capsys):
    """A claim of the paper that holds is reproduced; page, numbers and text agree."""
    items = {CLAIMS[0]: lambda _: ExperimentResult(checks=(HELD,)), CLAIMS[1]: lambda _: fail()}
    monkeypatch.setattr("mavdem.experiments.paper.report.ITEMS", items)
    monkeypatch.setattr("mavdem.cli.reproduce.available_workers", lambda: 1)
    assert run("reproduce", CLAIMS[0].name, "--out", tmp_path, "--json") == 0
    printed = strict_json(capsys.readouterr().out)
    assert strict_json((tmp_path / "numbers.json").read_text()) == printed
    assert "this is so" in (tmp_path / PAGE).read_text() and 0 <= printed["seconds"] < 60
    assert run("reproduce", CLAIMS[0].name, "--out", tmp_path, "--markdown") == 0
    assert capsys.readouterr().out == f"**{CLAIMS[0].title}:** Reproduced: this is so.\n"


def holds(checks):
    return [check.holds for check in checks]


def noise_analyses(distribution, kernel_samples):
    """Five series of 1000 values, white where ``kernel_samples`` is 0, else of that kernel width in samples."""
    analyses = []
    for seed in range(5):
        series = getattr(default_rng(seed), distribution)(size=1000)
        if kernel_samples:
            series = gaussian_filter1d(series, kernel_samples)
        analyses.append(analyse_noise(series, overlap=3))
    return analyses


@mark.parametrize(
    "distribution, kernel_samples, expected",
    [("normal", 6, [True, True]), ("normal", 0, [True, False]), ("laplace", 0, [False, False])],
)
def test_noise_is_judged_by_its_distribution_and_its_colour(distribution, kernel_samples, expected):
    analyses = noise_analyses(distribution, kernel_samples)
    assert holds(noise_checks(analyses, "w", "flights")) == expected


def test_generalized_coordinates_must_have_the_lower_error_in_total_and_mostly():
    paper_p2 = np.array([PAPER_MSPE_P2]).T
    paper_p1 = np.array([PAPER_MSPE_P1]).T
    assert lower_error_check(ErrorsByOrder(p2=paper_p2, p1=paper_p1), "the paper's own").holds
    assert not lower_error_check(ErrorsByOrder(p2=paper_p1, p1=paper_p2), "swapped").holds
    only_total_is_lower = np.array([[1.1, 1.1, 1.1, 1.1, 0.1]]).T
    errors = ErrorsByOrder(p2=only_total_is_lower, p1=np.ones((5, 1)))
    assert not lower_error_check(errors, "one flight makes the total").holds


def test_dem_must_have_the_lowest_error_on_every_flight():
    errors = {DEM_P2: np.array([1.0, 2.0])}
    for name in PEER_METHODS:
        errors[name] = np.array([3.0, 3.0])
    lowest = benchmark.lowest_error_check(errors, "from the data")
    assert lowest.holds and "on 2 of 2; its error is 0.471 times" in lowest.finding
    errors[PEER_METHODS[0]] = np.array([3.0, 1.5])
    not_lowest = benchmark.lowest_error_check(errors, "from the data")
    assert not not_lowest.holds and "on 1 of 2" in not_lowest.finding


@mark.parametrize(
    "method, agreeing, disagreeing, finding",
    [
        ("DEM p=2", [1.9], [1.01], "their MSPE is 1.90, above 89.1 % of ours (median 1.50)"),
        ("EM", [1.4, 1.6], [1.6, 1.9], "1.00 to 2.00 (median 1.50), theirs 1.40 to 1.60"),
    ],
)
def test_the_authors_errors_must_lie_among_ours(method, agreeing, disagreeing, finding):
    ours = np.linspace(1, 2, 101)
    check = authors_code.agreement_check(method, "the data", ours, np.array(agreeing))
    assert check.holds and finding in check.finding
    assert not authors_code.agreement_check(method, "the data", ours, np.array(disagreeing)).holds


@mark.parametrize(
    "free_energy, expected",
    [([-1e9, -5e8, -1e6, -2e6], 3), ([-1.0, np.nan, -2.0], 1), ([-9, -6, -3, 0], 4)],
)
def test_free_energy_saturates_where_higher_orders_gain_nothing(free_energy, expected):
    assert model_order.saturation_order(np.array(free_energy, float)) == expected


def test_free_energy_must_choose_the_order_of_the_system_with_all_inputs():
    checks = model_order.order_checks({"unknown": [1, 2, 3, 4], "known": [1, 3, 3, 4]})
    assert holds(checks) == [True, False, True, True]
    assert model_order.ORDERS == (1, 2, 3, 4, 5, 6)
    assert checks[0].finding == "for system 1 F̄ chooses order 1"
    assert (
        checks[1].finding
        == "for system 2 F̄ chooses order 2 with unknown inputs and 3 with known inputs"
    )


ROLL = np.sin(0.2 * np.arange(130))[:, None]
FLIGHT = mavdem.Flight(5.0 + 0.01 * np.arange(130), ROLL, ROLL, dt=0.01)
WINDOW = Window("made up", 0, FLIGHT[:120], FLIGHT[120:])


def test_a_model_that_holds_the_last_sample_fails_all_checks_of_prediction():
    """A trivial model must not pass any check of the paper's predictions."""
    hold_model = partial_record(
        Learned,
        one_step=lambda self: np.vstack([WINDOW.train.outputs[:1], WINDOW.train.outputs[:-1]]),
        forecast=lambda self, inputs: np.full_like(WINDOW.test.outputs, 9.0),
        learning=partial_record(Learning, theta=np.append(np.arange(20.0), 20.0)[:, None]),
        free_energy=partial_record(FreeEnergy, total=np.array([0.0, -1.0])),
    )
    checks = prediction.prediction_checks(WINDOW, hold_model, [1.0, 9.0])
    assert not any(holds(checks))
    assert [check.finding for check in checks] == [
        "one-step predictions explain 96.1 % of the variance of output 1",
        "the one-step MSPE is 1.00 times that of holding the last sample",
        "150 steps ahead the error is 276 times that of the constant mean",
        "the parameters have converged at iteration 19",
        "F̄ does not always increase over 1 iterations",
        "forecasts from 2 random priors have an MSPE from 1.80 to 8.20 (10 % and 90 % quantiles)",
    ]


@mark.slow
def test_all_items_make_one_report(tmp_path, monkeypatch, request):
    """All claims of the paper are checked with few windows and iterations, and written as one page."""
    monkeypatch.setattr(model_order, "ORDERS", (1, 2))
    monkeypatch.setattr(model_order, "SYSTEMS", {1: ("φ̇",), 2: ("φ", "φ̇")})
    # A report needs no more iterations of EM and PEM.
    monkeypatch.setattr(maximum_likelihood, "MAX_ITERATIONS", 20)
    monkeypatch.setattr(maximum_likelihood.iterate_em, "__defaults__", (5,))
    # Pictures of the demonstrations take ten seconds. They and the observers have tests of their own.
    tested_elsewhere = {"demonstrations", "states", "inputs", "covariance", "smoothness"}

    def first_windows(*arguments):
        """The first two windows of a flight are enough for every method."""
        return windows(*arguments)[:2]

    monkeypatch.setattr("mavdem.experiments.paper.runner.windows", first_windows)
    # Of its flights the choice of the order takes the first seconds of hover.
    short_flight = load("paper_2").model_copy(update={"duration": 20.0})
    monkeypatch.setattr(model_order, "load", lambda name: short_flight)
    # To write a picture takes three times as long as to draw it: all are drawn, and one is written.
    figure_as_svg = style.figure_as_svg
    written = []

    def svg_of_first(figure, name):
        if not written:
            written.append(figure_as_svg(figure, name))
        return written[0]

    monkeypatch.setattr(style, "figure_as_svg", svg_of_first)
    runner = Runner(experiment_numbers=(2,), uses_authors_results=False, prior_count=2)
    chosen = [claim for claim in ITEMS if claim.name not in tested_elsewhere]
    reports = [ItemReport(claim, ITEMS[claim](runner)) for claim in chosen]
    write(tmp_path, reports, 1.0)
    page = (tmp_path / PAGE).read_text()
    with Context(Command("reproduce")):
        numbers = json_text(document(reports, 1.0))
    # The page is one file and loads no others.
    assert "<svg" in page and not re.findall(r'(?:src|srcset)="', page)
    items = {item["name"]: item for item in strict_json(numbers)["items"]}
    # The fits of the orders have not converged, and differ between processors.
    golden_figures = {key: value for key, value in figures(items).items() if "order" not in key}
    hold("paper", golden_figures, request)
    assert list(items) == [claim.name for claim in chosen]
    for item in items.values():
        assert item["verdict"] in set(ClaimStatus)
        assert len(item["checks"]) + len(item["remarks"]) > 0
    # No iteration lowers F̄, by the construction of its steps.
    assert items["prediction"]["checks"][4]["holds"] and items["order"]["checks"][1]["holds"]
    assert reports[2].result.tables[1].rows[:2] == [
        [f"the paper, its flights, p = {p}", *2 * [mspe]]
        for p, mspe in ((1, "0.0640"), (2, "0.0133"))
    ]
    assert items["oracle"]["verdict"] == "not tried" and not items["oracle"]["checks"]
    assert all(
        items[name]["checks"]
        for name in ("noise", "prediction", "coordinates", "benchmark", "order")
    )


def test_wrong_arguments_give_an_error_document_and_the_claims_are_listed(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for arguments, expected in (
        (["everything"], "everything"),
        (["noise", "--out", str(tmp_path / "file")], "--out"),
    ):
        error = document_of(capsys, "reproduce", *arguments, code=2)["error"]
        assert expected in error["reason"]
    names = [claim.name for claim in CLAIMS]
    assert main(["reproduce", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names
    listing = document_of(capsys, "reproduce", "--list")
    assert [claim["name"] for claim in listing["claims"]] == names
