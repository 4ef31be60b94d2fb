import pickle

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, mark, raises, warns

from mavdem import Flight
from mavdem.plant import physical
from mavdem.unit_errors import ArrayFact, UnitSlip, suspected_unit_error

TIME = 10 + 0.01 * np.arange(6)
INPUTS = np.arange(12.0).reshape(6, 2)
OUTPUTS = np.arange(6.0)


def test_arrays_make_a_flight_and_slicing_gives_one():
    """A flight of plain arrays has a sampling time and default names, which a slice of it keeps."""
    flight = Flight(
        TIME,
        INPUTS,
        OUTPUTS,
        output_names=("roll",),
        output_units=("rad",),
        provenance={"source": "here"},
    )
    assert flight.dt == approx(0.01)
    assert flight.outputs.shape == (6, 1)
    assert (flight.input_names, flight.input_units) == (("input 1", "input 2"), ("", ""))
    sliced = flight[2:4]
    assert isinstance(sliced, Flight)
    assert_array_equal(sliced.inputs, INPUTS[2:4])
    assert (len(sliced), sliced.dt, sliced.output_names, sliced.provenance) == (
        2,
        flight.dt,
        ("roll",),
        {"source": "here"},
    )
    assert sliced.duration == approx(0.02)
    with_directions = Flight(TIME, INPUTS, OUTPUTS, effect_directions=[-1, 1])
    assert_array_equal(with_directions[1:3].effect_directions, [-1, 1])
    assert flight.effect_directions is None


@mark.parametrize(
    "message, arguments",
    {
        "time must be a non-empty": {"time": []},
        "time must increase": {"time": TIME[::-1]},
        "time must be uniform": {"time": np.append(TIME[:-1], TIME[-1] + 0.002)},
        "time must be finite": {"time": np.append(TIME[:-1], np.nan)},
        r"inputs must have shape \(6, columns\)": {"inputs": INPUTS[:-1]},
        "inputs must be real numbers": {"inputs": [["a"]] * 6},
        "outputs must be finite.* 6 values": {"outputs": np.full(6, np.inf)},
        "dt must be positive": {"dt": -1.0},
        "dt must be given": {"time": [0.0], "inputs": [[1.0]], "outputs": [1.0]},
        "inputs must not be masked": {"inputs": np.ma.array(INPUTS, mask=INPUTS > 0)},
        "provenance must be values by name": {"provenance": 1},
        "input_names must be strings in a tuple, one for each of the 2 columns": {
            "input_names": ("one",)
        },
        r"effect_directions must have shape \(2,\)": {"effect_directions": [-1]},
        "setpoints must be finite and at most 1e.100; 1 values": {
            "setpoints": [np.nan] * 5 + [1e200]
        },
    }.items(),
)
def test_what_is_wrong_is_named(arguments, message):
    """Each argument of a flight is wrong in turn, and the error names it."""
    with raises(ValueError, match=message):
        Flight(**{"time": TIME, "inputs": INPUTS, "outputs": OUTPUTS, **arguments})


@mark.parametrize(
    "part, error", [(slice(0, 6, 2), ValueError), (slice(4, 2), ValueError), (3, TypeError)]
)
def test_only_stretches_can_be_cut_out(part, error):
    with raises(error):
        Flight(TIME, INPUTS, OUTPUTS)[part]


def test_setpoints_may_be_missing_at_some_samples_and_are_cut_with_the_flight():
    asked = np.column_stack([np.full(6, np.nan), np.arange(6.0)])
    flight = Flight(
        TIME, INPUTS, OUTPUTS, setpoints=asked, setpoint_names=("roll stick", "roll setpoint")
    )
    assert flight.setpoint_units == ("", "") and Flight(TIME, INPUTS, OUTPUTS).setpoint_names == ()
    assert_array_equal(flight[2:4].setpoints, asked[2:4])
    _, after = Flight.segments(TIME + (TIME > 10.025), INPUTS, OUTPUTS, setpoints=asked)
    assert_array_equal(after.setpoints, asked[3:])


def test_a_flight_its_slices_and_its_copies_cannot_be_changed():
    flight = Flight(TIME, INPUTS, OUTPUTS, provenance={"rates": {}})
    sliced = flight[1:3]
    for one in (flight, sliced):
        with raises(ValueError, match="read-only"):
            one.inputs[0, 0] = 1
    assert_array_equal(pickle.loads(pickle.dumps(flight)).outputs, flight.outputs)
    with raises(TypeError):
        sliced.provenance["rates"]["motors"] = 50.0
    with raises(AttributeError):
        flight.dt = 1.0
    INPUTS[0, 0] += 1
    assert flight.inputs[0, 0] == INPUTS[0, 0] - 1


@mark.parametrize(
    "time, outputs, slip",
    [
        (1, np.degrees([1, 1]), UnitSlip.BOTH_IN_DEGREES),
        (1, [57.3, 1], UnitSlip.ANGLE_IN_DEGREES),
        (1, [1, 57.3], UnitSlip.RATE_IN_DEGREES),
        (1e3, (1, 1), UnitSlip.TIME_IN_MILLISECONDS),
        (1e6, (1, 1), UnitSlip.TIME_IN_MICROSECONDS),
    ],
)
def test_a_slip_of_units_is_said_with_its_likely_cause(time, outputs, slip, recwarn):
    """Effects would be 57 times too large, without a word. The flight is one of 6°, with noise on both outputs."""
    noise = default_rng(3)
    t = np.arange(800) / 100
    turning = np.column_stack([0.1 * np.sin(6 * t), 0.6 * np.cos(6 * t)]) + noise.normal(
        0, (0.001, 0.02), (800, 2)
    )
    Flight(t, np.zeros((800, 4)), turning)
    assert not recwarn.list
    with warns(UserWarning) as warnings:
        flight = Flight(time * t, np.zeros((800, 4)), np.array(outputs) * turning)
    fact = suspected_unit_error(flight.outputs, flight.dt)
    assert (fact.code, fact.figures["slip"]) == (ArrayFact.UNIT_SLIP, slip)
    assert str(warnings[0].message) == str(fact)
    assert fact == physical(flight).reason
