"""``mavdem diff``: two fleets, two reports, or two logs in words or as one document, and refusals with their reason."""

import re
from pathlib import Path

from command_line import document_of, refused, run, unwrapped
from fleet_rows import WEAK, flight_row
from hover import Hover
from pytest import fixture, mark, skip
from standin_logs import fleet_of

from mavdem.dataset.signals import Signals
from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.fleet.row import FlightRow
from mavdem.ingest.telemetry import Telemetry, log_of_vehicles
from mavdem.report.charts.comparison_charts import flight_series
from mavdem.report.difference.headline import headline_of_comparison
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.reviewed import reviewed_difference
from mavdem.report.pages.difference_page import comparison_page

DOCUMENTATION = Path(__file__).parents[2] / "docs/diff.md"


def rows_of_flights(vehicle, numbers, **changed):
    """Returns the rows of some flights of a vehicle, two axes each; ``changed`` has the columns that differ."""
    return [
        flight_row(vehicle, number, axis, **changed)
        for number in numbers
        for axis in ("roll", "pitch")
    ]


pytestmark = mark.usefixtures("here")


@fixture
def fleets(tmp_path):
    fleet_of(
        tmp_path / "old", [*rows_of_flights("alpha", range(4)), *rows_of_flights("beta", range(2))]
    )
    fleet_of(
        tmp_path / "new",
        [*rows_of_flights("alpha", range(4, 8), **WEAK), *rows_of_flights("gamma", range(2))],
    )
    return str(tmp_path / "old"), str(tmp_path / "new")


@mark.slow
def test_the_vehicle_that_both_fleets_have_is_compared(fleets, capsys):
    """Motor 3 of vehicle alpha is weak in the newer fleet."""
    assert run("diff", *fleets) == 0
    output = capsys.readouterr().out
    lines = output.splitlines()
    start_of_a = next(number for number, line in enumerate(lines) if line.startswith("A: "))
    headline = " ".join(lines[:start_of_a])
    assert headline.startswith("Changed: motor 3's control effectiveness")
    assert "and motor 3's relative trim +12" in headline
    side_a, side_b = lines[start_of_a : start_of_a + 2]
    page_text = Path("old_and_new/diff.html").read_text(encoding="utf-8")
    page_text = page_text.replace("&#39;", "'").replace("\N{NO-BREAK SPACE}", " ")
    assert f'<p class="headline"><strong>{headline}' in page_text
    assert side_a == (
        "A: old, alpha, 4 logs (figures are their means), flown 2026-01-05 to 2026-01-08."
    )
    assert side_b.endswith("2026-01-09 to 2026-01-12.")
    *_, next_step, page = output.splitlines()
    assert next_step == "Next: Inspect motor 3 and its propeller before the next flight."
    assert page == "Page: old_and_new/diff.html"
    assert "Motor 3&#39;s " in Path("old_and_new/diff.html").read_text(encoding="utf-8")
    assert run("diff", *fleets, "--verbose") == 0
    assert "4 logs of A and 4 logs of B" in unwrapped(capsys.readouterr().out)
    changes = document_of(capsys, "diff", *fleets, "--vehicle", "alpha")["changes"]
    changed = [change["quantity"] for change in changes if change["outcome"] == "changed"]
    assert [(change["kind"], change["motor"]) for change in changed] == [
        ("share", 3),
        ("effect", 3),
    ]


@mark.slow
def test_two_weeks_of_one_fleet_are_compared(tmp_path, capsys):
    """Flights of the first days of a fleet are compared with later ones, in which motor 3 is weak."""
    fleet_of(
        tmp_path / "fleet",
        [*rows_of_flights("alpha", range(4)), *rows_of_flights("alpha", range(7, 10), **WEAK)],
    )
    arguments = (
        f"{tmp_path}/fleet {tmp_path}/fleet --vehicle alpha --days-a 2026-01-05..2026-01-11".split()
    )
    document = document_of(capsys, "diff", *arguments, "--days-b", "2026-01-12..2026-01-13")
    assert document["flights"] == [4, 2]
    assert "changed" in {change["outcome"] for change in document["changes"]}
    error_text = refused(capsys, 1, "diff", *arguments, "--days-b", "2027-01-01")
    assert "B has no flight with figures" in error_text
    for wrong in ("monday", "2026-01-12..2026-01-11"):
        refused(capsys, 2, "diff", *arguments, "--days-b", wrong)


@mark.slow
def test_a_page_that_something_is_in_the_way_of_is_refused(fleets, capsys):
    Path("out/diff.html").mkdir(parents=True)
    error_text = refused(capsys, 2, "diff", *fleets, "--out", "out")
    assert "out/diff.html cannot be written (it is a folder)" in error_text


@mark.slow
@mark.parametrize(
    "line, reason",
    {
        "old new --vehicle delta": "A has no vehicle delta. Choose one of: alpha and beta.",
        "old new --vehicle beta": "B has no vehicle beta.",
        "old old": "Choose with --vehicle: alpha and beta.",
        "nobody nobody": "do not say of which vehicle",
    }.items(),
)
def test_a_vehicle_that_cannot_be_chosen_is_refused_with_those_that_can(
    line, reason, fleets, monkeypatch, capsys
):
    monkeypatch.chdir(Path(fleets[0]).parent)
    fleet_of(Path("nobody"), rows_of_flights("unknown", range(3)))
    assert reason in refused(capsys, 1, "diff", *line.split())


@mark.slow
def test_logs_are_read_and_a_log_without_a_flight_says_why(monkeypatch, tmp_path, capsys):
    """Single logs are compared instead of fleets. Folders of results are numbered if their name is taken."""
    rows = {
        "a.bin": rows_of_flights("alpha", [0], system=4, collective=0.4),
        "two.bin": rows_of_flights("alpha", [0, 1], system=4, collective=0.4),
        "b.bin": [FlightRow(file="b.bin", status="It is empty.")],
        "c.bin": rows_of_flights("alpha", [1], trim_share_interval=(0.2,) * 4),
    }
    monkeypatch.setattr("mavdem.fleet.state.rows_of_log", lambda path, *_: (rows[path.name], {}))
    assert run("diff", "a.bin", "a.bin", "--vehicle", "4:1") == 0
    (sentence,) = capsys.readouterr().out.splitlines()
    assert sentence == "A and B are the same flight: name another to compare it with."
    assert run("diff", "two.bin", "two.bin", "--vehicle", "4:1", "--out", "two") == 0
    sentence = capsys.readouterr().out.partition("\n")[0]
    assert sentence == "A and B are the same 2 logs: name others to compare them with."
    assert run("diff", "a.bin", "c.bin", "--vehicle", "alpha") == 0
    assert "No compared figure changed significantly." in capsys.readouterr().out
    for _ in range(2):
        assert run("diff", "a.bin", "other/c.bin", "--vehicle", "alpha") == 0
        assert "a_and_c-2/diff.html" in capsys.readouterr().out
    assert {path.name for path in Path().iterdir()} == {"a_and_c", "a_and_c-2"}
    # Parameters are compared even where there is no flight.
    vehicles = {
        name: Telemetry(1, 1, frame, "ARDUPILOTMEGA", {}, parameters=parameters)
        for name, frame, parameters in (
            ("a.bin", "QUADROTOR", {"ATC_RAT_RLL_P": 0.1, "FENCE_ENABLE": 1.0}),
            ("b.bin", "HEXAROTOR", {"ATC_RAT_RLL_P": 0.2, "FENCE_ENABLE": 0.0}),
        )
    }
    monkeypatch.setattr(
        "mavdem.cli.diff.read_log", lambda path: log_of_vehicles((vehicles[path.name],), 0, 0)
    )
    assert run("diff", "a.bin", "b.bin") == 1
    printed = capsys.readouterr()
    assert "B has no flight with figures. It is empty." in printed.err
    assert "Caution: Quadrotor in A, hexarotor in B: two vehicles, whose parameters" in printed.out
    assert re.search(r"ATC_RAT_RLL_P +0.1 +0.2 +\+100 %", printed.out)
    assert "Parameters: 0 of 2 that A and B have in common are equal; 2 set anew." in printed.out
    assert "Other parameters: 1 more differs; `--verbose` lists it." in printed.out
    assert "FENCE_ENABLE" not in printed.out
    assert run("diff", "a.bin", "b.bin", "--verbose") == 1
    assert re.search(r"FENCE_ENABLE +1 +0", capsys.readouterr().out)


@mark.slow
def test_the_page_on_comparisons_shows_what_its_commands_print(monkeypatch, capsys, request):
    """To learn from two whole flights takes as long as a hundred other tests: ``--in-full`` does.

    tests/test_figures.py compares two recorded flights in every run, and tests above and below have what is printed.
    """
    if not request.config.getoption("--in-full"):
        skip("only --in-full compares two flights of a minute each")
    monkeypatch.setenv("COLUMNS", "80")
    Path("logs").symlink_to(DOCUMENTATION.parents[1] / "logs")
    page = DOCUMENTATION.read_text(encoding="utf-8")
    _, commands, _ = page.split("```", maxsplit=2)
    for command in commands.strip().splitlines():
        capsys.readouterr()
        assert run(*command.split()[1:]) == 0
    assert f"```\n{capsys.readouterr().out}```\n" in page


@mark.slow
def test_a_flight_in_which_a_motor_failed_is_a_result_without_figures(monkeypatch, capsys):
    without_models = {f"{name}_status": "refused" for name in ("effect", "damping", "lag")}
    rows = {
        "sound.bin": rows_of_flights("alpha", [0]),
        "failed.bin": rows_of_flights("alpha", [1], failed_motor=2, **without_models),
    }
    monkeypatch.setattr("mavdem.fleet.state.rows_of_log", lambda path, *_: (rows[path.name], {}))
    assert run("diff", "sound.bin", "failed.bin") == 0
    text = unwrapped(capsys.readouterr().out)
    assert "motor 2 failed or was at its limit in B" in text


@mark.slow
def test_a_margin_that_fell_is_named_with_the_gain_that_was_raised_and_flights_by_their_files():
    before, after = (
        rows_of_flights("alpha", [number], phase_margin=margin, phase_margin_interval=0.1)
        for number, margin in enumerate((1.0, 0.3))
    )
    step = {"time": [0.0, 1.0], "step": [0.0, 1.0], "step_half": [0.0, 0.1]}
    axes = {"roll": {"rate": {"measured": step}}}
    steady = {"margins": {"level": "good", "sentence": "Enough margin."}}
    oscillating = {
        "margins": {"level": "bad", "sentence": "Roll oscillates.", "figures": {"axis": "roll"}}
    }
    reviews = {
        "A": {"axes": axes, "identity": {"date": "2026-01-31T10:00:00Z"}, "lights": steady},
        "B": {"axes": axes, "lights": oscillating},
    }
    parameters = [
        ParameterChange("ATC_RAT_RLL_P", 0.1, 0.2),
        ParameterChange("ATC_RAT_YAW_P", 0.1, 0.5),
    ]
    difference = vehicle_difference(before, after, parameters)
    logs = Hover().telemetry(), Hover(hovering=30.0).telemetry()
    flights = tuple(flight_series(Signals(log)) for log in logs)
    reviewed = reviewed_difference(difference, reviews, parameters)
    page = comparison_page(("a.bin", "b.bin"), reviewed, flights=flights)
    assert "recorded time in the air (s)" in page and "Mean motor output (%)" in page
    places = [page.index(f"Motor {motor} output (%)") for motor in (1, 2, 3, 4)]
    assert places == sorted(places) and places[0] > page.index('class="change"')
    headlines = re.findall(r'<p class="headline"><strong>([^<]*)', page)
    headlines = [headline.replace("\N{NO-BREAK SPACE}", " ") for headline in headlines]
    assert headlines[0] == "In B: roll oscillates." and "good in A, bad in B.</p>" in page
    (row,) = re.findall(r'<tr><td class="words"[^>]*>margins</td>.*?</tr>', page)
    assert re.findall(r'<span class="rating (\w+)', row) == ["good", "bad"]
    assert "hase margin on roll 57 → 17°" in page
    # Pitch lost as much without another gain.
    assert headlines[1].startswith("Changed: phase margin on pitch 57 → 17°")
    assert headlines[2] == "Gains changed: roll P +100 %; yaw P +400 %."
    assert "<p>By them: phase margin on roll 57" in page
    on_terminal = [sentence for sentence in headline_of_comparison(reviewed) if sentence.lead]
    for sentence, headline in zip(on_terminal[1:], headlines[1:], strict=True):
        assert f"{sentence.lead} {sentence.text}".startswith(headline)
    assert "<dd>a.bin, alpha, 2026-01-31 10:00 UTC</dd>" in page and "<dd>b.bin, alpha</dd>" in page
    # By their dates A may be the later one.
    lower = {"next_step": {"sentence": "Lower P."}}
    swapped = {
        "A": {"identity": {"date": "2026-02-01T10:00:00Z"}, "lights": oscillating, **lower},
        "B": reviews["A"],
    }
    assert next_step_sentences(reviewed_difference(difference, swapped))[0].lead == "Next, by A:"


@mark.parametrize(
    "half_widths, conclusion",
    [
        # The mean effect varies too much between two flights to be called the same.
        ({"effect": None}, "Trims and physical parameters did not change."),
        ({}, "No compared figure changed significantly."),
        (
            {
                "trim_share_interval": (0.2,) * 4,
                "effect_interval": (200.0,) * 4,
                "damping_interval": 20.0,
                "lag_interval": 1.0,
            },
            "Whether anything changed cannot be told.",
        ),
    ],
)
def test_page_and_terminal_conclude_alike_where_nothing_changed(half_widths, conclusion):
    """The wider the intervals of the compared figures are, the less the conclusion claims."""
    difference = vehicle_difference(
        rows_of_flights("alpha", [0]), rows_of_flights("alpha", [1], **half_widths)
    )
    assert conclusion in [
        sentence.lead for sentence in headline_of_comparison(reviewed_difference(difference))
    ]
    page = comparison_page(("a.bin", "b.bin"), reviewed_difference(difference, {"A": {}, "B": {}}))
    assert f'<p class="headline"><strong>{conclusion}' in page
