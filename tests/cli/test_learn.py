"""``mavdem learn``: its three files, its one document, and its refusals."""

import re
import shlex
from pathlib import Path
from unittest.mock import Mock

import numpy as np
from command_line import document_of, refused, run, strict_json, unwrapped
from numpy.testing import assert_allclose
from pytest import mark
from recorded_flights import FLIGHT, SLOW, short_flight

from mavdem import Learned, Settings
from mavdem import learn as learn_model
from mavdem.assessment.assess import assess_signals
from mavdem.cli.learn import default_result_folder
from mavdem.cli.output import TERMINAL_LINES, print_blocks, print_screen
from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.flights import read_flight
from mavdem.facts import Level
from mavdem.facts.session import TimeUse
from mavdem.fleet.row import FlightRow
from mavdem.live import SessionStatus
from mavdem.live.history import LiveHistory
from mavdem.motors.motor_changes import MotorChange
from mavdem.report.blocks import Sentence, Table
from mavdem.report.pages.flight_page import flight_page
from mavdem.report.pages.live_page import live_page
from mavdem.report.templates import headline as words_of

FLIGHT = str(FLIGHT)
FILES = {"model.json", "report.json", "report.html"}
RECORDINGS = {"flight.rrd", "flight.mcap"}


def names(folder):
    return {path.name for path in folder.iterdir()}


@mark.in_full
@mark.usefixtures("without_pages")
def test_the_document_is_the_report_of_the_library(tmp_path, capsys):
    """The command writes the model that the library learns from the same samples."""
    out = tmp_path / "new" / "folder"
    log = short_flight(tmp_path)
    arguments = f"learn {log} --out {out} --preset paper --start 2s --train 2s --test 50".split()
    arguments += ["--rrd", "--mcap"]
    report = document_of(capsys, *arguments)
    train = read_flight(log)[200:400]
    learned = learn_model(train, Settings.paper())
    assert report["model"]["A"] == learned.model.A.tolist()
    assert names(out) == FILES | RECORDINGS
    assert strict_json((out / "report.json").read_text()) == report
    written_model = Learned.from_json((out / "model.json").read_text())
    assert_allclose(written_model.forecast(train.inputs), learned.forecast(train.inputs))


@mark.slow
@mark.usefixtures("without_pages", "logs_read_once")
def test_people_see_one_screen_and_files_only_where_they_are_wanted(here, capsys):
    arguments = ["learn", short_flight(here), "--order", "2", "--train", "400", "--test", "100"]
    assert run(*arguments, "--no-files") == 0
    screen = capsys.readouterr().out.splitlines()
    assert len(screen) < TERMINAL_LINES and "\nNext:" in "\n".join(screen[-5:])
    assert names(here) == {"ardupilot_wind5_steps.tlog"}
    assert run(*arguments) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("Page:")
    assert names(here / "ardupilot_wind5_steps") == FILES


@mark.parametrize(
    "source, folder",
    {
        "a/flight.tlog": "flight",
        "f.ulg.xz": "f-2",
        "...tlog": "...tlog-learned",
        "g.ulg": "g",
        "b/g.ulg": "g-2",
        "deep.ulg": "deep-2",
        "h.ulg": "h-2",
    }.items(),
)
def test_the_folder_is_named_after_the_log_and_has_no_results_of_another(source, folder, here):
    """Folders f, g, h and deep exist with reports of other commands or logs.

    Only a folder with results of the same log and command is used again.
    """
    for name, report in (
        ("f", '{"document": "review", "source": "f.ulg"}'),
        ("g", '{"document": "learn", "source": "g.ulg"}'),
        ("h", '{"document": "learn"}'),
        ("deep", "[" * 9999),
    ):
        Path(name).mkdir()
        Path(name, "report.json").write_text(report, encoding="utf-8")
    assert str(default_result_folder(source)) == folder


def test_names_do_not_reach_the_terminal_as_what_it_obeys(capsys):
    print_blocks(
        [Sentence("\x1b[31m", "\u202e.tlog:"), Table(["\x9b", "\u2066"], [["\x1b]0;", "\n"]])]
    )
    print_to_stderr("\x1b[0m")
    output = "".join(capsys.readouterr())
    assert "\\x1b[31m" in output and "\\x1b]0;" in output and "\\u202e.tlog:" in output
    assert output.replace("\n", "").isprintable()
    print_blocks([Table(["range"], [["12\N{NO-BREAK SPACE}V"]])])
    assert "12 V" in capsys.readouterr().out


def test_a_table_of_more_numbers_than_fit_is_printed_in_parts(capsys):
    figures = [f"{number}.000000000001" for number in range(10, 22)]
    print_blocks([Table(["method", *figures], [["a", *figures]])])
    lines = capsys.readouterr().out.split("\n")
    assert " ".join(lines).split().count("method") == 2 and max(map(len, lines)) <= 120
    assert all(" ".join(lines).split().count(figure) == 2 for figure in figures)


@mark.in_full
@mark.usefixtures("without_pages", "logs_read_once")
def test_a_flight_too_short_names_the_options_that_fit(tmp_path, capsys):
    arguments = ["learn", FLIGHT, "--out", tmp_path / "out", "--start", "57", "--preset", "paper"]
    assert run(*arguments) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert not (tmp_path / "out").exists()
    assert run(*arguments, *shlex.split(captured.err.split("`")[1])) == 0


@mark.slow
@mark.parametrize("start", ["59", "86400"])
def test_a_start_too_late_is_refused(start, tmp_path, capsys):
    arguments = ["learn", FLIGHT, "--out", tmp_path / "out", "--start", start]
    assert "--start" in document_of(capsys, *arguments, code=1)["error"]["remedy"]


@mark.slow
@mark.usefixtures("logs_read_once")
def test_a_flight_too_slow_for_a_model_gives_condition_reason_and_remedy(tmp_path, capsys):
    for old in ("model.json", "flight.mcap"):
        (tmp_path / old).write_text("of a flight before")
    assert run("learn", SLOW, "--out", tmp_path, "--json") == 1
    captured = capsys.readouterr()
    report = strict_json(captured.out)
    reason = report["error"]["reason"]
    assert "Hz" in reason and report["error"]["remedy"] in captured.err
    assert (report["tier"], report["next_tier"]["tier"]) == ("c", "b")
    assert names(tmp_path) == {"report.json", "report.html"}
    assert strict_json((tmp_path / "report.json").read_text()) == report
    assert reason in (tmp_path / "report.html").read_text()
    assert run("learn", SLOW, "--out", tmp_path) == 1
    captured = capsys.readouterr()
    assert reason in unwrapped(captured.out) and reason not in captured.err


@mark.slow
@mark.usefixtures("without_pages")
def test_a_model_that_breaks_down_is_the_data_s_doing(tmp_path, monkeypatch, capsys):
    breaks_down = Mock(side_effect=np.linalg.LinAlgError("Singular matrix"))
    monkeypatch.setattr("mavdem.assessment.axis.training.learn", breaks_down)
    assert run("learn", short_flight(tmp_path), "--train", "400", "--out", tmp_path / "out") == 1
    assert "Singular matrix" in capsys.readouterr().out
    assert names(tmp_path / "out") == {"report.json", "report.html"}


@mark.slow
@mark.usefixtures("coarse_physics")
def test_the_truth_of_a_simulated_flight_stands_beside_the_estimates(here, capsys):
    assert run("fly", "iris_multisine", "--duration", "30", "--out", "f.tlog") == 0
    (advised,) = (line for line in capsys.readouterr().err.splitlines() if "--truth" in line)
    _, *command = shlex.split(advised)
    assert command == ["mavdem", "learn", "f.tlog", "--truth", "f.truth.npz"]
    assert run(*command[1:], "--train", "7s", "--preset", "paper") == 0
    assert "f.truth.npz" in (here / "f" / "report.html").read_text()


def test_an_impossible_out_or_a_wrong_truth_file_is_refused_before_the_work(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(
        "mavdem.cli.learn.read_source", Mock(side_effect=AssertionError("it reads"))
    )
    (tmp_path / "file").write_text("mine")
    out = tmp_path / "file" / "below"
    assert "--out" in refused(capsys, 2, "learn", "missing.tlog", "--out", out)
    assert run("learn", FLIGHT, "--out", tmp_path / "out", "--truth", FLIGHT) == 2
    captured = capsys.readouterr()
    assert (
        "ardupilot_wind5_steps.tlog is no truth file" in captured.err
        and captured.err.count("\n") == 1
        and captured.out == ""
    )
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@mark.slow
@mark.usefixtures("logs_read_once")
def test_every_place_says_the_same_of_a_flight(tmp_path, monkeypatch, capsys):
    """Motor 1 failed: terminal, pages and documents must all have that headline and its remedy.

    The log is assessed once, by ``learn``, and ``review`` shows the same assessment.
    """
    alarm = MotorChange(70.0, 66.4, 1, "motor 1 (front right)", 0.24, 0.99, loss=(0.17, 0.39))
    monkeypatch.setattr("mavdem.assessment.axis.analysis.motor_alarms", lambda signals: (alarm,))
    assessments = []

    def kept_assessment(*arguments, **options):
        assessments.append(assess_signals(*arguments, **options))
        return assessments[-1]

    monkeypatch.setattr("mavdem.cli.learn.assess_signals", kept_assessment)
    monkeypatch.setattr("mavdem.cli.review.assess", lambda *_, **__: assessments[-1])
    log = str(short_flight(tmp_path))
    out = tmp_path / "out"
    assert run("learn", log, "--preset", "paper", "--out", out) == 0
    screen = capsys.readouterr().out
    assert run("info", log, "--verbose") == 0
    contents = " ".join(capsys.readouterr().out.split())
    assert run("review", log, "--out", tmp_path / "review") == 0
    reviewed = " ".join(capsys.readouterr().out.split())
    page = (out / "report.html").read_text()
    document = (out / "report.json").read_text()
    (assessment,) = assessments
    assert assessment.headline.subject == alarm.name and assessment.headline.level is Level.BAD
    headline = words_of(assessment.headline)
    remedy = str(assessment.next_step)
    texts = [screen, contents, page, document, flight_page(log, assessment), reviewed]
    for text in texts:
        read = " ".join(text.replace("&#39;", "'").split())
        # Parameters have names such as GPS_HDOP_GOOD.
        assert headline in read and not re.search("(?<!_)GOOD(?!_)", read)
        assert remedy in read and "vehicle's reference" not in text
    report = (
        assessment.analysis.report_values
        | assessment.judgement_values
        | {"headline_fact": assessment.headline}
    )
    row = FlightRow.from_report(report, file=log)
    assert row.overrides == ("motors",) and row.headline == str(assessment.headline)
    assert row.light_motors == "bad"
    # A session's page is made of the same record.
    status = SessionStatus("1:1", motor_alarms_of_flight=(alarm,))
    live = live_page(
        "udpin:0", "roll", LiveHistory(), status, dict.fromkeys(TimeUse, 0.0), assessment.model
    )
    live = live.replace("\N{NO-BREAK SPACE}", " ")
    assert headline in live and remedy in live and ">GOOD<" not in live


@mark.slow
def test_reasons_in_a_table_wrap_as_far_as_a_terminal_has_lines(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    reason = "The estimate changes by 15 % with the wind spectrum that is assumed."
    table = Table(["purpose", "reason"], [["a purpose", reason]] * 5, words=True)
    print_screen([], [table], [], [Sentence("Go.", "Next:")], verbose=False)
    assert " ".join(capsys.readouterr().out.split()).count(reason.split("wind ")[1]) == 5
    long_table = Table(["purpose", "reason"], [["a purpose", reason * 9]] * 9, words=True)
    print_screen([], [long_table], [], [Sentence("Go.", "Next:")], verbose=False)
    assert len(capsys.readouterr().out.splitlines()) < TERMINAL_LINES
