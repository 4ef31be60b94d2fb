"""The report on the paper's experiments: verdicts follow from their rules, either way, and the report is whole."""

import re
from types import SimpleNamespace

import numpy as np
from click import Command, Context
from command_line import document_of, run, strict_json
from numpy.random import default_rng
from pytest import fail, mark
from scipy.ndimage import gaussian_filter1d
from test_figures import figures, hold

import mavdem
from mavdem.cli.commands import main
from mavdem.cli.output import json_text
from mavdem.experiments.methods import maximum_likelihood
from mavdem.experiments.paper import CLAIMS, forecasts, noise, oracle, order
from mavdem.experiments.paper.forecasts import MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES
from mavdem.experiments.paper.report import ITEMS, PAGE, ItemReport, document, write
from mavdem.experiments.paper.runner import (
    PEERS,
    WITH,
    Check,
    ClaimStatus,
    ExperimentResult,
    Runner,
)
from mavdem.experiments.window import Window

HELD = Check("a rule", True, "this is so")
FAILED = Check("a rule", False, "that is not")


def test_what_fails_is_said_first():
    report = ItemReport(CLAIMS[0], ExperimentResult(checks=(HELD, FAILED)))
    assert report.status is ClaimStatus.PARTLY
    assert report.sentence == "Partly: that is not; but this is so."
    held = ItemReport(CLAIMS[0], ExperimentResult(checks=(HELD,)))
    assert held.status is ClaimStatus.REPRODUCED and held.sentence == "Reproduced: this is so."
    untried = ItemReport(CLAIMS[0], ExperimentResult(remarks=("Nothing is there.",)))
    assert untried.sentence == "Not tried: Nothing is there."
    assert ItemReport(CLAIMS[0], ExperimentResult(checks=(FAILED,))).status is ClaimStatus.NOT


def test_the_command_writes_the_page_and_the_numbers_that_it_prints(monkeypatch, tmp_path, capsys):
    items = {CLAIMS[0]: lambda _: ExperimentResult(checks=(HELD,)), CLAIMS[1]: lambda _: fail()}
    monkeypatch.setattr("mavdem.experiments.paper.report.ITEMS", items)
    assert run("reproduce", CLAIMS[0].name, "--out", tmp_path, "--json") == 0
    printed = strict_json(capsys.readouterr().out)
    assert strict_json((tmp_path / "numbers.json").read_text()) == printed
    assert "this is so" in (tmp_path / PAGE).read_text() and 0 <= printed["seconds"] < 60


def holds(checks):
    return [check.holds for check in checks]


def noises(shape, colour):
    """Five series of 1000 values, white where ``colour`` is 0, else of that kernel width in samples."""
    series = [getattr(default_rng(seed), shape)(size=1000) for seed in range(5)]
    return [
        noise.analyse_noise(gaussian_filter1d(one, colour) if colour else one, overlap=3)
        for one in series
    ]


def test_noise_is_judged_by_its_shape_and_its_colour():
    for shape, colour, expected in (
        ("normal", 6, [True, True]),
        ("normal", 0, [True, False]),
        ("laplace", 0, [False, False]),
    ):
        assert holds(noise.checks(noises(shape, colour), "w", "flights")) == expected


def test_generalized_coordinates_must_win_in_total_and_mostly():
    without, with_ = (
        np.array([own]).T for own in (MSPE_WITHOUT_COORDINATES, MSPE_WITH_COORDINATES)
    )
    assert forecasts.coordinates_check((with_, without), "the paper's own").holds
    assert not forecasts.coordinates_check((without, with_), "swapped").holds
    one_wins = np.array([[1.1, 1.1, 1.1, 1.1, 0.1]]).T
    assert not forecasts.coordinates_check(
        (one_wins, np.ones((5, 1))), "one flight makes the total"
    ).holds


def test_a_method_must_win_on_every_flight():
    errors = {WITH: np.array([1.0, 2.0]), **{name: np.array([3.0, 3.0]) for name in PEERS}}
    won = forecasts.least(errors, "from the data")
    lost = forecasts.least(errors | {PEERS[0]: np.array([3.0, 1.5])}, "from the data")
    assert (won.holds, lost.holds) == (True, False)
    assert "on 2 of 2; its error is 0.471 times" in won.finding and "on 1 of 2" in lost.finding


def test_the_authors_result_must_lie_among_ours():
    ours = np.linspace(1, 2, 101)
    cases = {
        "DEM p=2": ([1.9], [1.01], "their MSPE is 1.90, above 89.1 % of ours (median 1.50)"),
        "EM": ([1.4, 1.6], [1.6, 1.9], "1.00 to 2.00 (median 1.50), theirs 1.40 to 1.60"),
    }
    for name, (near, far, found) in cases.items():
        check = oracle.check(name, "the data", ours, np.array(near))
        assert check.holds and found in check.finding
        assert not oracle.check(name, "the data", ours, np.array(far)).holds


@mark.parametrize(
    "free_energy, expected",
    [([-1e9, -5e8, -1e6, -2e6], 3), ([-1.0, np.nan, -2.0], 1), ([-9, -6, -3, 0], 4)],
)
def test_free_energy_saturates_where_higher_orders_gain_nothing(free_energy, expected):
    assert order.saturates_at(np.array(free_energy, float)) == expected


def test_every_inputs_must_lead_to_the_order_of_the_system():
    found = order.checks({"unknown": [1, 2, 3, 4], "known": [1, 3, 3, 4]})
    assert holds(found) == [True, False, True, True] and order.ORDERS == (1, 2, 3, 4, 5, 6)
    assert found[0].finding == "F̄ of system 1 saturates at order 1"
    assert (
        found[1].finding
        == "F̄ of system 2 saturates at order 2 with unknown inputs and 3 with known inputs"
    )


ROLL = np.sin(0.2 * np.arange(130))[:, None]
MADE_UP = mavdem.Flight(5.0 + 0.01 * np.arange(130), ROLL, ROLL, dt=0.01)
WINDOW = Window("made up", 0, MADE_UP[:120], MADE_UP[120:])


def test_a_prediction_is_judged_by_what_it_shows():
    still = SimpleNamespace(
        one_step=lambda: np.vstack([WINDOW.train.outputs[:1], WINDOW.train.outputs[:-1]]),
        forecast=lambda inputs: np.full_like(WINDOW.test.outputs, 9.0),
        learning=SimpleNamespace(theta=np.append(np.arange(20.0), 20.0)[:, None]),
        free_energy=SimpleNamespace(total=np.array([0.0, -1.0])),
    )
    checks = forecasts.prediction_checks(WINDOW, still, [1.0, 9.0])
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
    monkeypatch.setattr(order, "ORDERS", (1, 2, 3))
    monkeypatch.setattr(order, "SYSTEMS", {1: ("φ̇",), 2: ("φ", "φ̇")})
    # a report needs no more of them
    monkeypatch.setattr(maximum_likelihood.iterate_em, "__defaults__", (5,))
    # Pictures of the demonstrations take ten seconds, and have tests of their own.
    runner = Runner(numbers=(2,), uses_recorded=False, draws_of_prior=2)
    chosen = [claim for claim in ITEMS if claim.name != "demonstrations"]
    reports = [ItemReport(claim, ITEMS[claim](runner)) for claim in chosen]
    write(tmp_path, reports, 1.0)
    page = (tmp_path / PAGE).read_text()
    with Context(Command("reproduce")):
        numbers = json_text(document(reports, 1.0))
    # It shows what is there and asks for nothing else.
    assert "<svg" in page and not re.findall(r'(?:src|srcset)="', page)
    told = {one["name"]: one for one in strict_json(numbers)["items"]}
    # What has not converged after so few iterations is by the processor.
    kept = {key: found for key, found in figures(told).items() if "order" not in key}
    hold("paper", kept, request)
    assert list(told) == [claim.name for claim in chosen]
    for one in told.values():
        assert one["verdict"] in set(ClaimStatus) and (one["checks"] or one["remarks"])
    # F̄ rises in every iteration by what the steps are.
    assert told["prediction"]["checks"][4]["holds"] and told["order"]["checks"][1]["holds"]
    assert reports[2].result.tables[1].rows[:2] == [
        [f"the paper, its flights, p = {p}", *2 * [mspe]]
        for p, mspe in ((1, "0.0640"), (2, "0.0133"))
    ]
    assert told["oracle"]["verdict"] == "not tried" and not told["oracle"]["checks"]
    assert all(
        told[name]["checks"]
        for name in ("noise", "prediction", "coordinates", "benchmark", "order")
    )


def test_what_cannot_be_done_is_one_document_and_no_work(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for words, named in (
        (["everything"], "everything"),
        (["noise", "--out", str(tmp_path / "file")], "--out"),
    ):
        assert named in document_of(capsys, "reproduce", *words, code=2)["error"]["reason"]
    # All claims are listed.
    names = [claim.name for claim in CLAIMS]
    assert main(["reproduce", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names
    told = document_of(capsys, "reproduce", "--list")
    assert [claim["name"] for claim in told["claims"]] == names
