"""Flights of a log: what a row says is what the log says, at each tier, and health comes from the vehicle's others."""

import json
from dataclasses import replace

import numpy as np
from partial_records import partial_record
from pytest import approx, mark
from recorded_flights import LOGS
from refusals import unreadable

import mavdem
from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_recording
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending
from mavdem.facts.fleet import NoPrior
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.wind import WindDoubt
from mavdem.fleet import priors
from mavdem.fleet import rows_of_log as module
from mavdem.fleet.priors import earlier_drag, earlier_flight
from mavdem.fleet.row import FlightRow
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.loops.axis_loops import Loop
from mavdem.loops.margins import OpenLoop
from mavdem.plant import Physical
from mavdem.wind_velocity.vehicle_drag import Drag
from mavdem.wind_velocity.velocity import WindVelocity

DRAG = json.dumps({"speed": 4.0, "drag": Drag(np.zeros(6), np.eye(6)).as_dict()})
SLOW = LOGS / "ardupilot_default_rates.tlog"


@mark.slow
def test_a_slow_log_gives_what_it_holds_says_why_no_more_and_has_one_page():
    """The attitude of the log comes at 4 Hz: its rows have the balance of the motors, but no model."""
    hover = mavdem.hover(SLOW)
    rows, pages = rows_of_log(
        SLOW, "0123456789abcdef0123", lambda name, found: f"{name} {[*found.analyses]}{found.wind}"
    )
    assert pages == {"0123456789abcdef-1-1.html": f"{SLOW.name} ['roll', 'pitch']None"}
    for axis, row in zip(("roll", "pitch"), rows, strict=True):
        assert (row.axis, row.tier, row.status, row.effect) == (axis, "c", "ok", None)
        assert "4 Hz" in row.tier_reason and row.page == "pages/0123456789abcdef-1-1.html"
        assert row.trim == approx(hover.trim) and row.headroom == approx(hover.headroom)
        assert row.duration == approx(hover.seconds) and row.attitude_rate == approx(4, abs=0.2)
        assert row.lean_roll == approx(np.radians(hover.roll)) and row.flight_count == 1
        assert len(row.positions) == len(row.spins) == len(row.motors) == 4


def test_still_air_is_no_wind_and_a_drags_interval_is_a_half_width():
    drag = Drag(np.zeros(6), np.eye(6))
    status = {"speed": Status.REPORTED, "direction": Status.NOT_IDENTIFIABLE}
    calm_air, moving_air = (
        partial_record(
            WindVelocity,
            drag=drag,
            status=status,
            speed_interval=interval,
            mean_speed=0.4,
            mean_speed_interval=interval,
        )
        for interval in ((0.0, 1.0), (0.1, 1.0))
    )
    still = module.wind_columns(calm_air)
    wind = module.wind_columns(moving_air)
    assert still["wind_speed"] is None and still["wind_speed_interval"] == (0.0, 1.0)
    assert wind["wind_speed"] == 0.4
    # Bounds that the light of the wind states of a speed in doubt.
    doubt = Fact(WindDoubt.SPEED_UNSURE, low=0.0, high=3.6, by_drag=False)
    unknown = dict.fromkeys(status, Status.NOT_IDENTIFIABLE)
    vague = module.wind_columns(
        partial_record(
            WindVelocity,
            drag=drag,
            status=unknown,
            speed_interval=(0.0, 3.6),
            reasons={"speed": doubt},
        )
    )
    assert vague["wind_speed"] is None and vague["wind_speed_interval"] == (0.0, 3.6)
    low, high = drag.interval("linear")
    assert wind["drag_interval"][:2] == approx((high - low) / 2)


def test_a_margin_is_in_radians_and_its_interval_a_half_width():
    figures = {"gain_margin": 9.0, "gain_margin_interval": (8.0, 10.0)}
    figures |= {"phase_margin": 180.0, "phase_margin_interval": (90.0, 270.0)}
    figures |= {"ms": 2.0, "ms_interval": (1.5, 2.5)}
    wider = figures | {"phase_margin": 90.0, "gain_margin_interval": (4.0, 14.0)}
    attitude = partial_record(OpenLoop, **wider)
    columns = module.margin_columns(partial_record(Loop, attitude=attitude, **figures))
    assert (columns["phase_margin"], columns["phase_margin_interval"]) == (np.pi, np.pi / 2)
    assert columns["gain_margin_interval"] == 1.0
    assert columns["ms_interval"] == 0.5
    assert columns["attitude_phase_margin"] == np.pi / 2
    assert columns["attitude_gain_margin_interval"] == 5.0


def test_a_row_has_effect_and_wind_torque_only_if_they_are_identifiable():
    """A biased effect is kept, one that is not identifiable is left out."""
    report = {
        "physical": {"effect": (0.3,), "status": {"effect": "biased"}},
        "wind": {"sd": 0.8, "mean": 0.1, "mean_band": 0.2},
    }
    assert FlightRow.from_report(report, axis="roll", file="f").wind_torque_sd == 0.8
    unresolved = report | {"wind": report["wind"] | {"reason": "It is not resolved."}}
    physical = {"effect": (0.3,), "status": {"effect": "not identifiable"}}
    for unknown, effect in ((unresolved, (0.3,)), (report | {"physical": physical}, None)):
        row = FlightRow.from_report(unknown, axis="roll", file="f")
        assert row.effect == effect
        assert (row.wind_torque_sd, row.wind_torque_mean, row.wind_torque_interval) == (
            None,
            None,
            None,
        )


@mark.parametrize("level, motor", [(Level.BAD, 2), (Level.WATCH, None)])
def test_the_motor_that_a_crash_is_blamed_on_is_in_its_row(level, motor):
    lost = Fact(Ending.CONTROL_LOST, level, subject="motor 2 (rear left)")
    assessment = partial_record(Assessment, lights={Light.MOTORS: lost})
    assert module.motor_of_light(assessment, Level.BAD) == motor
    assert module.motor_of_light(assessment, level) == 2


@mark.slow
def test_an_error_in_one_vehicle_leaves_the_rows_of_the_others(monkeypatch):
    """The assessment of one of two vehicles raises an error, which becomes the status of its row."""
    log = mavdem.ingest.read_log(SLOW)
    (sound_vehicle,) = log.vehicles
    other_vehicle = replace(sound_vehicle, component=7)

    def failing(log, signals, *arguments, **known):
        if signals.telemetry is other_vehicle:
            raise KeyError("geometry")
        return assess_recording(log, signals, *arguments, **known)

    monkeypatch.setattr(module, "assess_recording", failing)
    monkeypatch.setattr(
        module, "read_log", lambda _: replace(log, vehicles=(other_vehicle, sound_vehicle))
    )
    failed, *rows = rows_of_log(SLOW)[0]
    assert "KeyError" in failed.status and failed.component == 7
    assert [row.axis for row in rows] == ["roll", "pitch"] and {row.status for row in rows} == {
        "ok"
    }


@mark.parametrize(
    "read, text, code",
    [
        (earlier_drag, "{}", NoPrior.DRAG_UNREADABLE),
        (lambda path: earlier_drag(path, 4.0), DRAG, NoPrior.DRAG_OF_THIS_FLIGHT),
        (lambda path: earlier_flight(path, "roll"), "{}", NoPrior.MODEL_UNREADABLE),
    ],
)
def test_documents_without_a_prior_for_the_next_flight_are_refused(tmp_path, read, text, code):
    """The file is no result, or is of the flight itself."""
    path = tmp_path / "report.json"
    path.write_text(text)
    assert unreadable(read, path).code is code


@mark.parametrize("basis, name", [("board", "quad-7"), ("system id", "")])
def test_the_drag_of_an_earlier_flight_names_its_vehicle(tmp_path, basis, name):
    identity = {"name": "quad-7", "basis": basis}
    (tmp_path / "report.json").write_text(json.dumps(json.loads(DRAG) | {"identity": identity}))
    assert earlier_drag(tmp_path).vehicle == earlier_drag(tmp_path / "model.json").vehicle == name


def test_a_model_of_the_axis_whose_effect_is_known_is_a_prior_and_no_other(tmp_path, monkeypatch):
    physical = partial_record(Physical, status={"effect": Status.REPORTED})
    record = partial_record(Record, output_names=("pitch", "pitch rate"))
    learned = partial_record(Learned, record=record, physical=physical)
    monkeypatch.setattr(priors.Learned, "from_json", lambda _: learned)
    (tmp_path / "model.json").write_text("")
    assert earlier_flight(tmp_path, "pitch") is learned
    assert unreadable(earlier_flight, tmp_path, "roll").code is NoPrior.MODEL_OF_OTHER_AXIS
    physical.status["effect"] = Status.NOT_IDENTIFIABLE
    assert unreadable(earlier_flight, tmp_path, "pitch").code is NoPrior.MODEL_WITHOUT_EFFECT
