"""Why an event is stated: its witnesses, for it and against it."""

from types import SimpleNamespace

from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.margins import MarginsLight
from mavdem.facts.power import PowerLight
from mavdem.facts.witnesses import SensorFact
from mavdem.report.templates import as_clause, headline
from mavdem.report.why import (
    evidence_sentences,
    evidence_text,
    evidence_texts,
    headline_evidence,
    margin_sentences,
    new_evidence_text,
)
from mavdem.witnesses.sensor_facts import (
    checked_event,
    contradicting_fact,
    support_count,
    supporting_fact,
)

SANK = supporting_fact(SensorFact.SANK, time=2.5, source="barometer", speed=4.04)
KNOCKED = supporting_fact(SensorFact.KNOCKED, time=3.0, acceleration=80.2)
UPRIGHT = contradicting_fact(SensorFact.STOOD_UPRIGHT, time=4.0, angle=0.1, source="accelerometer")


def impact(*witnesses):
    return Fact(MotionEvent.HIT, time=3.0, boot=0, witnesses=witnesses)


def test_witnesses_for_an_event_come_first_and_those_against_it_last():
    (sentence,) = evidence_sentences(impact(UPRIGHT, SANK, KNOCKED))
    assert sentence.lead == "Why:"
    assert sentence.text == (
        "the barometer sank at 4.0 m/s at 2.5 s and the accelerometer measured 80 m/s² at 3.0 s; "
        "against it: from 4.0 s on it stood upright, by the accelerometer."
    )


def test_what_shows_the_cause_comes_before_what_followed_and_each_is_listed_once():
    """Control was lost because motor 2 reached its limit, and then the vehicle sank."""
    climb = supporting_fact(
        SensorFact.COMMANDS_CHANGED,
        subject="motor 2",
        time=1.0,
        end_time=2.0,
        share_before=0.61,
        share=0.93,
        others_share_before=0.59,
        others_share=0.62,
        is_at_limit=True,
    )
    cause = Fact(FailedFirst.LIMIT_FIRST, time=2.0, subject="motor 2", witnesses=(climb,))
    lost = Fact(Ending.CONTROL_LOST, time=2.0, cause=cause, witnesses=(SANK,))
    clause = (
        "the command of motor 2 rose from its usual 61 % to its limit of 93 % between 1.0 and 2.0 s "
        "(the mean of the others from 59 % to 62 %)"
    )
    assert evidence_text(lost) == f"Why: {clause}; then the barometer sank at 4.0 m/s at 2.5 s."
    # Below the event with the same witnesses, only what shows the cause is new.
    above = evidence_texts(impact(SANK))
    assert new_evidence_text(lost, above) == f"Why: {clause}."
    assert new_evidence_text(lost, above | evidence_texts(lost)) == ""
    assert new_evidence_text(impact(SANK), evidence_texts(lost)) == ""
    # Below an event with the same cause, only what followed is new.
    assert new_evidence_text(lost, evidence_texts(lost.replace(witnesses=()))) == (
        "Why: the barometer sank at 4.0 m/s at 2.5 s."
    )


def test_a_command_before_and_in_a_loss_of_thrust_is_no_slow_rise():
    """Both are medians, and the motor may have lost its thrust at once."""
    rise = supporting_fact(
        SensorFact.COMMAND_ROSE,
        time=116.5,
        end_time=126.5,
        share_before=0.58,
        share=0.88,
        others_share_before=0.57,
        others_share=0.57,
    )
    assert rise.sentence == (
        "Its command was 88 % from 116.5 to 126.5 s, and 58 % before (the mean of the others stayed at 57 %)."
    )


def test_witnesses_stand_in_the_order_of_their_times():
    gravity = supporting_fact(SensorFact.GRAVITY_WRONG, acceleration=7.8, part="at rest")
    ended = supporting_fact(SensorFact.LOG_ENDED, duration=2.0)
    text = evidence_text(impact(ended, KNOCKED, SANK, gravity))
    clauses = ("at rest", "the barometer sank", "m/s² at 3.0 s", "the log ended 2.0 s later")
    places = [text.index(clause) for clause in clauses]
    assert places == sorted(places)


def test_the_headline_of_a_diverged_height_leaves_its_cause_to_the_evidence():
    gravity = supporting_fact(SensorFact.GRAVITY_WRONG, acceleration=7.8, part="at rest")
    divergence = Fact(
        MotionEvent.HEIGHT_DIVERGED, time=25.0, boot=0, climb_rate=-11.0, speed=3.5, cause=gravity
    )
    text = "The height estimate diverged at 25.0 s: it fell at 11.0 m/s while the barometer rose at 3.5 m/s"
    cause = "; the accelerometer measured 7.8 m/s² at rest, not 9.8."
    assert headline(divergence) == f"{text}{cause}"
    assert headline(divergence.replace(witnesses=(gravity,))) == f"{text}."
    assert evidence_text(divergence.replace(witnesses=(gravity,))).endswith(
        cause.removeprefix("; ")
    )


def test_a_report_of_the_autopilot_alone_has_what_its_light_measured_as_evidence():
    spent = Fact(ReportedEvent.BATTERY_SPENT, time=5.0, subject="battery 2")
    low = Fact(PowerLight.SUPPLY_LOW, Level.BAD, voltage=4.4, voltage_limit=4.5)
    (why,) = headline_evidence(spent, {"power": low})
    assert (why.lead, why.text) == ("Why:", low.sentence)
    assert not headline_evidence(spent, {"power": spent})
    assert not headline_evidence(spent, {"power": low.replace(Level.GOOD)})


def test_a_headline_quotes_the_first_measurements_that_confirm_it():
    knocks = [KNOCKED.replace(acceleration=50.0 + number) for number in range(6)]
    (first,) = headline_evidence(impact(SANK, *knocks), {})
    (rest,) = evidence_sentences(impact(SANK, *knocks))
    assert "51 m/s²" not in first.text and "50 m/s²" in first.text
    assert "53 m/s²" in rest.text


def test_a_headline_is_not_repeated_by_its_evidence():
    gravity = supporting_fact(SensorFact.GRAVITY_WRONG, acceleration=7.8, part="at rest")
    divergence = Fact(MotionEvent.HEIGHT_DIVERGED, time=1.0, climb_rate=-11.0, speed=3.5)
    cause = Fact(
        FailedFirst.HEIGHT_DIVERGED_FIRST,
        cause=divergence.replace(cause=gravity),
        witnesses=(gravity, SANK),
    )
    lost = Fact(
        Ending.CONTROL_LOST, time=2.0, height=None, word=None, cause=cause, witnesses=(KNOCKED,)
    )
    assert as_clause(gravity) in headline(lost)
    (why,) = headline_evidence(lost, {})
    assert why.text == "the barometer sank at 4.0 m/s at 2.5 s."


def test_what_stands_askew_is_not_called_upright():
    assert str(UPRIGHT).endswith(" it stood upright, by the accelerometer.")
    assert " it stood 32° from upright" in str(UPRIGHT.replace(angle=0.56))


def test_a_crash_report_is_not_evidence_for_itself():
    crash = Fact(ReportedEvent.CRASH_DETECTED, time=5.0, boot=0)
    reported = supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=crash)
    assert evidence_text(crash.replace(witnesses=(reported, SANK))) == (
        "Why: the barometer sank at 4.0 m/s at 2.5 s."
    )
    assert "the autopilot reports a crash (5.0 s)" in evidence_text(impact(reported, SANK))


def test_an_event_without_witnesses_has_no_why():
    assert evidence_sentences(Fact(MotionEvent.HIT, time=3.0)) == []
    assert evidence_text(Fact(MotionEvent.HIT, time=3.0)) == ""


def test_one_witness_is_not_enough_for_a_bad_event():
    by_one, by_two = checked_event(impact(), [SANK]), checked_event(impact(), [SANK, KNOCKED])
    assert (by_one.level, by_two.level) == ("watch", "bad")
    assert "no other sensor confirms" in by_one.sentence
    assert "confirms" not in by_two.sentence


def test_two_statements_that_rest_on_the_height_are_one_witness():
    by_estimate = supporting_fact(SensorFact.SANK, source="estimate", speed=5.0)
    assert support_count([SANK, by_estimate]) == 1
    assert support_count([SANK, by_estimate, KNOCKED, UPRIGHT]) == 2


def test_a_rest_that_follows_every_flight_is_no_witness():
    assert support_count([supporting_fact(SensorFact.RESTED, time=4.0)]) == 0


def test_a_headline_on_margins_has_its_goal_crossover_and_the_other_axes_that_lack_it():
    """Roll and pitch lack phase margin, yaw has enough.

    The reason names the goal, the crossover and pitch. An axis whose loop is not known or good has none.
    """
    figures = {"reason": None, "gain_margin": 9.0, "ms": 2.84, "lacking": "phase_margin"}
    roll, pitch, yaw = (
        Fact(
            MarginsLight.LOOP_MARGINS,
            level,
            subject="rate",
            axis=axis,
            phase_margin=phase,
            **figures,
        )
        for axis, phase, level in (
            ("roll", 25.0, Level.BAD),
            ("pitch", 29.0, Level.WATCH),
            ("yaw", 65.0, Level.GOOD),
        )
    )
    rate_loop = SimpleNamespace(crossover=17.4)
    loops = {"roll": SimpleNamespace(axis="roll", open_loop={"rate": rate_loop}.get)}
    (why,) = margin_sentences(roll, loops, (roll, pitch, yaw))
    assert why.lead == "Why:"
    goal = "the gain of that loop is 1 at 17 Hz, and the goal is 45° of phase margin there"
    assert why.text == f"{goal}; pitch has 29° and Ms 2.8."
    assert not margin_sentences(pitch, loops, (roll, pitch, yaw))
    assert not margin_sentences(yaw, loops, ())
