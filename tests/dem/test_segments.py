"""The training data: nothing looks across a gap between segments, and inputs that are no motors are named."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import DT, GAIN, RATE, simulated

from mavdem import Flight, Settings, evaluate, learn
from mavdem.dem.record import Record, folds

CLEAN = Settings(order=2, parameter_precision=0.01, window=5)


def gapped(cut=400, missing=60):
    """A flight, and the two segments that are left of it when a stretch is lost."""
    flight = simulated()
    return flight, [flight[:cut], flight[cut + missing : 700]]


def test_a_gap_does_no_harm():
    flight, segments = gapped()
    learned = learn(segments, CLEAN)
    np.testing.assert_allclose(learned.model.A[1], [-9, -RATE], rtol=0.1)
    np.testing.assert_allclose(learned.model.B[1], GAIN, rtol=0.1)
    forecast = learned.forecast(flight.inputs[700:])
    assert evaluate.relative_mspe(flight[:700], flight[700:], forecast) < 0.02


def test_predictions_and_noise_belong_to_their_segments():
    _, segments = gapped()
    learned = learn(segments, CLEAN)
    ahead = learned.one_step()
    assert ahead.shape == (640, 2)
    np.testing.assert_array_equal(ahead[[0, 400]], np.tile(learned.model.output_trim, (2, 1)))
    places, noise = learned.process_noise()
    np.testing.assert_array_equal(places, np.r_[2:398, 402:638])
    assert noise.shape == (len(places), 2)
    # What is predicted in the second segment depends neither on the first nor on later samples.
    record = learned.record
    outputs = record.outputs.copy()
    outputs[:400] += 1.0
    outputs[500:] += 1.0
    changed = replace(learned, record=replace(record, outputs=outputs)).one_step()
    np.testing.assert_array_equal(changed[400:501], ahead[400:501])
    assert np.abs(changed[501:] - ahead[501:]).max() > 0.1


def test_halves_cut_the_segment_in_the_middle():
    record = Record(np.zeros((10, 1)), np.arange(10.0)[:, None], DT, (3, 4, 3))
    first, second = record.halves()
    assert (first.lengths, second.lengths) == ((3, 2), (2, 3))
    np.testing.assert_array_equal(np.vstack([first.outputs, second.outputs]), record.outputs)
    assert (record.windows(3), record.windows(4), record.longest) == (1 + 2 + 1, 1, 4)


def test_a_flight_is_cut_at_its_gaps():
    whole, kept = simulated(), np.r_[0:300, 330:331, 400:700]
    segments = Flight.segments(
        whole.time[kept] + 1e-6, whole.inputs[kept], whole.outputs[kept], output_names=("a", "b")
    )
    assert [len(segment) for segment in segments] == [300, 300]
    assert segments[1].time[0] == pytest.approx(4.0) and segments[1].output_names == ("a", "b")
    assert segments[0].dt == segments[1].dt == pytest.approx(DT)


@pytest.mark.parametrize("time", [[0.0, 1.0, 1.0], [2.0, 1.0, 0.0], [0.0]])
def test_time_that_does_not_increase_is_refused(time):
    column = np.zeros(len(time))
    with pytest.raises(ValueError, match="^time must increase"):
        Flight.segments(time, column, column)


@pytest.mark.parametrize(
    ("segments", "named"),
    [
        (lambda flight: [], "^train must hold"),
        (
            lambda flight: [flight[:300], Flight(0.02 * np.arange(300), flight.inputs[:300], flight.outputs[:300])],
            "^dt",
        ),
        (lambda flight: [flight[:300], Flight(flight.time, flight.inputs[:, :3], flight.outputs)], "^inputs"),
        (lambda flight: [flight[:300], Flight(flight.time, flight.inputs, flight.outputs[:, :1])], "^outputs"),
        (lambda flight: [flight[:300], None], "^train must be a Flight"),
        (lambda flight: {"dt": 1}, "^train must be a Flight"),
        (lambda flight: [flight[i : i + 6] for i in range(0, 600, 6)], "^train must be longer"),
    ],
)
def test_segments_that_do_not_belong_together_are_named(segments, named):
    with pytest.raises(ValueError, match=named):
        learn(segments(simulated()), CLEAN)


FLIGHT = simulated(wind=1.0)[:700]


def cautions(inputs, names=()):
    return Record(inputs, FLIGHT.outputs, FLIGHT.dt, (len(inputs),), input_names=names).input_cautions


def test_a_motor_that_hardly_moves_is_named():
    assert cautions(FLIGHT.inputs) == ()
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500 + 0.001 * (inputs[:, 2] - 1500)
    (caution,) = cautions(inputs, ("M1", "M2", "M3", "M4"))
    assert caution.startswith("M3 hardly moves")


def test_demands_are_not_motors_and_learning_says_so():
    inputs = FLIGHT.inputs - FLIGHT.inputs.mean(axis=0)
    (caution,) = cautions(inputs)
    assert caution.startswith("input 1 has both signs")
    assert any("has both signs" in caution for caution in learn(Flight(FLIGHT.time, inputs, FLIGHT.outputs)).cautions)


def test_motors_that_never_move_are_refused_with_what_to_do():
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500
    with pytest.raises(ValueError, match="^inputs column 2 must vary: .* Leave out a motor that is missing"):
        learn(Record(inputs, FLIGHT.outputs, FLIGHT.dt, (700,)))
    with pytest.raises(ValueError, match="^inputs column 0 must vary: constant samples determine no model$"):
        learn(Record(np.full_like(inputs, 1500.0), FLIGHT.outputs, FLIGHT.dt, (700,)))


def test_folds_are_parts_of_equal_length_in_pieces_of_one_segment():
    parts = folds([100, 7, 60], 4)
    assert [sum(stop - start for _, start, stop in part) for part in parts] == [41, 42, 42, 42]
    assert parts[2] == [(0, 83, 100), (1, 0, 7), (2, 0, 18)]
