"""Flights as pandas and xarray objects, and models as systems of python-control."""

from pathlib import Path

import control
import numpy as np
import pytest
from simulated import simulated

import mavdem
from mavdem.export.conversion import columns

LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"


@pytest.fixture(scope="module")
def flight():
    return mavdem.read_flight(LOG)


@pytest.fixture(scope="module")
def learned(flight):
    return mavdem.learn(flight[:250], mavdem.Settings(order=2, d=2, window=9, parameter_precision=1.0))


def test_a_frame_has_the_columns_of_the_csv_file(flight):
    frame = flight.to_pandas()
    table = columns(flight)
    assert frame.index.name == "time_s" and list(frame.columns) == list(table)[1:]
    np.testing.assert_array_equal(frame.index, flight.time)
    np.testing.assert_array_equal(frame["roll_rate_rad_s"], flight.outputs[:, 1])
    assert frame.attrs["provenance"] == flight.provenance


@pytest.mark.slow
def test_a_dataset_has_what_else_a_flight_has():
    time = np.arange(4) * 0.1
    asked = np.array([np.nan, 1, 1, 2])
    flight = mavdem.Flight(time, time, time, setpoints=asked, effect_directions=[1.0])
    data = flight.to_xarray()
    np.testing.assert_array_equal(data.setpoints[:, 0], asked)
    np.testing.assert_array_equal(data.effect_directions, [1.0])
    assert data.outputs.dims == ("time", "output") and data.time.attrs["units"] == "s"
    assert data.attrs["dt"] == flight.dt


def test_a_system_has_the_names_and_the_matrices_of_the_model(learned):
    system = learned.to_control(model="dem")
    assert system.input_labels[0] == "motor_1_us" and system.output_labels == ["roll_rad", "roll_rate_rad_s"]
    assert system.state_labels == system.output_labels and system.isctime(strict=True)
    for own, expected in zip((system.A, system.B, system.C), learned.model, strict=False):
        np.testing.assert_array_equal(own, expected)


@pytest.mark.filterwarnings("ignore:Of this plant")
def test_the_physical_plant_responds_as_the_vehicle_is_simulated_and_is_refused_where_unknown(learned, monkeypatch):
    plant, trim = learned.to_control(), learned.record.inputs.mean(axis=0)
    assert plant.name == "mavdem physical model" and plant.delay == learned.physical.delay
    time = np.arange(61) * learned.dt
    steered = np.outer(20 * np.sin(2 * np.pi * time) ** 2, learned.record.effect_directions)
    expected = learned.simulate(trim + steered[1:]) - learned.simulate(trim + 0 * steered[1:])
    response = control.forced_response(plant, time, steered.T)
    np.testing.assert_allclose(response.outputs[:, 1:].T, expected, atol=2e-3 * np.abs(expected[:, 1]).max())
    assert len({abs(one(2j * np.pi))[1, 0] for one in plant.draws}) == len(plant.draws)
    status = dict.fromkeys(learned.physical.status, "not identifiable")
    monkeypatch.setattr(mavdem.Learned, "physical", learned.physical._replace(status=status))
    with pytest.raises(ValueError, match=r"There is no physical plant. The motors' effect is not identifiable"):
        learned.to_control()


def test_hidden_states_and_arrays_without_names_are_numbered():
    learned = mavdem.learn(simulated(lag=0.05)[:200], mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0))
    system = learned.to_control(model="dem")
    assert system.state_labels == ["output_1", "output_2", "hidden_1"]
    assert system.input_labels[-1] == "input_4"
