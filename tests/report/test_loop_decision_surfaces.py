"""What every surface says about the loops of eighteen flights: one advice on each gain, that of the decision.

The flights are a made-up hover whose loops, margins and tracking are given. Every text is searched for gains that it
names, with the value before and after, and for advice to load or to keep gains.
"""

import re
from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
from hover import Hover, evidence_of
from known_gains import PX4, X_ROLL
from made_up_loop import WIND
from numpy.random import default_rng
from partial_records import partial_record
from pytest import MonkeyPatch, fixture, mark
from rerun_file import chunks

from mavdem.assessment import Assessment
from mavdem.assessment.axis import Options, analyse
from mavdem.assessment.axis.loop_decision import ADVICE_TO_TUNE, LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.tuning import Tuning, tune_loops
from mavdem.assessment.event_lights import lights_with_event
from mavdem.assessment.judgement import judge
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.dem.record import Record
from mavdem.documents import complete_document
from mavdem.documents.loops import tune_document
from mavdem.documents.review import review_document
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep, Override
from mavdem.facts.ending import Ending
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import GainFact, LoopAction, LoopFact, ResponseFact
from mavdem.facts.margins import TrackingLight
from mavdem.facts.motors import MotorsLight, TrimFact
from mavdem.fleet.rows_of_log import rows_of_assessment
from mavdem.immutable import ReadOnlyDict
from mavdem.live.gain_advice import facts_of_tuning
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import margin_rating
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.margins import OpenLoop
from mavdem.loops.resonance import Resonance
from mavdem.plant import Physical
from mavdem.report.blocks import Sentence, plain_text
from mavdem.report.charts.timeline import assessment_timeline
from mavdem.report.pages.flight_page import review_page
from mavdem.report.pages.tune_page import tune_page
from mavdem.report.review import review_screen
from mavdem.report.tuning.outcomes import outcome_sentences
from mavdem.report.tuning.overview import (
    margin_overview,
    terminal_margin_overview,
    tune_overview,
)
from mavdem.report.tuning.reasons import tune_blocks
from mavdem.report.tuning.result import is_about_loops, level_of_summary, tuning_result
from mavdem.report.tuning.summary import tune_summary
from mavdem.report.tuning.tables import margin_tables
from mavdem.view.plots import recording_to_file
from mavdem.view.recording import RecordingTabs

pytestmark = mark.slow

AXES = ("roll", "pitch")
MIXERS = {"roll": X_ROLL, "pitch": (1.0, -1.0, 1.0, -1.0)}
"""Weights of the motors in the torque about an axis."""
NOT_STEERED = Fact(LoopFact.NOT_STEERED, share=0.3)
TOO_SHORT = Fact(LoopFact.LOOP_TOO_SHORT, least_duration=20.0)
REFUTED = Fact(ResponseFact.RESPONSE_DISAGREES, share=0.3, needed=0.8)
OSCILLATION = Oscillation("roll", 22.0, 40.0, 0.9, False, 20.0, Segment(0, 10.0, 30.0))


def gains_of(axis):
    """PX4's parameters of one axis, named like those of roll."""
    return {name.replace("ROLL", axis.upper()): value for name, value in PX4.items()}


@cache
def loop(axis, factor, bias=0.0):
    """A loop of made-up flight and plant, with a rate controller of ``factor`` times the usual gains."""
    rng = default_rng(3)
    status = dict.fromkeys(("effect", "damping", "lag"), Status.REPORTED)
    rate = rng.normal(0, 0.01, 2000)
    mixer = MIXERS[axis]
    inputs = 1500 + rng.normal(0, 5, (2000, 1)) * mixer
    outputs = np.column_stack([rate.cumsum() * 0.005, rate])
    parameters = gains_of(axis) | {f"MC_{axis.upper()}RATE_K": factor}
    measurement = {"parameters": parameters, "input_range": (1000.0, 2000.0)}
    names = (axis, f"{axis} rate")
    record = Record(inputs, outputs, 0.005, (2000,), output_names=names, **measurement)
    covariance = np.diag([*4 * [9e-5], 0.09, 4e-6, 4e-6])
    sizes = 0.18 * np.array(mixer), 1.5, 0.03, 0.006, covariance
    plant = Physical(*sizes, status, dict.fromkeys(status, ""), 0, 0.1, (WIND,), 0.01, {}, ())
    identified_loop = loop_from_plant(plant._replace(bias=bias), record)
    doubts = (Fact(LoopFact.EFFECT_BIASED, reason=NOT_STEERED),) if bias else ()
    return replace(identified_loop, cautions=doubts)


def resonance(axis):
    """A response of the rate that is surely too large."""
    return Resonance(axis, 4.0, 21.0, 0.95, 40.0, (2.6, 3.4), ms_frequency=23.0, ms_coherence=0.9)


def injected_response(crossover):
    """Returns the open loop that an injected signal has measured: an integrator with 45 ms of delay."""
    frequency = np.geomspace(0.5, 60.0, 60)
    response = (crossover / (1j * frequency) * np.exp(-0.045j * frequency))[None]
    return OpenLoop(frequency, response)


def tracking_fact(axis, code=TrackingLight.FOLLOWS_SETPOINT, level=Level.GOOD, **figures):
    """Returns the fact on how an axis follows its setpoint."""
    all_figures = {
        "angle_error": 0.01,
        "error_limit": 0.17,
        "offset_angle": 0.0,
        "delay": 0.1,
        "rate_error": 0.1,
        **figures,
    }
    return Fact(code, level, axis=axis, **all_figures)


def overshooting_response(axis):
    """Returns the fact that the step response of an axis overshoots."""
    return tracking_fact(axis, TrackingLight.OVERSHOOTS_SETPOINT, Level.WATCH, overshoot=0.7)


def large_tracking_error(axis):
    """Returns the fact that an axis is far from its setpoint."""
    return tracking_fact(axis, TrackingLight.MISSES_SETPOINT, Level.BAD, angle_error=0.3)


def falls_short(axis, at_limit_share):
    """An axis is too slow."""
    figures = {"rate_setpoint": 1.8, "reached_rate": 1.2, "at_limit_share": at_limit_share}
    return tracking_fact(axis, TrackingLight.RATE_FALLS_SHORT, Level.WATCH, **figures)


FLIGHTS = {
    "sound": {},
    "probably sound": {"loop": 1.7},
    "below the goal": {"loop": 3.0},
    "below the goal, and slow": {"loop": 3.0, "tracking": lambda axis: falls_short(axis, 0.0)},
    "below the goal and overshoots": {"loop": 3.0, "tracking": overshooting_response},
    "below the goal and resonates": {"loop": 3.0, "response": resonance},
    "below the goal, resonates, and misses far": {
        "loop": 3.0,
        "response": resonance,
        "tracking": large_tracking_error,
    },
    "below the goal, biased": {"loop": 2.1, "bias": -0.5},
    "sound but resonates": {"response": resonance},
    "sound but slow": {"tracking": lambda axis: falls_short(axis, 0.0)},
    "sound, slow at a motor's limit": {"tracking": lambda axis: falls_short(axis, 0.5)},
    "refuted": {"loop": REFUTED},
    "refuted and overshoots": {"loop": REFUTED, "tracking": overshooting_response},
    "measured by an injected signal": {"loop": 3.0, "injected": injected_response(20.0)},
    "measured without a plant": {"loop": TOO_SHORT, "injected": injected_response(20.0)},
    "oscillates": {"loop": 6.0, "oscillation": OSCILLATION},
    "oscillates, overshoots, without gains": {
        "loop": NOT_STEERED,
        "tracking": overshooting_response,
        "oscillation": OSCILLATION,
        "parameters": {},
    },
    "below the goal, with a bad motor": {"loop": 3.0, "motors": MotorsLight.MOTOR_LIMITED},
}
"""Flights of roll by what they show; in all of them pitch is to fly before new gains: many models lack margin."""


@fixture(scope="module")
def analysed():
    """The evidence of a hover, and its analysis without a model."""
    signals = Signals(Hover().telemetry(autopilot="PX4", parameters=PX4 | gains_of("pitch")))
    evidence = evidence_of(signals)
    analysis = analyse(evidence.log, signals, "roll", Options(with_model=False))
    return evidence, analysis


@fixture(scope="module")
def searches_once():
    """Gains are searched once for the same loop and doubts: a search takes seconds."""
    searches = {}

    def advise_once(loop, tune="default", doubts=(), **options):
        key = (loop, tune, tuple(doubts), *options.items())
        if key not in searches:
            searches[key] = advise(loop, tune, doubts, **options)
        return searches[key]

    with MonkeyPatch.context() as patch:
        for module in ("loop_decision", "tuning"):
            patch.setattr(f"mavdem.assessment.axis.{module}.advise", advise_once)
        yield


def saturated(motor):
    """The fact that a motor is at its limit in settled flight, which forbids to fly."""
    return Fact(Override.SATURATION, subject=motor, names=(motor,), share=0.1)


@mark.parametrize("reason, is_stated", [(saturated("motor 1"), False), (NOT_STEERED, True)])
def test_a_report_has_one_repair_to_make_before_the_next_flight(reason, is_stated):
    """Why there are no gains is not repaired too where the next step is another repair."""
    no_loop = Fact(LoopFact.NO_LOOP, reasons=(saturated("motor 2"),))
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=reason)
    lights = {Light.TRACKING: reason, Light.MARGINS: reason}
    judgement = Mock(headline=reason, next_step=next_step, lights=lights, loop_decisions={})
    tuning = partial_record(
        Tuning,
        axes={"roll": no_loop},
        advice=(),
        judgement=judgement,
        controller_faults={},
        feedforward=(),
    )
    assert "No gains, because motor 2 is at its upper limit" in plain_text(tune_blocks(tuning))
    summary = plain_text(tune_summary(tuning, reason))
    assert ("Do not fly before motor 2" in summary) is is_stated


@fixture(scope="module")
def assessments(analysed, searches_once):
    """The assessments of all flights, by what they show."""
    evidence, analysis = analysed
    sound_pitch = loop("pitch", 1.0)
    assessments_by_name = {}
    for name, shows in FLIGHTS.items():
        roll = shows.get("loop", 1.0)
        roll_loop = roll if isinstance(roll, Fact) else loop("roll", roll, shows.get("bias", 0.0))
        loops = {"roll": roll_loop, "pitch": sound_pitch, "yaw": NOT_STEERED}
        condition = replace(evidence.condition, oscillation=shows.get("oscillation"))
        telemetry = evidence.signals.telemetry
        telemetry = replace(telemetry, parameters=shows.get("parameters", telemetry.parameters))
        shown_evidence = replace(
            evidence,
            signals=replace(evidence.signals, telemetry=telemetry),
            loops=loops,
            condition=condition,
        )
        # A refuted loop was identified all the same.
        if roll is REFUTED:
            shown_evidence = replace(shown_evidence, loops=loops | {"roll": loop("roll", 1.0)})
        response = resonance("roll") if "response" in shows else None
        vars(shown_evidence)["margins"] = (
            AxisMargins("roll", roll_loop, response, None, shows.get("injected")),
            AxisMargins("pitch", sound_pitch, None, None),
            AxisMargins("yaw", NOT_STEERED, None, None),
        )
        vars(shown_evidence)["tracking"] = {
            "roll": shows.get("tracking", tracking_fact)("roll"),
            "pitch": tracking_fact("pitch"),
            "yaw": Fact(
                TrackingLight.TRACKING_UNKNOWN,
                axis="yaw",
                asked=False,
                recorder="",
                rate_error=None,
            ),
        }
        motors = Fact(Unjudged.JUDGED_LATER, path="flight.tlog", reason=None)
        if "motors" in shows:
            motors = Fact(shows["motors"], Level.BAD, names=("motor 1",), share=0.4)
        judgement = judge(shown_evidence, motors=motors)
        assessments_by_name[name] = Assessment(
            shown_evidence.log, judgement, shown_evidence, ReadOnlyDict({"roll": analysis})
        )
    return assessments_by_name


@fixture(scope="module")
def without_pictures():
    """Pages have no pictures of open loops, which take a third of their time and are not searched for advice."""
    with MonkeyPatch.context() as patch:
        for module in ("loop_chapters", "tune_page"):
            patch.setattr(f"mavdem.report.pages.{module}.loop_charts", lambda *_: ())
        yield


@fixture(scope="module")
def tunings(assessments):
    """The tuning of roll and pitch of each flight."""
    tunings_by_name = {}
    for name, assessment in assessments.items():
        tunings_by_name[name] = tune_loops(assessment, AXES, is_written=True)
    return tunings_by_name


FLIGHTS_WITH_PAGES = {
    "sound",
    "probably sound",
    "below the goal",
    "below the goal and resonates",
    "sound but slow",
    "refuted and overshoots",
    "oscillates",
}
"""Flights of which pages, documents and recordings are made, too: they show the blocks of screen and tune."""


@fixture(scope="module")
def surfaces_of(assessments, tunings, without_pictures, tmp_path_factory, pytestconfig):
    """What each surface says of a flight, computed once for its name; with ``--in-full`` of all flights."""
    path = tmp_path_factory.mktemp("surfaces") / "flight.rrd"
    named = FLIGHTS if pytestconfig.getoption("--in-full") else FLIGHTS_WITH_PAGES

    def surfaces_of_flight(name):
        assessment, tuning = assessments[name], tunings[name]
        surface_texts = screens(assessment, tuning)
        if name in named:
            surface_texts |= pages(assessment, tuning, path)
        return surface_texts

    return cache(surfaces_of_flight)


def texts(blocks):
    """Sentences and rows of tables as lines."""
    for block in blocks:
        if isinstance(block, Sentence):
            yield f"{block.lead} {block.text}"
        else:
            yield from (" ".join(map(str, row)) for row in block.rows)


def rerun_texts(assessment, path):
    """The documents of the tabs of flight and loops in a Rerun recording."""
    timeline = assessment_timeline(assessment)
    with recording_to_file(path, "flight") as recording:
        tabs = RecordingTabs(recording, assessment, timeline)
        tabs.summary()
        tabs.loops()
    for _, _, batch in chunks(path, static=True):
        if "TextDocument:text" in batch.schema.names:
            for row in batch.column("TextDocument:text").to_pylist():
                yield from row or ()


def screens(assessment, tuning):
    """What lights, screens, a live session, a fleet's row and files of gains say, by the name of the surface."""
    return {
        "lights": " ".join(fact.sentence_and_remedy for fact in assessment.lights.values()),
        "next step": assessment.next_step.sentence_and_remedy,
        "screen": review_screen(assessment).replace("\n", " "),
        "fleet": " ".join(
            str(row.loop_action) for row in rows_of_assessment(assessment, "flight.tlog")
        ),
        "tune": " ".join(texts(tune_blocks(tuning))),
        "tune, short": " ".join(texts(tune_blocks(tuning, is_full=False))),
        "tune's next step": tuning.judgement.next_step.sentence_and_remedy,
        "live": " ".join(fact.sentence_and_remedy for fact in facts_of_tuning(tuning)),
        "files": " ".join(tuning.files(assessment.evidence.signals.telemetry).values()),
    }


def pages(assessment, tuning, path):
    """What pages, documents and a recording say, by the name of the surface; the recording is written to ``path``."""
    return {
        "page": re.sub(
            r"<[^>]+>", " ", re.sub(r"(?s)<script.*?</script>", " ", review_page(assessment))
        ),
        "review document": str(complete_document("review", review_document(assessment))),
        "Rerun": " ".join(rerun_texts(assessment, path)).replace("|", " "),
        "tune page": re.sub(r"<[^>]+>", " ", tune_page("flight", tuning, assessment)),
        "tune document": str(complete_document("tune", tune_document("flight", "default", tuning))),
    }


NUMBER = r"(\d+\.?\d*(?:e-?\d+)?)"
NAMED_CHANGES = (
    rf"(MC_[A-Z_]+) from {NUMBER} to {NUMBER}",
    rf"(MC_[A-Z_]+) {NUMBER} → {NUMBER}",
    rf"(MC_[A-Z_]+)[ \n]+{NUMBER}[ \n]+{NUMBER}\b",
    rf"'(MC_[A-Z_]+)': {{'now': {NUMBER}, 'set': {NUMBER}",
)
"""A gain with its value before and after: in sentences, in tables, and in documents."""


def directions(text):
    """The gains that a text changes, with 1 for those that rise and -1 for those that fall."""
    named = set()
    for pattern in NAMED_CHANGES:
        for gain, before, after in re.findall(pattern, text):
            if before != after:
                named.add((gain, 1 if float(after) > float(before) else -1))
    return named


def decided_directions(assessment, tuning):
    """The same of the decisions and of the gains to load that follow from them."""
    changes = []
    for decision in assessment.loop_decisions.values():
        if decision.action is not None:
            changes += decision.action.figures.get("changes", ())
    for advice in tuning.advice:
        changes += [(gain, *values) for gain, values in advice.gains.items()]
    return {
        (gain, 1 if after > before else -1) for gain, before, after in changes if after != before
    }


LOADED = ("Load the gains", "Load these gains", "Set these gains")
LOWERED = ("Lower P and D", "P gain of the roll angle")
"""Words of advice on gains whose names are not known."""


@mark.parametrize("name", FLIGHTS)
def test_every_surface_gives_the_advice_of_the_decision(name, assessments, tunings, surfaces_of):
    """Screen, page and documents of a flight must raise or lower the same gains as the decision on its loops."""
    assessment = assessments[name]
    tuning = tunings[name]
    decided = decided_directions(assessment, tuning)
    gains = {gain for gain, _ in decided}
    assert len(gains) == len(decided), "the decision itself has one direction for each gain"
    actions = [
        decision.action
        for decision in assessment.loop_decisions.values()
        if decision.action is not None
    ]
    # Gains that are only lowered are named by the decision itself.
    has_gains_to_load = any(advice.parameters for advice in tuning.advice)
    codes = {action.code for action in actions}
    is_to_load = bool(codes & {*ADVICE_TO_TUNE})
    if has_gains_to_load and not is_to_load:
        assert LoopAction.FLY_BEFORE_GAINS in codes
    if not has_gains_to_load:
        assert not codes & {*ADVICE_TO_TUNE, LoopAction.FLY_BEFORE_GAINS}
    for surface, text in surfaces_of(name).items():
        assert directions(text) <= decided, surface
        if not is_to_load:
            assert not any(phrase in text for phrase in LOADED), surface
        if has_gains_to_load:
            assert not any(phrase in text for phrase in LOWERED), surface


def test_the_lights_show_the_action_of_the_axis_that_they_name(assessments):
    for assessment in assessments.values():
        roll = assessment.loop_decisions["roll"]
        for name in ("margins", "tracking"):
            light = assessment.lights[name]
            if light.is_watch_or_bad and light.figures.get("axis") == "roll":
                assert light.remedy == roll.fact.remedy


def test_no_goal_is_met_by_an_axis_that_does_not_follow(surfaces_of):
    texts = surfaces_of("sound but slow")
    for surface, text in texts.items():
        assert "goal met: the roll" not in text, surface
    assert "Enough margin, but the axis does not follow its setpoint" in texts["tune"]


def test_without_a_plant_tune_shows_the_measured_margins(surfaces_of, tunings):
    name = "measured without a plant"
    assert "by system identification" in surfaces_of(name)["tune"]
    # Gains are lowered by the measurement alone, which is a result.
    tuning = tunings[name]
    roll_alone = tuning._replace(axes={"roll": tuning.axes["roll"]}, advice=())
    assert tuning.judgement.loop_decisions["roll"].action.figures["changes"]
    assert roll_alone.failure is None


def test_the_review_document_says_where_the_maximum_sensitivity_is(assessments):
    document = complete_document("review", review_document(assessments["sound but resonates"]))
    resonance_of_roll = document["axes"]["roll"]["resonance"]
    assert resonance_of_roll["frequency"] == 21.0 and resonance_of_roll["ms_frequency"] == 23.0


def test_figures_that_an_unstable_loop_does_not_have_are_dashes():
    """The present gains make the attitude loop unstable, the advised ones do not."""
    unstable, sound = loop("roll", 12.0), loop("roll", 1.0)
    assert not unstable.attitude.is_stable
    for table in margin_tables({"now": unstable, "advised": sound}):
        rows = {row[0]: row[1:] for row in table.rows}
        for name in ("maximum sensitivity Ms", "bandwidth, -3 dB (Hz)"):
            now, advised = rows[name]
            assert now == "-" and advised != "-"
        # Its gain is known.
        assert rows["crossover (Hz)"][0] != "-"


def test_attitude_margins_are_dashes_only_where_the_rate_loops_peak_gives_them():
    """At five times the gains |L| of the attitude loop is 1 again at the peak; at half of them it lacks margin."""
    columns = {}
    for name, gain_factor in (("peak", 5.0), ("slow", 0.5)):
        roll = loop("roll", gain_factor)
        columns[name] = replace(
            roll, controller=roll.controller.with_parameters({"MC_ROLL_P": 18.0})
        )
    [_, attitude] = margin_tables(columns)
    assert {row[1] for row in attitude.rows[1:]} == {"-"}
    # What the table leaves out is no headline either: the rate loop lacks the margin.
    ratings = [margin_rating(column) for column in columns.values()]
    assert [rating.subject for rating in ratings] == ["rate", "attitude"]
    assert np.isfinite(ratings[0].figures["phase_margin_interval"]).all()
    [slow_phase_margin] = [row[2] for row in attitude.rows if row[0].startswith("phase margin")]
    assert slow_phase_margin.startswith("29 (")


def test_the_column_of_a_doubtful_loop_says_so_once():
    (rate, _) = margin_tables({"roll": loop("roll", 1.0), "pitch": loop("pitch", 1.0)}, {"pitch"})
    assert rate.header[1:] == ["roll", "pitch (doubtful)"]
    assert "doubtful" not in str(rate.rows)


def test_the_screen_of_tune_has_the_cautions_of_its_page(tunings):
    fast = Fact(LoopFact.CROSSOVER_FAST, crossover=17.0, rate=100.0, least_rate=150.0)
    tuning = tunings["below the goal"]
    roll = tuning.axes["roll"]
    roll = replace(roll, before=replace(roll.before, cautions=(fast,)))
    tuning = tuning._replace(axes={"roll": roll})
    for is_full in (False, True):
        report = " ".join(texts(tune_blocks(tuning, is_full=is_full)))
        assert report.count(fast.sentence_and_remedy) == 1, is_full
    (_, caution) = tune_blocks(tuning, is_full=False)
    assert caution.text == fast.sentence_and_remedy
    outcome, overview = tune_overview(tuning, tuning_result(tuning))
    assert outcome.lead == "Roll: new gains." and overview.header[0] == "now"
    # On a terminal the margins with new gains have a row of their own, and all have their intervals.
    names = ["goal", "roll rate", "  new gains", "roll attitude", "  new gains"]
    assert [row[0] for row in overview.rows] == names
    assert overview.rows[0] == ["goal", "≥ 45", "≥ 6", "≤ 2", ""]
    phase_margins = [row[1] for row in overview.rows[1:3]]
    assert all(re.fullmatch(r"\d+ \(.+ to .+\)", cell) for cell in phase_margins)
    (kept_rows, tried_rows) = (
        [row[0] for row in table.rows] for table in terminal_margin_overview(tunings["sound"])
    )
    assert "  tried gains" in tried_rows and "  tried gains" not in kept_rows
    # A page has the same tables, a phone with the intervals below, and without spaces.
    kept, tried = margin_overview(tunings["sound"])
    assert tried.header[0] == "now → tried" and tried.rows[1][0] == "pitch rate"
    assert kept.header[0] == "now" and kept.rows[2][0] == "roll attitude"
    [expected] = margin_overview(tuning)
    assert expected.header[0] == "now → new" and expected.rows[1][1] == " → ".join(phase_margins)
    [on_phone] = expected.phone_tables
    assert on_phone.rows[0] == ["goal", "≥45", "≥6", "≤2", ""]
    assert re.fullmatch(r"\d+→\d+", on_phone.rows[1][1])
    interval, _, new_interval = on_phone.rows[1][1].detail.partition("\n")
    assert interval in phase_margins[0] and re.fullmatch(r"\(\d+ to \d+\)", new_interval)
    assert not margin_overview(tuning._replace(axes={"roll": NOT_STEERED}))
    doubted = tuning._replace(doubtful_axes=frozenset(["roll"]))
    [doubtful] = margin_overview(doubted)
    assert doubtful.header[0] == "doubtful" and doubtful.rows == expected.rows


def test_margins_of_a_vehicle_to_be_repaired_are_as_sure_as_those_of_any_other(tunings):
    """A weak motor puts off new gains, but does not question the loop that was identified with it."""
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, names=("motor 1",), share=0.1)
    tuning = tunings["below the goal"]
    advice = replace(tuning.axes["roll"], refusals=(weak,))
    decision = LoopDecision(
        "roll", LoopDiagnosis.BELOW_GOAL, weak, reasons_against_gains=(weak,), repairs=(weak,)
    )
    judgement = replace(tuning.judgement, loop_decisions=ReadOnlyDict({"roll": decision}))
    tuning = tuning._replace(axes={"roll": advice}, judgement=judgement)
    [overview] = margin_overview(tuning)
    assert overview.header[0] == "as flown"
    [outcome] = outcome_sentences(tuning)
    assert outcome.lead == "Roll: no gains before the repair."
    report = tune_blocks(tuning, is_full=False)
    assert any("of the vehicle as it flew" in sentence.text for sentence in report)
    # A reason on the loop itself makes its margins doubtful.
    contradicted = replace(advice, refusals=(weak, Fact(GainFact.LOOP_UNSTABLE)))
    tuning = tuning._replace(axes={"roll": contradicted})
    [overview] = margin_overview(tuning)
    assert overview.header[0] == "doubtful"
    # Only that reason is stated where the headline has the repair.
    [report, *_] = tune_blocks(tuning, is_full=False, headline_above=weak)
    assert report.text.startswith("No gains, because the identified loop is unstable")
    assert "motor 1" not in report.text.lower()


def test_what_the_flight_warns_of_stands_beside_new_gains_and_colours_their_card(tunings):
    tuning = tunings["below the goal"]
    twist = Fact(TrimFact.TRIM_OF_YAW, Level.WATCH, share=0.13, headroom=None)
    lights = ReadOnlyDict({**tuning.judgement.lights, Light.MOTORS: twist})
    good = Fact(GainFact.ROOM_FOR_GAINS, Level.GOOD, names=["roll"])
    tuning = tuning._replace(judgement=replace(tuning.judgement, lights=lights))
    heading, on_flight, next_step = tune_summary(tuning, good)
    assert heading.lead == good.sentence and next_step.lead == "Next:"
    assert on_flight.lead == "The flight:" and on_flight.text.endswith(twist.remedy)
    assert level_of_summary(tuning, good) is Level.WATCH


def test_the_tune_page_opens_with_gains_steps_and_margins(assessments, tunings, without_pictures):
    name = "below the goal"
    page = tune_page("flight", tunings[name], assessments[name])
    chapters = re.findall(r"<details( open)?>\s*<summary><h2>([^<]*)</h2>", page)
    opened = [title for is_open, title in chapters if is_open]
    assert opened[:2] == ["Step response", "Margins"] and "Open loops" not in opened
    assert chapters[0][1] == "Step response"
    # What to do stands above the gains, and the files of the gains directly below them.
    first_file = page.index(" download=")
    assert page.index("<strong>Next:</strong>") < page.index("rate P</th>") < first_file
    assert first_file < page.index("Step response</h2>") and page.count("To go back") == 1
    # Present and advised margins stand beside each other, with the steps that are predicted of both.
    assert page.index("roll, advised</th>") < page.index("rate: phase margin")
    assert "attitude: overshoot of a step without feed-forward (%)" in page


def test_no_goal_heads_a_report_of_tune_whose_loops_are_not_all_trusted(tunings):
    tuning = tunings["sound"]
    good = Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)
    tuning = tuning._replace(judgement=replace(tuning.judgement, headline=good))
    known_advice = {
        axis: advice for axis, advice in tuning.axes.items() if not isinstance(advice, Fact)
    }
    assert tuning_result(tuning._replace(axes=known_advice)).code is LoopFact.MARGIN_RATING
    doubted = tuning._replace(axes=known_advice, doubtful_axes=frozenset(known_advice))
    unknown = tuning._replace(axes=known_advice | {"yaw": Fact(LoopFact.NO_LOOP, reasons=(good,))})
    assert tuning_result(doubted) == tuning_result(unknown) == good
    slow = tunings["sound but slow"]
    slow = slow._replace(judgement=replace(slow.judgement, headline=good))
    assert tuning_result(slow._replace(axes={"roll": slow.axes["roll"]})).level is Level.WATCH


def test_room_for_higher_gains_heads_the_report_of_tune(tunings):
    tuning = tunings["below the goal"]
    good = Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)
    advice = next(
        axis_advice
        for axis_advice in tuning.axes.values()
        if getattr(axis_advice, "parameters", {})
    )
    raised = replace(advice, rating=advice.rating.replace(Level.GOOD), sure=1.0)
    axes = {"roll": raised, "yaw": Fact(LoopFact.NO_LOOP, reasons=(good,))}
    judgement = replace(tuning.judgement, headline=good)
    result = tuning_result(tuning._replace(axes=axes, judgement=judgement))
    assert result == Fact(GainFact.ROOM_FOR_GAINS, names=["roll"], slower_axes=[])
    assert result.replace(slower_axes=["roll"]).sentence.endswith(
        "higher gains below, but with them the roll angle follows its setpoint more slowly."
    )


def test_axes_without_a_loop_for_the_same_reason_share_a_sentence(tunings):
    tuning = tunings["below the goal"]
    roll = Fact(LoopFact.NO_LOOP, reasons=(Fact(LoopFact.NOT_STEERED, share=0.131),))
    pitch = Fact(LoopFact.NO_LOOP, reasons=(Fact(LoopFact.NOT_STEERED, share=0.129),))
    judgement = replace(tuning.judgement, loop_decisions=ReadOnlyDict())
    report = tune_blocks(tuning._replace(axes={"roll": roll, "pitch": pitch}, judgement=judgement))
    assert [block.lead for block in report] == ["Roll and pitch:"]


def test_the_axes_of_a_vehicle_that_oscillates_share_a_sentence_and_the_next_step_advises(tunings):
    tuning = tunings["oscillates"]
    decisions = tuning.judgement.loop_decisions
    unknown = Fact(LoopFact.NO_LOOP, reasons=(decisions["roll"].reason,))
    [report] = tune_blocks(tuning._replace(axes=dict.fromkeys(decisions, unknown)), is_full=False)
    assert report.lead == "Pitch and yaw:", "the gains of roll are lowered"
    assert decisions["roll"].fact.remedy in str(tuning.judgement.next_step)


def test_a_crash_that_the_light_of_tracking_shows_is_not_about_loops(tunings):
    judgement = tunings["sound"].judgement
    crash = Fact(Ending.CRASHED, Level.BAD, time=9.0, height=2.0, cause=None, word=None)
    lights = ReadOnlyDict(lights_with_event(judgement.lights, crash))
    assert lights[Light.TRACKING] == crash
    crashed = replace(judgement, headline=crash, lights=lights)
    assert not is_about_loops(crash, crashed)
    assert is_about_loops(lights[Light.MARGINS], crashed)
    # A headline with a further figure is stated once, and not by the light once more.
    crashed = replace(crashed, headline=crash.replace(height=2.5))
    tuning = tunings["sound"]._replace(judgement=crashed)
    summary = tune_summary(tuning, tuning_result(tuning))
    assert "The flight:" not in [sentence.lead for sentence in summary]
