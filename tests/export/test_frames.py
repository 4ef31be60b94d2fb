"""Flights and models as pandas and xarray objects, systems of python-control, and MCAP channels for layouts."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from mcap.reader import make_reader
from numpy.testing import assert_allclose, assert_array_equal
from partial_records import partial_record
from pytest import approx, fixture, mark, raises, warns
from recorded_flights import FLIGHT
from refusals import prose, refused
from simulated import simulated

import mavdem
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.evaluate import held_out_test
from mavdem.export.control_systems import identified_parameters
from mavdem.export.mcap_channels import write_channels
from mavdem.export.tables import columns
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPlant
from mavdem.flight import Flight
from mavdem.plant import Physical
from mavdem.report.series import recording_series


@fixture(scope="module")
def flight():
    return mavdem.read_flight(FLIGHT)


@fixture(scope="module")
def learned(flight):
    return mavdem.learn(
        flight[:250], mavdem.Settings(order=2, d=2, window=9, parameter_precision=1.0)
    )


@mark.slow
def test_a_frame_has_the_columns_of_the_csv_file(flight):
    frame = flight.to_pandas()
    table = columns(flight)
    assert frame.index.name == "time_s" and list(frame.columns) == list(table)[1:]
    assert_array_equal(frame.index, flight.time)
    assert_array_equal(frame["roll_rate_rad_s"], flight.outputs[:, 1])
    assert frame.attrs["provenance"] == flight.provenance


@mark.slow
def test_a_dataset_has_what_else_a_flight_has():
    time = np.arange(4) * 0.1
    setpoint = np.array([np.nan, 1, 1, 2])
    flight = mavdem.Flight(time, time, time, setpoints=setpoint, effect_directions=[1.0])
    data = flight.to_xarray()
    assert_array_equal(data.setpoints[:, 0], setpoint)
    assert_array_equal(data.effect_directions, [1.0])
    assert data.outputs.dims == ("time", "output") and data.time.attrs["units"] == "s"
    assert data.attrs["dt"] == flight.dt


@mark.slow
def test_a_system_has_the_names_and_the_matrices_of_the_model(learned):
    system = learned.to_control(model="dem")
    assert system.input_labels[0] == "motor_1_us" and system.output_labels == [
        "roll_rad",
        "roll_rate_rad_s",
    ]
    assert system.state_labels == system.output_labels and system.isctime(strict=True)
    model = learned.model
    for matrix, expected in ((system.A, model.A), (system.B, model.B), (system.C, model.C)):
        assert_array_equal(matrix, expected)


IDENTIFIABLE = partial_record(Physical, status={"effect": Status.REPORTED})


@mark.parametrize(
    "physical, names, code",
    [
        (None, ("roll", "roll rate"), NoPlant.NO_PLANT),
        (IDENTIFIABLE, ("roll", "roll rate", "pitch"), NoPlant.TOO_MANY_OUTPUTS),
    ],
)
def test_a_model_without_a_plant_says_why(physical, names, code):
    record = partial_record(Record, output_names=names)
    model = partial_record(Learned, physical=physical, physical_reason=prose("Why."), record=record)
    assert refused(identified_parameters, model).code is code


@mark.slow
def test_the_physical_plant_responds_as_the_vehicle_is_simulated(learned):
    """The exported plant and the learned model respond to the same motor commands in the same way."""
    # At the top of the file the import, of Matplotlib too, would take every worker of the tests half a second.
    import control

    warning_text = "^Poorly known of this plant: effect biased, damping biased, lag biased"
    with warns(UserWarning, match=warning_text) as caught:
        plant = learned.to_control()
    assert caught[0].filename == __file__
    trim = learned.record.inputs.mean(axis=0)
    states = ["delay_1", "delay_2", "roll_rad", "roll_rate_rad_s", "motors_torque"]
    assert plant.state_labels == states and plant.name == "mavdem physical model"
    assert plant.delay == learned.physical.delay
    time = np.arange(61) * learned.dt
    steered = np.outer(20 * np.sin(2 * np.pi * time) ** 2, learned.record.effect_directions)
    expected = learned.simulate(trim + steered[1:]) - learned.simulate(trim + 0 * steered[1:])
    response = control.forced_response(plant, time, steered.T)
    size = abs(expected).max(axis=0)
    assert_allclose(response.outputs[:, 1:].T / size, expected / size, atol=4e-3)
    assert len({abs(draw(2j * np.pi))[1, 0] for draw in plant.draws}) == len(plant.draws)


@mark.slow
def test_hidden_states_and_arrays_without_names_are_numbered():
    learned = mavdem.learn(
        simulated(lag=0.05)[:200], mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0)
    )
    system = learned.to_control(model="dem")
    assert system.state_labels == ["output_1", "output_2", "hidden_1"]
    assert system.input_labels[-1] == "input_4"


LAYOUTS = Path(__file__).parents[2] / "docs" / "layouts"


def read(path):
    """Times, s, and columns by topic."""
    rows = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            body = json.loads(message.data)
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
            described = json.loads(schema.data)
            assert described["type"] == "object" and set(described["properties"]) == set(body)
            rows.setdefault(channel.topic, []).append((message.log_time, body))
    return {
        topic: (
            np.array([time for time, _ in each]) / 1e9,
            {
                name: np.array([body[name] for _, body in each], dtype=np.float64)
                for name in each[0][1]
            },
        )
        for topic, each in rows.items()
    }


@fixture(scope="module")
def result(flight):
    """Training data, test data, model and forecasts."""
    train = flight[:300]
    test = flight[300:350]
    learned = mavdem.learn(train, mavdem.Settings.paper())
    return train, test, learned, held_out_test(train, test, learned)


@mark.slow
def test_what_was_learned_stands_beside_it(tmp_path, result):
    """The exported recording has the flight, the forecasts in held-out windows, and the free energy of the model."""
    train, test, learned, held_out = result
    write_channels(tmp_path / "flight.mcap", [train], learned, held_out)
    series = read(tmp_path / "flight.mcap")
    assert list(series["flight/outputs"][1]) == ["roll", "roll_rate"]
    assert list(series["flight/inputs"][1]) == ["motor_1", "motor_2", "motor_3", "motor_4"]
    for topic, (time, _, values) in recording_series([train], learned, held_out).items():
        assert np.allclose(series[topic][0], time, atol=1e-9), topic
        assert np.array_equal(np.column_stack(list(series[topic][1].values())), values), topic
    assert_array_equal(series["held_out/measured"][0], test.time)
    action = series["learned/free_energy_action"][1]["free_energy_action"]
    assert action[-1] == approx(learned.free_energy[-1])
    terms = series["learned/free_energy_terms"][1]
    assert sum(np.sum(values) for values in terms.values()) == approx(action[-1])
    with raises(ValueError, match="300 samples"):
        write_channels(tmp_path / "other.mcap", [train[:299]], learned)
    assert [path.name for path in tmp_path.iterdir()] == ["flight.mcap"]


def test_names_are_kept_apart_and_no_time_is_before_0(tmp_path):
    time = np.arange(10) * 0.1
    values = np.arange(20.0).reshape(10, 2)
    flight = Flight(time, values, values, input_names=("u (left)", "u (right)"))
    write_channels(tmp_path / "named.mcap", [flight])
    assert list(read(tmp_path / "named.mcap")["flight/inputs"][1]) == ["u_1", "u_2"]
    with raises(ValueError, match="negative"):
        write_channels(tmp_path / "early.mcap", [Flight(time - 1, values, values)])


@mark.slow
def test_the_layouts_plot_what_there_is(result, tmp_path):
    """Every field that the layouts for PlotJuggler and Foxglove plot is in the exported recording."""
    train, _, learned, held_out = result
    write_channels(tmp_path / "flight.mcap", [train], learned, held_out)
    fields = {
        f"{topic}/{field}"
        for topic, (_, columns) in read(tmp_path / "flight.mcap").items()
        for field in columns
    }
    curves = {
        curve.attrib["name"]
        for curve in ElementTree.parse(LAYOUTS / "plotjuggler.xml").iter("curve")
    }
    panels = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"].values()
    paths = {path["value"].split(".@")[0] for panel in panels for path in panel["paths"]}
    plotted_paths = {path.replace(".", "/") for path in paths}
    assert len(curves) >= 10 and len(paths) >= 10
    # The torque of the wind is not identifiable in this flight.
    assert curves | plotted_paths == (curves | plotted_paths) & fields | {
        "learned/wind_torque/torque"
    }
