"""Flights as pandas and xarray objects, and models as systems of python-control."""

from pathlib import Path

import control
import numpy as np
import pytest
from simulated import simulated

import mavdem
from mavdem.dem.engine.model import discretize, recursion
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


def test_a_system_has_the_names_and_the_poles_of_the_model(learned):
    system = learned.to_control()
    assert system.input_labels[0] == "motor_1_us" and system.output_labels == ["roll_rad", "roll_rate_rad_s"]
    assert system.state_labels == system.output_labels and system.isctime(strict=True)
    np.testing.assert_allclose(np.sort_complex(system.poles()), np.sort_complex(np.linalg.eigvals(learned.model.A)))


def test_a_system_responds_as_the_model_does(learned, flight):
    ahead = flight[250:300]
    inputs = ahead.inputs - learned.model.input_trim
    system = learned.to_control()
    response = control.forced_response(system, np.arange(50) * flight.dt, inputs.T, [0.1, 0.2])
    step = discretize(learned.model.A, learned.model.B, flight.dt)
    pushes = inputs[:-1] @ step.input_now.T + inputs[1:] @ step.input_next.T
    states = recursion(step.state, pushes, np.array([0.1, 0.2]))
    np.testing.assert_allclose(response.outputs[:, 1:].T, states @ learned.model.C.T, rtol=1e-6, atol=1e-9)


def test_hidden_states_and_arrays_without_names_are_numbered():
    learned = mavdem.learn(simulated(lag=0.05)[:200], mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0))
    system = learned.to_control()
    assert system.state_labels == ["output_1", "output_2", "hidden_1"]
    assert system.input_labels[-1] == "input_4"
