"""``mavdem review`` and ``mavdem LOG``: one screen, one document and a page for every log that can be read."""

import re
import time
from dataclasses import replace

import click
from command_line import document_of, run, strict_json
from pytest import fixture, mark, raises
from recorded_flights import LOGS, SLOW
from refusals import prose

import mavdem
from mavdem.assessment.assess import assess
from mavdem.cli.review import with_coloured_level
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Unjudged
from mavdem.facts.motors import TrimFact
from mavdem.ingest import read_log
from mavdem.report.review import first_lines, further_lines, page_lines, review_screen


@fixture(scope="module")
def assessment():
    """The assessment of a sound flight, which the tests change in copies."""
    return assess(read_log(SLOW))


def test_a_log_alone_is_reviewed(here, capsys, monkeypatch):
    """The path of a log is enough as a command. The review fits a terminal of 80 columns and 24 lines."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run(SLOW) == 0
    screen = capsys.readouterr().out.splitlines()
    (next_line,) = (row for row, line in enumerate(screen) if line.startswith("Next: "))
    # A terminal of 24 lines shows all; what is not good is whole, and so is what to do next.
    assert len(screen) <= 24 and max(map(len, screen)) <= 80
    cut_lines = [line for line in screen[1:] if "…" in line]
    assert all(line[11:].startswith("good ") for line in cut_lines)
    assert screen[0].startswith("ardupilot_default_rates.tlog: ")
    assert 0 <= float(re.search(r"took ([0-9.]+) s", screen[-1])[1]) < time.perf_counter()
    folder = here / "ardupilot_default_rates"
    assert {path.name for path in folder.iterdir()} == {"report.html", "report.json"}
    document = document_of(capsys, "review", SLOW, "--out", "other")
    assert strict_json((here / "other" / "report.json").read_text()) == document
    assert document["hardware"]["recording"]["level"] == "good"


def test_what_only_the_page_has_is_said_in_lines_of_a_narrow_terminal(assessment):
    lines = page_lines(assessment, columns=40)
    assert len(lines) > 1 and max(map(len, lines)) <= 40
    assert " ".join(lines).startswith("The page also has plots over time, all ")


@mark.slow
def test_a_log_of_no_vehicle_that_can_be_judged_has_its_page(tmp_path, capsys):
    assert run("review", LOGS / "px4_wind5_steps.tlog", "--vehicle", "7", "--out", tmp_path) == 0
    assert "There is no vehicle 7" in capsys.readouterr().out
    assert "There is no vehicle 7" in (tmp_path / "report.html").read_text()


@mark.slow
def test_the_library_returns_what_is_printed(tmp_path):
    other_review = mavdem.review(SLOW, vehicle="9")
    assert other_review.headline.code is NotLearnableReason.NO_SUCH_VEHICLE
    assert {light.code for light in other_review.lights.values()} == {Unjudged.NOT_JUDGED}
    assert other_review.model is other_review.wind is None and other_review.events == ()
    assert other_review.loops["roll"].refusal == other_review.headline and not other_review.spectra
    assert str(other_review).count("\n") < 15
    assert other_review.lights["log"].level is Level.UNKNOWN
    with raises(TypeError):
        other_review.lights["log"] = other_review.headline
    command = "`mavdem tune 'my flight.tlog' --axis all`"
    next_line = prose(f"What to do, in so many words that they do not fit on the line: {command}.")
    judgement = replace(other_review.judgement, next_step=next_line)
    assert f"\n{command}." in str(replace(other_review, judgement=judgement))
    other_review.page(tmp_path / "page.html")
    assert other_review.sentence(other_review.headline) in (tmp_path / "page.html").read_text()


@mark.slow
def test_a_screen_in_two_parts_has_the_lines_of_the_whole_screen():
    findings = []
    assessment = assess(read_log(SLOW), show_findings=findings.append)
    (first_findings,) = findings
    first = first_lines(first_findings).splitlines()
    further = further_lines(assessment, first_findings).splitlines()
    whole_screen = review_screen(assessment).splitlines()
    # The lights have one order, on a terminal and in a file.
    assert first + further == whole_screen
    assert further[0].startswith("tracking")


@mark.slow
def test_a_row_divides_the_alarms_of_two_boots(assessment):
    stop = Fact(MotionEvent.MOTOR_OFF, Level.BAD)
    times = (
        (0, 60.0, "motor 3"),
        (0, 90.0, "motor 3"),
        (0, 177.9, "motor 1"),
        (1, 18.9, "motor 2"),
    )
    alarms = [stop.replace(time=time, boot=boot, subject=motor) for boot, time, motor in times]
    judgement = replace(assessment.judgement, lights={})
    evidence = replace(assessment.evidence, events=tuple(alarms))
    with_alarms = replace(assessment, judgement=judgement, evidence=evidence)
    lines = review_screen(with_alarms, columns=200).splitlines()
    assert [line.split("  ")[0] for line in lines[1:5]] == [
        "60.0 s",
        "177.9 s",
        "restart",
        "18.9 s",
    ]
    # Those of one kind are one row.
    assert lines[1].endswith("(first of 2).")


@mark.slow
def test_a_screen_lists_the_mode_and_the_worst_events_around_its_headline(assessment):
    """The headline's event has its place in the order of time, and its sentence stands once, below."""
    mode = Fact(ReportedEvent.MODE_CHANGED, Level.GOOD, time=90.0, subject="Loiter", cause=None)
    stop = Fact(MotionEvent.MOTOR_OFF, Level.BAD)
    loss, *others = (
        stop.replace(time=time, subject=motor)
        for motor, time in {"motor 2": 100.0, "motor 3": 100.4, "motor 4": 104.0}.items()
    )
    judgement = replace(assessment.judgement, headline=loss, lights={})
    evidence = replace(assessment.evidence, events=(mode, loss, *others))
    lines = review_screen(replace(assessment, judgement=judgement, evidence=evidence)).splitlines()
    assert [line.split("  ")[0] for line in lines if re.match(r"[0-9.]+ s  ", line)] == [
        "90.0 s",
        "100.0 s",
        "104.0 s",
    ]
    assert "100.0 s    BAD      See the headline." in lines


@mark.slow
def test_an_event_is_wrapped_rather_than_cut_and_has_the_time_of_the_page(assessment):
    """Of a motor's saturations the first stands for all, as on the page, even if a later one lasted longer."""
    motor = "motor 4 (rear right), which is named at some length"
    limit = Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, subject=motor, share=0.5, boot=0)
    first = limit.replace(time=100.0, end_time=102.0)
    second = limit.replace(time=110.0, end_time=120.0)
    loss = Fact(MotionEvent.MOTOR_OFF, Level.BAD, time=130.0, subject="motor 1", boot=0)
    judgement = replace(assessment.judgement, headline=loss, lights={})
    evidence = replace(assessment.evidence, events=(first, second, loss))
    screen = review_screen(replace(assessment, judgement=judgement, evidence=evidence), columns=70)
    assert "100.0 s    watch" in screen and "110.0 s" not in screen and "…" not in screen
    assert first.replace(count=2).sentence in " ".join(screen.split())


@mark.slow
def test_the_event_of_the_headline_is_wrapped_too(assessment):
    """Its first clause stands in the list, and the whole of it below."""
    motor = "motor 4 (rear right), which is named at some length"
    cause = Fact(MotionEvent.MOTOR_OFF, Level.BAD, time=99.0, subject=motor, boot=0)
    figures = {"speed": 5.1, "height": 0.0, "cause": None, "word": ""}
    impact = Fact(Ending.CRASHED, Level.BAD, time=100.0, boot=0, **figures)
    headline = impact.replace(cause=cause)
    judgement = replace(assessment.judgement, headline=headline, lights={})
    evidence = replace(assessment.evidence, events=(impact,))
    screen = review_screen(replace(assessment, judgement=judgement, evidence=evidence), columns=50)
    lines = screen.splitlines()
    assert "100.0 s    BAD      Hit the ground at 100.0 s," in lines
    assert max(len(line) for line in lines) <= 50


@mark.slow
def test_a_screen_lists_the_modes_before_the_landing(assessment):
    mode = Fact(ReportedEvent.MODE_CHANGED, Level.GOOD, subject="Return", cause=None, boot=0)
    swing = Fact(
        MotionEvent.ATTITUDE_SWUNG,
        time=100.0,
        end_time=105.0,
        subject="roll",
        angle=0.5,
        count=4,
        period=2.4,
        boot=0,
    )
    landing = Fact(ReportedEvent.ON_GROUND, Level.GOOD, time=104.0, boot=0, basis=())
    later_mode = mode.replace(time=106.0)
    events = (mode.replace(time=90.0), swing, mode.replace(time=102.0), landing, later_mode)
    judgement = replace(assessment.judgement, headline=swing, lights={})
    evidence = replace(assessment.evidence, events=events)
    screen = review_screen(replace(assessment, judgement=judgement, evidence=evidence))
    assert re.findall(r"(?m)^([0-9.]+) s .* Mode Return", screen) == ["90.0", "102.0"]


@mark.slow
def test_the_light_of_the_headline_refers_to_it(assessment):
    """The terminal would otherwise show one sentence twice."""
    trim = Fact(
        TrimFact.TRIM_OF_YAW,
        share=0.13,
        worst="motor 1",
        deviation=0.14,
        half=0.01,
        probability=0.99,
        assumed=False,
    )
    judgement = replace(assessment.judgement, headline=trim, lights={"motors": trim})
    screen = review_screen(replace(assessment, judgement=judgement), columns=300)
    assert "\nmotors     watch    See the headline.\n" in screen
    assert f"\n{trim.sentence}\n" in screen


def test_levels_are_coloured_only_in_their_column():
    line = "motors     BAD      It is BAD."
    assert click.unstyle(with_coloured_level(line)) == line
    assert with_coloured_level(line).startswith("motors     \x1b[91mBAD")
    assert with_coloured_level(line).endswith("It is BAD.")
    for plain in (
        "Next: fly.",
        "wind       unknown  No wind estimate.",
        "It is not BAD      at all",
    ):
        assert with_coloured_level(plain) == plain


def test_a_file_that_is_missing_is_no_command(capsys):
    assert run("missing.tlog") == 2
    assert "missing.tlog" in capsys.readouterr().err


@mark.slow
def test_two_logs_of_one_flight_are_one_review(here, capsys):
    """A log is cut in two, and both parts are given: the review is that of the whole log."""
    content = SLOW.read_bytes()
    middle = len(content) // 2
    first, second = here / "first.tlog", here / "second.tlog"
    first.write_bytes(content[:middle])
    second.write_bytes(content[middle:])
    assert run(SLOW) == 0
    whole_screen = capsys.readouterr().out.splitlines()
    assert run(first, second, "--verbose") == 0
    screen = capsys.readouterr().out.splitlines()
    (title,) = (line for line in screen if line.startswith("first.tlog: "))
    assert title.partition(": ")[2] == whole_screen[0].partition(": ")[2]
    assert (here / "first" / "report.json").is_file()
    assert run(first, LOGS / "px4_wind5_steps.tlog") == 2
    assert "not known to be of one flight" in capsys.readouterr().err
    assert run(first, first) == 2
    assert "the same log as" in capsys.readouterr().err


@mark.slow
def test_the_inventory_and_the_review_have_every_instance_and_what_can_be_trusted(here, capsys):
    """Both commands list batteries, sensors and outputs, and the checks of the sensors."""
    inventory = document_of(capsys, "info", SLOW, code=1)
    (vehicle,) = inventory["vehicles"]
    reviewed = document_of(capsys, "review", SLOW)
    for name in ("instances", "trust"):
        assert vehicle[name] == reviewed[name] != []
    assert reviewed["trust"][0]["checks"][0]["code"] == "trust_flight"
    page = (here / "ardupilot_default_rates" / "report.html").read_text()
    for title in ("Sensor checks", "Batteries, sensors, estimators, outputs"):
        assert title in page
    assert run("info", SLOW, "--verbose") == 1
    screen = capsys.readouterr().out
    assert "gyro against attitude" in screen
    assert "output 1 (motor 1)" in screen


@mark.slow
def test_a_light_that_has_no_short_sentence_is_shown_whole(assessment):
    reason = Fact(Unjudged.MULTIROTORS_ONLY, kind="a long type of vehicle " * 5)
    judgement = replace(assessment.judgement, lights={"wind": reason.replace(level=Level.GOOD)})
    for columns in (80, 160):
        screen = review_screen(replace(assessment, judgement=judgement), columns=columns)
        assert "…" not in screen and reason.sentence in " ".join(screen.split())


@mark.slow
def test_a_warning_of_two_lights_is_printed_once(assessment):
    stop = Fact(MotionEvent.MOTOR_OFF, Level.BAD, time=60.0, boot=0, subject="motor 3")
    lights = {"motors": stop, "tracking": stop}
    judgement = replace(assessment.judgement, lights=lights)
    screen = review_screen(replace(assessment, judgement=judgement), columns=200)
    assert screen.count(stop.sentence) == 1
    assert "\ntracking   BAD      See motors.\n" in screen
