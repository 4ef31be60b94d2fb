"""Recordings of learnt and of simulated flights: what is drawn is what was flown, learnt and forecast."""

from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made_up_analysis import assessment, physical
from made_up_motion import made_up_motion
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from rerun.chunk import RrdReader
from rerun_file import chunks, views

import mavdem
from mavdem.evaluate import held_out_test
from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.report.blocks import markdown
from mavdem.report.labels import AxisCommand
from mavdem.report.screen import detail_blocks, screen, title
from mavdem.view import write_recording
from mavdem.view.flown import Pose, _plots, write_pose
from mavdem.view.recording import FlightSeries

FLIGHT = mavdem.read_flight(Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog")
PARTS = (FLIGHT[:380], FLIGHT[400:800])
TEST = FLIGHT[800:900]
TIME = np.concatenate([part.time for part in PARTS])
CHANGED = float(TIME[100])
SETTINGS = mavdem.Settings(order=2, window=9, parameter_precision=0.1, iterations=5)


@pytest.fixture(scope="module")
def learned():
    return mavdem.learn(PARTS, SETTINGS)


def assessed():
    """An assessment with alarms, the first before the flight, and an ordinary event."""
    known = assessment(physical())
    alarms = [
        Fact(Reported.GPS_LOST, Level.BAD, time=at, boot=0) for at in (TIME[0] - 5.0, CHANGED)
    ]
    evidence = SimpleNamespace(
        events=[*alarms, Fact(Reported.GPS_LOST, time=CHANGED, boot=0)], air=(None, None, None)
    )
    return replace(known, evidence=evidence)


@pytest.fixture(scope="module")
def recording(learned, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "flight.rrd"
    write_recording(path, PARTS, learned, held_out_test(PARTS[-1], TEST, learned), assessed())
    return path


def lines(path):
    """Times, s, and values of every line over boot clock, by entity path without its place in order."""
    found = {}
    for name, chunk, batch in chunks(path):
        if "Scalars:scalars" in batch.schema.names and "boot clock" in chunk.timeline_names:
            folder, line = name.rsplit("/", 1)
            times = np.array(batch.column("boot clock").cast("int64")) / 1e9
            found[f"{folder}/{line.split(' ', 1)[1]}"] = (
                times,
                np.ravel(batch.column("Scalars:scalars").to_pylist()),
            )
    return found


def documents(path):
    batches = {
        str(chunk.entity_path): chunk.to_record_batch() for chunk in RrdReader(path).stream()
    }
    texts = {
        name: batch for name, batch in batches.items() if "TextDocument:text" in batch.schema.names
    }
    return {
        name: str(batch.column("TextDocument:text").to_pylist()[0][0])
        for name, batch in texts.items()
    }


def without_gaps(line):
    times, values = line
    return times[np.isfinite(values)], values[np.isfinite(values)]


@pytest.mark.parametrize(("column", "name"), list(enumerate(TEST.output_names)))
def test_outputs_and_residuals_are_those_of_flight_and_model_in_degrees(
    recording, learned, column, name
):
    drawn = lines(recording)
    window = TEST.time
    forecast = learned.forecast(TEST.inputs)[:, column]
    half = learned.forecast_band(TEST.inputs, 0.9)[:, column]
    measured = np.concatenate([*(part.outputs for part in PARTS), TEST.outputs])[:, column]
    expected = {
        f"outputs/{name}/measured": (np.append(TIME, window), measured),
        f"outputs/{name}/forecast": (window, forecast),
        f"residuals/{name}/residual": (window, TEST.outputs[:, column] - forecast),
    }
    for line, (time, values) in expected.items():
        times, shown = without_gaps(drawn[line])
        assert_allclose(times, time, atol=1e-8)
        assert_allclose(shown, np.degrees(values), rtol=1e-9, atol=1e-9)
    # A gap after each segment, and a band as upright strokes.
    times, shown = drawn[f"outputs/{name}/measured"]
    assert_allclose(times[np.isnan(shown)], [part.time[-1] for part in (*PARTS, TEST)], atol=1e-8)
    times, edges = without_gaps(drawn[f"residuals/{name}/90 % band"])
    assert_allclose(times, np.repeat(window, 2), atol=1e-8)
    assert_allclose(edges[1::2], np.minimum(np.degrees(half), edges.max()), rtol=1e-9)
    shaded, _ = without_gaps(drawn[f"outputs/{name}/held out"])
    assert (shaded.min(), shaded.max()) == approx((window[0], window[-1]))


def test_the_command_and_the_wind_s_torque_are_over_the_training_data(recording, learned):
    drawn = lines(recording)
    command = AxisCommand.of(learned)
    assert learned.wind is not None and learned.wind.reason is None
    expected = {
        "command/roll command": command.series(np.vstack([part.inputs for part in PARTS])),
        "wind/on roll": np.degrees(learned.wind.torque),
    }
    for line, values in expected.items():
        times, shown = without_gaps(drawn[line])
        assert_allclose(times, TIME, atol=1e-8)
        assert_allclose(shown, values, atol=1e-9)


def test_every_plot_is_on_the_boot_clock_and_marked_where_something_went_wrong(
    recording,
):
    drawn = lines(recording)
    plots = {line.rsplit("/", 1)[0] for line in drawn}
    assert {f"{plot}/went wrong" for plot in plots} <= set(drawn) and len(plots) >= 6
    for plot in plots:
        times, _ = without_gaps(drawn[f"{plot}/went wrong"])
        assert_allclose(times, [CHANGED, CHANGED], atol=1e-8)


def test_a_forecast_beyond_all_numbers_leaves_the_measured_in_sight(learned):
    held_out = held_out_test(PARTS[-1], TEST, learned)
    away = np.exp(np.linspace(0, 700, len(TEST)))[None, :, None] * held_out.forecasts["forecast"]
    away[:, -3:] = [[np.inf, -np.inf], [np.nan, np.nan], [1.0, 1.0]]
    diverging = replace(
        held_out, forecasts=held_out.forecasts | {"forecast": away}, band=np.abs(away)
    )
    measured = np.degrees(np.vstack([part.outputs for part in (*PARTS, TEST)])[:, 0])
    for plot in FlightSeries(PARTS, learned, diverging).output(0):
        low, high = plot.range
        assert np.ptp(measured) / 4 < high - low <= 2 * np.ptp(measured)


def test_the_one_blueprint_in_the_file_shows_what_is_there_in_the_screen_s_words(
    recording, learned
):
    found = documents(recording)
    shown = views(recording)
    held_out = held_out_test(PARTS[-1], TEST, learned)
    entities = {str(chunk.entity_path).replace("\\", "") for chunk in RrdReader(recording).stream()}
    assert {"outputs/roll", "wind", "command", "effect/bars", "learning/gap"} <= set(shown)
    for origin in shown:
        assert any(f"{entity}/".startswith(f"/{origin.strip('/')}/") for entity in entities), origin
    assert found["/learning/details"] == markdown(detail_blocks(learned))
    known = assessed()
    report = screen(learned, held_out, assessment=known)
    assert found["/report"] == markdown([title(PARTS), *report])
    assert found["/headline"] == f"## {known.headline}"
    assert "log" in shown and "/log" in entities


MOTION = made_up_motion()
ROTORS = 0.2 * np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])


def pose(**instead):
    columns = {
        field.name: getattr(MOTION, field.name) for field in fields(Pose) if field.name != "rotors"
    }
    return Pose(**(columns | instead), rotors=ROTORS)


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    """By entity path, what was sent over time by component, and the time, s."""
    path: Path = tmp_path_factory.mktemp("flown") / "flight.rrd"
    write_pose(path, "made up", pose())
    assert len(RrdReader(path).blueprints()) == 1
    found: dict[str, dict[str, np.ndarray]] = {}
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


@pytest.mark.slow
def test_the_vehicle_is_where_it_was_and_turned_as_it_was(columns):
    here = columns["/world/here"]
    vehicle = columns["/world/here/vehicle"]
    rows = np.searchsorted(MOTION.time, here["time"] - 1e-6)
    assert len(rows) == approx(50 * 20, abs=2)
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


def test_lines_are_what_was_flown_and_errors_what_was_not_known(columns):
    assert np.ravel(columns["/roll/0 roll"]["scalars"]).max() == approx(np.degrees(0.2), abs=0.1)
    for name in ("0 roll rate", "1 roll"):
        assert_array_equal(np.ravel(columns[f"/errors/{name}"]["scalars"]), 0.0)
    # what touch-down does is not in the range
    late = np.abs(MOTION.time - MOTION.time[pose().carries()][-1]) < 0.1
    assert np.ptp(_plots(pose(known_rates=MOTION.known_rates + 9.0 * late[:, None]))[2].range) < 1.0
    for n, place in enumerate(("front right", "rear left", "front left", "rear right")):
        beyond = np.ravel(columns[f"/motors/{n} {place}"]["scalars"])
        assert_allclose(beyond, MOTION.outputs[:, n] - MOTION.outputs.mean(axis=1), atol=1e-9)


def test_a_flight_that_never_takes_off_and_a_name_that_is_no_text(tmp_path):
    still = pose(
        armed=np.zeros(len(MOTION), dtype=bool),
        rotor_speeds=np.zeros((len(MOTION), 4)),
        wind=0 * MOTION.wind,
    )
    write_pose(tmp_path / "still.rrd", "\udcff", still)
    assert (tmp_path / "still.rrd").stat().st_size > 1000
