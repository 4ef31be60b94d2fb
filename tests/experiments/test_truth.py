"""Estimates beside the truth of a simulated flight, and no other flight's; their numbers are in tests/golden."""

from dataclasses import replace

import numpy as np
from partial_records import partial_record
from pytest import fixture, mark, raises
from refusals import unreadable

from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.experiments.paper.flights import settled_hover
from mavdem.experiments.truth import compare_with_truth, read_truth, read_truth_of_flight
from mavdem.facts import Fact
from mavdem.facts.forecasts import ForecastFact
from mavdem.facts.identifiability import Status
from mavdem.plant import physical
from mavdem.plant.wind_torque import estimate_wind_torque
from mavdem.report.truth import truth_blocks
from sitl_scenarios.files import load
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import write_truth

pytestmark = mark.slow
MOTORS = (
    "motor 1 (front right)",
    "motor 2 (rear left)",
    "motor 3 (front left)",
    "motor 4 (rear right)",
)


@fixture(scope="module")
def scenario():
    return load("iris_multisine").model_copy(update={"duration": 30.0})


@fixture(scope="module")
def motion(scenario):
    return fly(scenario)


@fixture(scope="module")
def flight(scenario, motion):
    flown = settled_hover(scenario, motion)
    return replace(
        flown,
        outputs=flown.outputs[:, 2:],
        input_names=MOTORS,
        input_units=("µs",) * 4,
        output_names=("roll", "roll rate"),
        output_units=("rad", "rad/s"),
    )


@fixture(scope="module")
def learned(flight):
    record = Record.from_flights(flight)
    parameters_by_name = physical(record)
    return partial_record(
        Learned,
        record=record,
        physical=parameters_by_name,
        wind_torque=estimate_wind_torque(parameters_by_name, record),
    )


@fixture(scope="module")
def path(scenario, motion, tmp_path_factory):
    written = tmp_path_factory.mktemp("truth") / "flight.truth.npz"
    write_truth(written, scenario, motion)
    return written


def compared(learned, path, *flights):
    return compare_with_truth(learned, flights, read_truth_of_flight(flights, path))


def test_in_segments_it_is_the_same(learned, flight, path):
    whole = compared(learned, path, flight)
    halved = compared(learned, path, flight[:700], flight[700:])
    assert (
        halved.parameters == whole.parameters and halved.wind.correlation == whole.wind.correlation
    )
    with raises(ValueError, match="what the model was trained on"):
        compared(learned, path, flight[:700])


def test_an_interval_that_misses_and_one_that_is_not_there_are_told_apart(learned, flight, path):
    """The damping is far from the truth, and the motor lag not identifiable."""
    read = learned.physical
    physical_with_wrong_damping = read._replace(
        damping=9.0, status=read.status | {"lag": Status.NOT_IDENTIFIABLE, "damping": Status.BIASED}
    )
    changed = partial_record(
        Learned,
        record=learned.record,
        physical=physical_with_wrong_damping,
        wind_torque=learned.wind_torque,
    )
    parameters_by_name = {
        parameter.name: parameter for parameter in compared(changed, path, flight).parameters
    }
    assert (
        parameters_by_name["damping"].inside is False
        and parameters_by_name["lag of the motors"].inside is None
    )
    table = truth_blocks(compared(changed, path, flight))[1]
    rows = {row[0]: row[1:] for row in table.rows}
    assert (
        rows["rate damping"][-1] == "no, biased"
        and rows["motor time constant"][-1] == "not identifiable"
    )


def test_a_demand_has_no_effect_of_motors(learned, flight, path):
    demand = replace(
        flight, inputs=flight.inputs[:, :1], input_names=("demand",), input_units=("",)
    )
    parameters_by_name = compared(learned, path, demand)
    assert [parameter.name for parameter in parameters_by_name.parameters] == [
        "damping",
        "lag of the motors",
        "delay",
    ]


def test_while_a_motor_is_weak_its_weaker_effect_is_the_truth(
    learned, flight, motion, path, tmp_path
):
    """The simulator's file of the truth has other effects while a motor is weak, from 20 s on."""
    weak = dict(np.load(path)) | {
        "weak": motion.time > 20.0,
        "roll_effect_weak": np.array([1.0, 2.0, 3.0, 4.0]),
    }
    np.savez(tmp_path / "weak.npz", **weak)
    late = flight[round((20.5 - flight.time[0]) / flight.dt) :]
    model_of_late_flight = partial_record(
        Learned, record=Record.from_flights(late), physical=learned.physical, wind_torque=None
    )
    effects = [
        parameter.truth
        for parameter in compared(model_of_late_flight, tmp_path / "weak.npz", late).parameters[:4]
    ]
    assert effects == [1.0, 2.0, 3.0, 4.0]


def test_the_truth_of_another_flight_is_refused(flight, motion, path, tmp_path):
    other = dict(np.load(path)) | {"known_rates": motion.known_rates / 1.5}
    np.savez(tmp_path / "other.npz", **other)
    fact = unreadable(read_truth_of_flight, [flight], tmp_path / "other.npz")
    assert (fact.code, fact.subject) == (ForecastFact.TRUTH_OF_ANOTHER_FLIGHT, "roll rate")
    assert (fact.time, fact.end_time) == (flight.time[0], flight.time[-1])
    assert (
        unreadable(read_truth_of_flight, [replace(flight, time=flight.time + 100.0)], path).code
        is fact.code
    )


@mark.parametrize(
    "change",
    [
        lambda parts: parts.pop("pitch_effect"),
        lambda parts: parts.update(time=parts["time"][1:]),
        lambda parts: parts.update(weak=parts["weak"][:1]),
        lambda parts: parts.update(pitch_effect_weak=parts["pitch_effect"][1:]),
        lambda parts: parts.update(time=np.array([{}], object)),
    ],
    ids=["missing", "shorter", "single", "other", "pickle"],
)
def test_what_is_no_truth_file_is_refused_in_a_sentence(change, path, tmp_path):
    """The file lacks a series, has series of other lengths, or contains pickled objects."""
    parts = dict(np.load(path))
    change(parts)
    np.savez(tmp_path / "odd.npz", **parts)
    fact = unreadable(read_truth, tmp_path / "odd.npz", "pitch")
    assert fact == Fact(ForecastFact.NO_TRUTH_FILE, name="odd.npz", error="")


def test_files_of_other_kinds_and_none_are_refused(tmp_path):
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04" + bytes(50))
    np.save(tmp_path / "array.npy", np.zeros(3))
    for name in ("text.npz", "cut.npz", "array.npy"):
        fact = unreadable(read_truth, tmp_path / name, "roll")
        assert fact == Fact(ForecastFact.NO_TRUTH_FILE, name=name, error="")
    for name in ("nowhere.npz", "."):
        assert unreadable(read_truth, tmp_path / name, "roll").figures["error"]
