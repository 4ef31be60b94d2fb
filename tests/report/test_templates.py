"""What the screens say, one golden file a screen; layouts as text, Markdown and HTML, notebooks, and the palette."""

from functools import partial
from math import inf
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from made_up_analysis import assessment, physical
from pytest import approx, fixture, mark
from recorded_flights import LOGS

import mavdem
from mavdem import baselines
from mavdem.assessment.condition import Condition, VibrationFigures
from mavdem.assessment.inventory import inventory
from mavdem.evaluate import compare, windows
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.truth import ComparedParameter, TruthComparison
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.facts.identifiability import Status
from mavdem.facts.margins import TrackingLight
from mavdem.facts.sources import Repair
from mavdem.ingest import read_log
from mavdem.report import palette
from mavdem.report.blocks import Sentence, Table, markdown, plain_text
from mavdem.report.comparison import comparison_report
from mavdem.report.condition import log_blocks
from mavdem.report.numbers import abbreviated_list, one_line_list, plus_minus, rounded
from mavdem.report.pages.page import notebook_html
from mavdem.report.screen import analysis_blocks, pole_sentences
from mavdem.report.templates import (
    as_clause,
    capitalize_first,
    interval,
    period,
    render_section,
    rounded_below,
    rounded_up,
    sentences_by_axes,
)
from mavdem.report.truth import truth_blocks

NAN = float("nan")


def is_golden(request, name, blocks):
    """Asserts that blocks read as the golden file of this name, which ``--write-golden`` writes."""
    path = Path(__file__).parent / "golden" / f"{name}.txt"
    text = plain_text(blocks) + "\n"
    if request.config.getoption("--write-golden"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    assert text.splitlines() == path.read_text().splitlines()


SCREENS = {
    "model": lambda: analysis_blocks(assessment(physical())),
    "doubtful": lambda: analysis_blocks(
        assessment(physical(0.2, lag=Status.NOT_IDENTIFIABLE, damping=Status.BIASED))
    ),
    "contents": lambda: log_blocks(inventory(read_log(LOGS / "ardupilot_default_rates.tlog"))),
}


@mark.parametrize("name", SCREENS)
def test_a_screen_reads_as_its_golden_file(name, request):
    is_golden(request, name, SCREENS[name]())


def test_the_vibration_of_the_condition_says_of_which_imu_it_is_and_leaves_clips_to_the_light():
    condition = Condition(
        duration=60.0, vibration=VibrationFigures((37.3, 33.4, 48.0), 12, (48.0,))
    )
    text = plain_text(render_section("condition", condition))
    vibration = "37.3, 33.4 and 48.0 m/s² along x, y and z, the mean of IMU 1 in settled flight."
    assert vibration in text and "clip" not in text


@mark.slow
def test_a_comparison_of_methods(request):
    flight = mavdem.read_flight(LOGS / "px4_wind5_steps.tlog")
    methods = [
        Method("hold last", baselines.hold, predicts=True),
        Method("constant mean", baselines.constant_mean, predicts=True),
        Method("subspace(2)", baselines.subspace),
        Method("subspace(400)", partial(baselines.subspace, order=400)),
    ]
    compared = compare(windows("px4", flight, hop=850), methods)
    is_golden(request, "comparison", comparison_report(compared))


def test_the_interval_of_a_biased_estimate_is_said_to_be_of_one():
    biased = ComparedParameter("damping", "1/s", 7.0, 0.5, 0.65, Status.BIASED)
    _, table = truth_blocks(TruthComparison("flight.truth.npz", (biased,), None))
    assert table.rows == [["rate damping", "7.0 ± 0.5", "0.650", "+977 %", "1/s", "no, biased"]]


@fixture(scope="module")
def flight():
    return mavdem.read_flight(LOGS / "ardupilot_wind5_steps.tlog")[:800]


@mark.slow
def test_a_notebook_shows_a_flight_with_a_row_a_channel_in_degrees(flight):
    page = ElementTree.fromstring(flight._repr_html_())
    rows = [
        [cell.text.replace("\N{NO-BREAK SPACE}", " ") for cell in row] for row in page.iter("tr")
    ]
    assert [row[0] for row in rows[1:]] == [
        *(f"{name}, µs" for name in flight.input_names),
        "roll, °",
        "roll rate, °/s",
    ]
    assert float(rows[5][1]) == approx(np.degrees(flight.outputs[:, 0].mean()), abs=0.05)
    assert "ardupilot_wind5_steps.tlog" in "".join(page.itertext()) and "8 s" in "".join(
        page.itertext()
    )


def test_every_text_is_escaped():
    evil = "<script>alert(1)</script>&"
    html = notebook_html([Sentence(evil, evil), Table([evil], [[evil]])])
    assert "<script" not in html and html.count("&lt;script&gt;") == 4
    time = np.arange(5.0)
    flight = mavdem.Flight(
        time, time, time, input_names=(evil,), provenance={"source": f"/tmp/{evil}"}
    )
    assert "<script" not in flight._repr_html_()


@mark.parametrize("line_break", ["\n", "\r\n", "\x0b", "\x1c", "\x85", "\u2028"])
def test_a_text_from_a_log_prints_no_line_of_its_own(line_break):
    """The text could otherwise look like a light of the review on the terminal."""
    text = f"Land{line_break}motors     good     No motor stands out."
    said = Fact(ReportedEvent.AUTOPILOT_SAID, text=text, count=1)
    assert len(said.sentence.splitlines()) == 1


def test_markdown_aligns_numbers_to_the_right_and_sets_commands_apart():
    text = markdown(
        [
            Sentence("Run `mavdem tune a.bin`. Then fly.", "Lead:"),
            Table(["a", "b"], [["x", "1"]]),
            Table(["a", "b"], [], words=True),
        ]
    )
    lead, command, after, *tables = text.split("\n\n")
    assert (lead, command, after) == ("**Lead:** Run", "```\nmavdem tune a.bin\n```", "Then fly.")
    assert tables == ["| a | b |\n| --- | ---: |\n| x | 1 |", "| a | b |\n| --- | --- |"]


@mark.parametrize(
    "value, half, shown",
    [
        (-5.0, 0.07, "-5.00 ± 0.07"),
        (0.00155, 0.009, "0.002 ± 0.009"),
        (-0.0001, 0.01, "0.000 ± 0.010"),
        (3.5123, 1.149, "3.5 ± 1.1"),
        (1234.0, 32.0, "1230 ± 30"),
        (-2.457e-8, 3e-10, "(-24.6 ± 0.3)e-9"),
        (7.5e6, 2e4, "(7.500 ± 0.020)e6"),
        (0.25, np.nan, "-"),
        (0.25, 0.0, "0.25"),
    ],
)
def test_an_estimate_has_the_digits_of_its_interval(value, half, shown):
    """A half width has two digits, and the value as many decimals."""
    assert plus_minus(value, half) == shown


@mark.parametrize(
    "value, shown",
    {
        0.0: "0",
        1234.5: "1234",
        0.0123: "0.012",
        9.96: "10.0",
        np.inf: "infinite",
        1e9: "1e+09",
    }.items(),
)
def test_numbers_without_an_interval_have_two_digits(value, shown):
    assert rounded(value) == shown
    assert rounded_below(3.4, 5.0) == "3.4"


def test_an_upper_bound_is_rounded_up():
    assert [rounded_up(value, 1) for value in (0.146, 0.3, 1.0)] == ["0.2", "0.3", "1.0"]


def test_a_long_list_states_its_first_names():
    assert (abbreviated_list("abcdef"), abbreviated_list("abcde")) == (
        "a, b, c, d and 2 more",
        "a, b, c, d and e",
    )
    assert one_line_list([*"fedcb", "a" * 81]) == f"{'a' * 80}…, b, c, d, e, …"


def luminance(colour):
    """As WCAG 2 has it."""
    share = np.array(palette.channels(colour)) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722] + 0.05


def test_colours_are_read_on_light_and_on_dark():
    light = luminance(palette.PAPER_LIGHT)
    dark = luminance(palette.PAPER_DARK)
    named = (palette.DISTURBANCE, palette.LIMITED, palette.BAD, palette.TRUTH)
    for colour in (*named, *palette.DISTINCT, *palette.ASCENDING):
        brightness = luminance(colour)
        assert min(light / brightness, brightness / dark) >= 3
    lightness = [luminance(colour) for colour in palette.ASCENDING]
    assert lightness == sorted(lightness)
    assert light / luminance(palette.INK_ON_LIGHT) >= 7


def test_the_same_sentence_on_several_axes_is_stated_once():
    fact = Fact(TrackingLight.OVERSHOOTS_SETPOINT, overshoot=0.4)
    (sentence,) = sentences_by_axes((axis, fact.replace(axis=axis)) for axis in ("roll", "yaw"))
    assert sentence.lead == "Roll and yaw:"


def test_poles_have_a_frequency_and_a_damping_ratio_or_a_time_constant():
    swing = 2 * np.pi * 1.5
    for A, expected_text in (
        (
            [[-4.0, swing], [-swing, -4.0]],
            "-4 ± 9.42j: 1.6 Hz, damping ratio 0.39. The model is stable.",
        ),
        (
            np.diag([0.5, 0.0, -1.0]),
            "0.5: grows with time constant 2 s; 0: integrator; -1: time constant 1 s. The model is unstable.",
        ),
    ):
        (poles,) = pole_sentences(np.array(A))
        assert poles.text.startswith(f"{expected_text} These are modes of angle and rate together;")


def test_an_identifier_keeps_its_letters_at_the_beginning_of_a_clause_or_sentence():
    assert as_clause("BrokenProcessPool: a worker died.") == "BrokenProcessPool: a worker died"
    assert as_clause("GPS lost.") == "GPS lost" and as_clause("Motor 3 failed.") == "motor 3 failed"
    assert capitalize_first("gyroRate is 0") == "gyroRate is 0"
    assert capitalize_first("motor 3 failed") == "Motor 3 failed"


def test_one_dropout_is_singular_and_several_are_plural():
    texts = [
        str(Fact(Repair.LOGGER_DROPPED_OUT, count=count, duration=2.0, longest_gap=1.0))
        for count in (1, 2)
    ]
    assert "dropped out 1 time," in texts[0] and "dropped out 2 times," in texts[1]


@mark.parametrize(
    "words, text",
    [
        (period(3.2), " at 3.2 s"),
        (period(3.2, 4.0), " from 3.2 to 4.0 s"),
        (period(-inf), " before the record"),
        (period(-inf, 4.0), " until 4.0 s"),
        (period(-inf, inf), " since before the record"),
        (interval(3.2), " from 3.2 s"),
        (interval(3.2, 4.0), " from 3.2 s to 4.0 s"),
        (interval(-inf, 4.0), " until 4.0 s"),
        (interval(-inf), " throughout the record"),
    ],
)
def test_intervals_that_began_before_the_record_have_no_start_in_text(words, text):
    assert words == text
