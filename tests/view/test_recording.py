"""Recordings of learned and of simulated flights: what is drawn is what was flown, learned and forecast."""

from dataclasses import fields, replace
from unittest.mock import Mock

import numpy as np
from made_up_motion import made_up_motion
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark
from recorded_flights import SLOW, short_flight
from rerun.chunk import RrdReader
from rerun_file import chunks, drawn, views

import mavdem
from mavdem.assessment.assess import assess
from mavdem.assessment.axis.options import Options
from mavdem.dataset.time_series import TimeSeries
from mavdem.experiments.held_out import FORECAST, HeldOut
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.model import ModelName
from mavdem.ingest import read_log
from mavdem.report.blocks import markdown
from mavdem.report.screen import analysis_blocks, flight_title
from mavdem.report.series import Series
from mavdem.view import write_recording
from mavdem.view.first_tab import events_text
from mavdem.view.flown import Pose, write_pose
from mavdem.view.logged_flight import flight_scene
from mavdem.view.plots import recording_to_file
from mavdem.view.recording import forecast_chart

pytestmark = mark.slow

SETTINGS = mavdem.Settings(order=2, window=9, parameter_precision=0.1, iterations=5)


@fixture(scope="module")
def assessed(tmp_path_factory):
    """An assessment with alarms, the first before the flight."""
    log = read_log(short_flight(tmp_path_factory.mktemp("log")))
    assessment = assess(log, axis="roll", options=Options(settings=SETTINGS))
    time = assessment.analysis.flights[0].time
    interval = (time[0] - 500.0, time[100])
    alarms = [
        Fact(ReportedEvent.GPS_LOST, Level.BAD, time=float(when), boot=0) for when in interval
    ]
    events = (*assessment.evidence.events, *alarms)
    return replace(assessment, evidence=replace(assessment.evidence, events=events))


@fixture(scope="module")
def recording(assessed, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "flight.rrd"
    write_recording(path, assessed)
    return path


def lines(path):
    """Times, s, and known values of every line, by entity path without its place in order."""
    values_by_path = {}
    for name, (times, values) in drawn(path).items():
        folder, line = name.rsplit("/", 1)
        is_known = np.isfinite(values[:, 0])
        values_by_path[f"{folder}/{line.split(' ', 1)[1]}"] = times[is_known], values[is_known, 0]
    return values_by_path


def documents(path):
    texts_by_path = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if "TextDocument:text" in batch.schema.names:
            text = batch.column("TextDocument:text").to_pylist()[0][0]
            texts_by_path[str(chunk.entity_path)] = str(text)
    return texts_by_path


def test_alarms_are_marked_in_every_plot(recording, assessed):
    shown_lines = lines(recording)
    flight = assessed.analysis.flights[0]
    plots = {line.rsplit("/", 1)[0] for line in shown_lines}
    assert {f"{plot}/alarm" for plot in plots} <= set(shown_lines) and len(plots) >= 9
    for plot in plots:
        times, _ = shown_lines[f"{plot}/alarm"]
        assert_allclose(times, 2 * [flight.time[100]], atol=1e-8)


def test_an_event_from_before_the_record_is_listed_without_a_time():
    gps_lost = Fact(ReportedEvent.GPS_LOST, Level.BAD, time=-np.inf, boot=0)
    assert "inf" not in events_text([Event(gps_lost.time, gps_lost)])


def test_angles_and_rates_are_drawn_as_measured_over_the_whole_record(recording, assessed):
    shown_lines = lines(recording)
    roll = assessed.evidence.time_history.axes["roll"]
    for name, signal in {"flight/angle/measured": roll.angle, "motion/3/roll": roll.rate}.items():
        time, values = shown_lines[name]
        is_known = np.isfinite(signal.measured.values)
        assert_allclose(time, signal.measured.time[is_known], atol=1e-8)
        assert_allclose(values, np.degrees(signal.measured.values[is_known]), atol=1e-4)


def test_diverging_forecasts_are_clipped(assessed):
    held_out = assessed.analysis.held_out
    series = Series(held_out.time[0], ("roll",), held_out.measured[0])
    away = np.full_like(held_out.band, 1e9)
    diverging = replace(held_out, forecasts={"forecast": away}, band=away)
    _, line = forecast_chart(0, diverging, series, "rad").lines
    assert np.nanmax(line.upper_edge) <= 5 * np.ptp(np.degrees(held_out.measured[0, :, 0]))


def test_a_forecast_is_drawn_with_the_name_of_its_model():
    values = np.zeros((1, 3, 1))
    held_out = HeldOut(
        time=np.array([[1.0, 1.1, 1.2]]),
        measured=values,
        forecasts={FORECAST: values},
        band=values,
        expected=values,
        variance=np.ones(1),
        model=ModelName.DEM,
    )
    measured = Series(held_out.time[0], ("roll",), values[0])
    assert forecast_chart(0, held_out, measured, "rad").y.label.endswith("model: DEM")


def test_the_one_blueprint_in_the_file_shows_what_is_there_in_the_screen_s_words(
    recording, assessed
):
    """Each view of the recording has data to show, and its texts are those of the report on the terminal."""
    texts_by_path = documents(recording)
    shown_views = views(recording)
    analysis = assessed.analysis
    entities = {str(chunk.entity_path).replace("\\", "") for chunk in RrdReader(recording).stream()}
    assert {
        "forecast/0",
        "flight/angle",
        "flight/parameters",
        "air/0",
        "loops/roll",
        "learning/gap",
    } <= set(shown_views)
    for origin in shown_views:
        assert any(f"{entity}/".startswith(f"/{origin.strip('/')}/") for entity in entities), origin
    report = [flight_title(analysis.flights, assessed.simulated), *analysis_blocks(assessed)]
    assert texts_by_path["/report"] == markdown(report)
    assert str(assessed.headline) in texts_by_path["/headline"]
    assert assessed.next_step.sentence in texts_by_path["/headline"]
    assert all(f"{name.capitalize()} – " in texts_by_path["/headline"] for name in assessed.lights)
    assert "log" in shown_views and "/log" in entities


def test_a_flight_that_never_takes_off_and_a_name_that_is_no_text(tmp_path):
    flown = made_up_motion()
    columns = {field.name: getattr(flown, field.name, None) for field in fields(Pose)}
    still = {"armed": ~flown.armed & False, "rotor_speeds": 0 * flown.rotor_speeds}
    rotors = np.array([[0.2, 0.2], [-0.2, -0.2], [0.2, -0.2], [-0.2, 0.2]])
    pose = Pose(**(columns | still | {"wind": 0 * flown.wind, "rotors": rotors}))
    write_pose(tmp_path / "still.rrd", "\udcff", pose)
    assert (tmp_path / "still.rrd").stat().st_size > 1000


def test_a_flight_without_a_model_is_shown_without_what_a_model_shows(tmp_path):
    path = tmp_path / "flight.rrd"
    write_recording(path, assess(read_log(SLOW), axis="roll"))
    drawn_views = views(path)
    assert {"flight/angle", "flight/motors", "report"} <= set(drawn_views)
    assert not any(
        view.startswith(("free_energy", "forecast", "flight/torque")) for view in drawn_views
    )
    [(times, _)] = [line for name, line in drawn(path).items() if name.startswith("flight/angle")]
    assert len(times) > 100


def test_the_vehicle_moves_along_its_path_in_3d_with_its_attitude(assessed, tmp_path):
    """The positions of the flight are replaced by a helix, which the scene must show."""
    history = assessed.evidence.time_history
    measured = history.axes["roll"].angle.measured
    time = measured.time[::7]
    path = np.column_stack([np.cos(time), np.sin(time), -time])
    position = TimeSeries(time, np.zeros(len(time), int), path)
    scene = tmp_path / "scene.rrd"
    with recording_to_file(scene, "scene") as stream:
        view = flight_scene(stream, replace(history, position=position), assessed.wind)
        assert flight_scene(stream, replace(history, position=None), None) is None
    assert "Path in 3D" in view.name
    entities = set()
    columns = {}
    for name, _, batch in chunks(scene, static=True):
        entities.add(name)
        for column in ("Transform3D:translation", "Transform3D:quaternion"):
            if column in batch.schema.names:
                columns[column] = np.vstack(batch.column(column).to_pylist())
    assert columns["Transform3D:translation"] == approx(path, abs=1e-3)
    x, y, z, w = columns["Transform3D:quaternion"].T
    rolls = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x**2 + y**2))
    assert rolls == approx(measured.values[::7], abs=1e-3)
    assert {"world/path", "world/north", "world/here/vehicle/body"} <= entities
    # The arrow of the wind has the mean speed of the reports, with its interval.
    wind = Mock(
        mean_speed=1.8,
        mean_speed_interval=(0.6, 3.3),
        speed=1.5,
        direction=90.0,
        speed_identifiable=True,
        direction_identifiable=True,
    )
    with recording_to_file(tmp_path / "wind.rrd", "wind") as stream:
        flight_scene(stream, replace(history, position=position), wind)
    labels = []
    for _, _, batch in chunks(tmp_path / "wind.rrd"):
        if "Arrows3D:labels" in batch.schema.names:
            labels += batch.column("Arrows3D:labels").to_pylist()
    assert labels == [["wind 0.6 to 3.3 m/s"]]
