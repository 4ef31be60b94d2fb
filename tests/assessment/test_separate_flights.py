"""Flights of a recording between which the autopilot restarted are judged each by itself, and so are its vehicles."""

from dataclasses import dataclass, replace

import numpy as np
from hover import MAV_AUTOPILOTS, X_QUAD, X_QUAD_PARAMETERS, Hover, columns, evidence_of
from known_gains import ARDUPILOT
from pytest import MonkeyPatch, approx, fixture, mark

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess, assess_recording
from mavdem.assessment.axis import Options
from mavdem.assessment.flown_flights import flown_flights
from mavdem.assessment.judgement import unjudged
from mavdem.assessment.separate_flights import separate_flights
from mavdem.cli.sources import note_flights_used_together
from mavdem.dataset.parameter_history import parameter_history
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.documents import complete_document
from mavdem.documents.review import review_document
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending
from mavdem.facts.loops import GainFact
from mavdem.facts.margins import MarginsLight
from mavdem.ingest.telemetry import concatenated_columns, log_of_vehicles
from mavdem.loops.advice import gains_to_lower
from mavdem.report.review import review_screen

RATE = 50.0
"""Rate of attitude and outputs, Hz."""


@dataclass(frozen=True)
class ShortHover(Hover):
    """A hover of 24 s that lands at once; roll may oscillate at ``frequency``, Hz, with motors from stop to stop."""

    hovering: float = 24.0
    frequency: float = 0.0

    @property
    def landed(self):
        return self.sinking + 4.0

    def roll(self, t):
        return super().roll(t) + self.amplitude * np.sin(self.phase(t))

    def roll_rate(self, t):
        swing = 2 * np.pi * self.frequency * self.amplitude
        return super().roll_rate(t) + swing * np.cos(self.phase(t))

    def motors(self, t):
        pulse_widths = super().motors(t)
        if self.frequency:
            in_air = (t >= 6.0) & (t < self.landed)
            swing = 500.0 * np.sign(np.sin(self.phase(t)))
            pulse_widths[in_air] = np.clip(1500.0 + X_QUAD * swing[in_air, None], 1000.0, 2000.0)
        return pulse_widths

    @property
    def amplitude(self):
        return 0.05 if self.frequency else 0.0

    def phase(self, t):
        return 2 * np.pi * self.frequency * t


def recording(*flights):
    """The signals of a recording with a boot for each pair of a hover and its P gain of roll."""
    tables = {}
    for boot, (hover, gain) in enumerate(flights):
        telemetry = hover.telemetry(RATE, RATE)
        parameters = ARDUPILOT | X_QUAD_PARAMETERS | {"ATC_RAT_RLL_P": gain}
        names = np.array([name.encode() for name in parameters])
        reports = columns(
            np.full(len(names), 1.0),
            param_id=names,
            param_type=9,
            param_value=np.array([*parameters.values()]),
        )
        for name, table in {**telemetry.messages, "PARAM_VALUE": reports}.items():
            boots = np.full(len(table["time"]), boot)
            tables.setdefault(name, []).append({**table, "boot": boots})
    messages = {name: concatenated_columns(of_boots) for name, of_boots in tables.items()}
    return Signals(replace(telemetry, messages=messages, parameters=parameters))


SOUND = ShortHover()
OSCILLATING = ShortHover(frequency=6.0)


@fixture(scope="module")
def assessment():
    """Three flights, of which the first oscillates with a gain that the pilot lowered a little afterwards."""
    signals = recording((OSCILLATING, 2.262), (SOUND, 2.0), (SOUND, 1.9))
    log = log_of_vehicles((signals.telemetry,), 0, 0)
    return assess_recording(log, signals, options=Options(with_model=False))


@mark.slow
def test_a_flight_has_the_parameters_that_it_was_flown_with():
    signals = recording((SOUND, 0.25), (SOUND, 0.3), (SOUND, 0.197))
    ended_by_user = replace(signals.telemetry, is_ended_on_purpose=True)
    flights = separate_flights(Signals(ended_by_user))
    gains = [flight.signals.telemetry.parameters["ATC_RAT_RLL_P"] for flight in flights]
    assert gains == [0.25, 0.3, 0.197]
    # The end of the recording is that of the last flight alone.
    are_ended_by_user = [flight.signals.telemetry.is_ended_on_purpose for flight in flights]
    assert are_ended_by_user == [False, False, True]
    assert [(flight.first_number, flight.last_number) for flight in flights] == [
        (1, None),
        (2, None),
        (3, None),
    ]
    assert [flight.duration for flight in flights] == approx([33.0] * 3, abs=2.0)
    for flight in flights:
        assert not any(table["boot"].any() for table in flight.signals.telemetry.messages.values())


@mark.slow
def test_a_flight_of_another_autopilot_has_the_parameters_that_this_one_reported():
    """Two logs that were joined, of vehicles with the same ids: ArduPilot's names and values are none of PX4."""
    signals = recording((SOUND, 0.25), (SOUND, 0.3), (SOUND, 0.35))
    messages = dict(signals.telemetry.messages)
    heartbeats = dict(messages["HEARTBEAT"])
    is_second = heartbeats["boot"] == 1
    heartbeats["autopilot"] = np.where(
        is_second, MAV_AUTOPILOTS["PX4"], MAV_AUTOPILOTS["ARDUPILOTMEGA"]
    )
    reports = dict(messages["PARAM_VALUE"])
    is_second = reports["boot"] == 1
    reports["param_id"] = np.where(is_second, b"MC_ROLLRATE_P", reports["param_id"])
    messages |= {"HEARTBEAT": heartbeats, "PARAM_VALUE": reports}
    flights = separate_flights(Signals(replace(signals.telemetry, messages=messages)))
    parameters = [flight.signals.telemetry.parameters for flight in flights]
    assert [values.get("ATC_RAT_RLL_P") for values in parameters] == [0.25, None, 0.35]
    assert ["MC_ROLLRATE_P" in values for values in parameters] == [False, True, False]


@mark.slow
def test_what_comes_before_the_first_clock_of_a_boot_does_not_count_in_the_boot_before():
    """A report has the time of the message before it, which was sent before the restart."""
    signals = recording((SOUND, 0.25), (SOUND, 0.3))
    reports = dict(signals.telemetry.messages["PARAM_VALUE"])
    is_second = reports["boot"] == 1
    reports["boot"] = np.zeros_like(reports["boot"])
    last_stamp = signals.telemetry.messages["ATTITUDE"]["time"].max()
    reports["time"] = np.where(is_second, last_stamp, reports["time"])
    messages = {**signals.telemetry.messages, "PARAM_VALUE": reports}
    flights = separate_flights(Signals(replace(signals.telemetry, messages=messages)))
    gains = [flight.signals.telemetry.parameters["ATC_RAT_RLL_P"] for flight in flights]
    assert gains == [0.25, 0.3]


@mark.slow
def test_a_command_that_uses_all_flights_together_says_so(capsys):
    flights = recording((SOUND, 0.25), (SOUND, 0.3))
    note_flights_used_together(separate_flights(flights)[0].signals)
    assert not capsys.readouterr().err
    note_flights_used_together(flights)
    assert capsys.readouterr().err.startswith("All 2 flights of the log are used together")


@mark.slow
def test_a_gain_that_a_later_boot_lowered_is_not_lowered_again():
    first, *_ = separate_flights(recording((SOUND, 2.262), (SOUND, 0.3), (SOUND, 0.197)))
    in_flight = [Segment(0, 10.0, 20.0)]
    parameters = parameter_history(first.signals).during(in_flight)
    assert parameters.values["ATC_RAT_RLL_P"] == 2.262
    reduction = gains_to_lower(["ATC_RAT_RLL_P"], parameters)
    assert not reduction.changes
    (fact,) = reduction.changed
    assert fact.code is GainFact.GAIN_LOWERED_SINCE
    assert fact.figures["present_value"] == 0.197


@mark.slow
def test_the_worst_flight_is_assessed_and_its_gains_are_lowered_to_two_thirds(assessment):
    assert assessment.headline.code is MarginsLight.OSCILLATES
    advice = assessment.headline.figures["reason"]
    assert advice.code is GainFact.LOWER_GAINS
    # The vehicle still has the gain of the last flight, and two thirds of the first one's are less.
    assert advice.figures["changes"][0] == ("ATC_RAT_RLL_P", 1.9, 1.51)
    verdicts = assessment.flight_verdicts
    # Flights 2 and 3 are as good, and the latest comes first.
    assert [verdict.number for verdict in verdicts] == [1, 3, 2]
    assert [verdict.fact.level is Level.BAD for verdict in verdicts] == [True, False, False]


@mark.slow
def test_screen_and_document_name_the_flight_and_the_verdicts_on_the_others(assessment):
    screen = " ".join(review_screen(assessment).split())
    document = complete_document("review", review_document(assessment))
    for sentence, verdict in zip(document["flights"], assessment.flight_verdicts, strict=True):
        assert sentence.startswith(f"Flight {verdict.number} (0:")
        assert sentence in screen
    assert screen.index("Flight 1 (0:") < screen.index("Next: ") < screen.index("Flight 2 (0:")


@mark.slow
def test_of_several_vehicles_each_is_judged_and_the_report_is_of_the_worst():
    sound = recording((SOUND, 0.197)).telemetry
    oscillating = replace(recording((OSCILLATING, 2.262)).telemetry, system=2)
    log = log_of_vehicles((sound, oscillating), 0, 0)
    assessment = assess(log, options=Options(with_model=False))
    assert assessment.evidence.signals.telemetry.system == 2
    assert [verdict.name for verdict in assessment.vehicle_verdicts] == ["2:1", "1:1"]
    assert assessment.stated_headline.sentence.startswith("Vehicle 2:1: the roll rate oscillates")
    screen = " ".join(review_screen(assessment).split())
    assert "with `--vehicle 1:1` it is of the other. Vehicle 1:1: " in screen
    document = complete_document("review", review_document(assessment))
    assert [fact["figures"]["name"] for fact in document["vehicles_facts"]] == ["2:1", "1:1"]
    assert not assess(log, "1", options=Options(with_model=False)).vehicle_verdicts


def test_a_vehicle_that_was_lost_before_it_flew_settled_is_worse_than_one_that_flew_well():
    evidence = evidence_of(Signals(ShortHover().telemetry(RATE, RATE)))
    lost = Assessment(evidence.log, unjudged(Fact(Ending.TIPPED_OVER, Level.BAD)), evidence)
    unflown = replace(lost, judgement=unjudged(Fact(MarginsLight.MARGINS_UNKNOWN, Level.UNKNOWN)))

    class SettledAssessment(Assessment):
        has_settled_flight = True

    good = Fact(MarginsLight.NO_RESONANCE, Level.GOOD)
    sound = SettledAssessment(evidence.log, unjudged(good), evidence)
    assert lost.severity_key < sound.severity_key < unflown.severity_key


def test_an_event_in_the_headline_is_of_one_of_the_flights_that_are_judged_together():
    hover = ShortHover()
    evidence = evidence_of(Signals(hover.telemetry(RATE, RATE)))
    flight = flown_flights(evidence.signals)[0]
    flights = [flight, replace(flight, start=100.0, end=130.0)]
    crash = Fact(Ending.CRASHED, Level.BAD, time=120.0, height=2.0, cause=None, word=None)
    assessment = Assessment(evidence.log, replace(unjudged(crash), headline=crash), evidence)
    assert assessment.flight_of_headline is None
    with MonkeyPatch.context() as patch:
        patch.setattr("mavdem.assessment.record.flown_flights", lambda _: flights)
        fact = replace(assessment).flight_of_headline
        in_other_boot = crash.replace(boot=flight.boot + 1)
        judgement = replace(unjudged(crash), headline=in_other_boot)
        assert replace(assessment, judgement=judgement).flight_of_headline is None
    assert fact.figures["number"] == 2
    assert fact.sentence.startswith("That was in flight 2, from 100 to 130 s")
