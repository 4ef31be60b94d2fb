"""Recordings of learned and of simulated flights: what is drawn is what was flown, learned and forecast."""

from dataclasses import fields, replace

import numpy as np
from made_up_motion import made_up_motion
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark
from recorded_flights import FLIGHT
from rerun.chunk import RrdReader
from rerun_file import chunks, drawn, views

import mavdem
from mavdem.analysis.analysis import Options
from mavdem.assessment.assess import assess
from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.ingest import read_log
from mavdem.report.blocks import markdown
from mavdem.report.screen import analysis_blocks, title
from mavdem.report.series import Series
from mavdem.view import write_recording
from mavdem.view.flown import Pose, write_pose
from mavdem.view.recording import _forecast

SETTINGS = mavdem.Settings(order=2, window=9, parameter_precision=0.1, iterations=5)


@fixture(scope="module")
def assessed():
    """An assessment with alarms, the first before the flight."""
    log = read_log(FLIGHT)
    known = assess(log, axis="roll", options=Options(settings=SETTINGS))
    time = known.analysis.flights[0].time
    at = (time[0] - 500.0, time[100])
    alarms = [Fact(Reported.GPS_LOST, Level.BAD, time=float(when), boot=0) for when in at]
    events = (*known.evidence.events, *alarms)
    return replace(known, evidence=replace(known.evidence, events=events))


@fixture(scope="module")
def recording(assessed, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "flight.rrd"
    write_recording(path, assessed)
    return path


def lines(path):
    """Times, s, and known values of every line, by entity path without its place in order."""
    found = {}
    for name, (times, values) in drawn(path).items():
        folder, line = name.rsplit("/", 1)
        known = np.isfinite(values[:, 0])
        found[f"{folder}/{line.split(' ', 1)[1]}"] = times[known], values[known, 0]
    return found


def documents(path):
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if "TextDocument:text" in batch.schema.names:
            text = batch.column("TextDocument:text").to_pylist()[0][0]
            found[str(chunk.entity_path)] = str(text)
    return found


@mark.slow
def test_what_went_wrong_is_marked_in_every_plot(recording, assessed):
    shown_lines = lines(recording)
    flight = assessed.analysis.flights[0]
    plots = {line.rsplit("/", 1)[0] for line in shown_lines}
    assert {f"{plot}/went wrong" for plot in plots} <= set(shown_lines) and len(plots) >= 9
    for plot in plots:
        times, _ = shown_lines[f"{plot}/went wrong"]
        assert_allclose(times, 2 * [flight.time[100]], atol=1e-8)


@mark.slow
def test_forecasts_that_run_away_are_cut_off(assessed):
    held_out = assessed.analysis.held_out
    series = Series(held_out.time[0], ("roll",), held_out.measured[0])
    away = np.full_like(held_out.band, 1e9)
    diverging = replace(held_out, forecasts={"forecast": away}, band=away)
    _, line = _forecast(0, diverging, series, "rad").lines
    assert np.nanmax(line.high) <= 5 * np.ptp(np.degrees(held_out.measured[0, :, 0]))


@mark.slow
def test_the_one_blueprint_in_the_file_shows_what_is_there_in_the_screen_s_words(
    recording, assessed
):
    found = documents(recording)
    shown = views(recording)
    analysis = assessed.analysis
    entities = {str(chunk.entity_path).replace("\\", "") for chunk in RrdReader(recording).stream()}
    assert {"forecast/0", "flight/0", "air/0", "loops/roll", "learning/gap"} <= set(shown)
    for origin in shown:
        assert any(f"{entity}/".startswith(f"/{origin.strip('/')}/") for entity in entities), origin
    report = [title(analysis.flights), *analysis_blocks(assessed)]
    assert found["/report"] == markdown(report)
    assert str(assessed.headline) in found["/headline"]
    assert assessed.next_step.sentence in found["/headline"]
    assert all(f"{name.capitalize()} – " in found["/lights"] for name in assessed.lights)
    assert "log" in shown and "/log" in entities


MOTION = made_up_motion()
ROTORS = 0.2 * np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])


def pose(**instead):
    columns = {
        field.name: getattr(MOTION, field.name) for field in fields(Pose) if field.name != "rotors"
    }
    return Pose(**(columns | instead), rotors=ROTORS)


@fixture(scope="module")
def columns(tmp_path_factory):
    """By entity path, what was sent over time by component, and the time, s."""
    path = tmp_path_factory.mktemp("flown") / "flight.rrd"
    write_pose(path, "made up", pose())
    assert len(RrdReader(path).blueprints()) == 1
    found = {}
    for name, chunk, batch in chunks(path):
        if "boot clock" not in chunk.timeline_names:
            continue
        own = {
            part.split(":")[-1]: batch.column(part).to_pylist()
            for part in batch.schema.names
            if ":" in part
        }
        own["time"] = np.array(batch.column("boot clock").cast("int64")) / 1e9
        found.setdefault(f"/{name}", {}).update(own)
    return found


@mark.slow
def test_the_vehicle_is_where_it_was_and_turned_as_it_was(columns):
    here = columns["/world/here"]
    vehicle = columns["/world/here/vehicle"]
    rows = np.searchsorted(MOTION.time, here["time"] - 1e-6)
    assert len(rows) == approx(250 / 6 * 20, abs=2)
    assert_allclose(np.array(here["translation"])[:, 0], MOTION.position[rows], atol=1e-6)
    x, y, z, w = np.array(vehicle["quaternion"])[:, 0].T
    assert_allclose(np.column_stack([w, x, y, z]), MOTION.attitude[rows], atol=1e-6)


def test_thrust_points_up_and_the_wind_at_the_vehicle(columns):
    thrust = np.array(columns["/world/here/vehicle/thrust"]["vectors"])
    assert thrust.shape[1:] == (4, 3) and (thrust[..., 2] < 0).all() and not thrust[..., :2].any()
    wind = columns["/world/here/wind"]
    vectors, origins = (np.array(wind[name])[:, 0] for name in ("vectors", "origins"))
    assert (vectors[:, 1] < 0).all()
    heads = origins + vectors
    assert (heads[:, 1] > 0.2).all() and np.allclose(heads[:, [0, 2]], 0)


def test_a_flight_that_never_takes_off_and_a_name_that_is_no_text(tmp_path):
    still = pose(
        armed=np.zeros(len(MOTION), dtype=bool),
        rotor_speeds=np.zeros((len(MOTION), 4)),
        wind=0 * MOTION.wind,
    )
    write_pose(tmp_path / "still.rrd", "\udcff", still)
    assert (tmp_path / "still.rrd").stat().st_size > 1000
