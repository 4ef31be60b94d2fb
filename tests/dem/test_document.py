"""The document of a learnt model, against one that version 0.1 wrote."""

import json
from pathlib import Path

import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, Learned, Settings, learn
from mavdem.dem.record import LABELS

TEXT = (Path(__file__).parent / "data" / "model_0_1.json").read_text()
FLIGHT = simulated(wind=0.5, lag=0.05)
AHEAD = np.tile(1500 + 10 * np.arange(4.0), (5, 1))


def test_a_document_of_version_0_1_is_loaded_and_forecasts_what_it_did():
    learned = Learned.from_json(TEXT)
    np.testing.assert_allclose(learned.forecast(AHEAD)[-1], [0.352296151981, -0.037690559101], rtol=1e-7)
    np.testing.assert_allclose(learned.forecast_band(AHEAD)[-1], [0.002428588649, 0.057036846853], rtol=1e-7)
    np.testing.assert_allclose(learned.one_step()[-1], [0.352533860746, 0.034202405081], rtol=1e-7)


def test_nothing_of_it_is_lost():
    before, now = json.loads(TEXT), json.loads(Learned.from_json(TEXT).to_json())
    # Since then there is one choice, in the settings, and the forecasts it was tried on have a name of their own.
    before["training_forecasts"] = before.pop("unseen")
    del before["candidates"]
    # Since then what only the physical parameters use is kept; of this flight there is none.
    assert now.pop("of_vehicle") is None
    assert set(now.pop("labels")) == {*LABELS, "begins"}
    # Since then forecasts may take the motors for measurements; those of this model did not.
    before["settings"]["closed_loop"] = False
    # Since then its numbers are those of the innovation form.
    assert {**before, "predictor": None} == {**now, "predictor": None}
    again = Learned.from_json(TEXT).to_json()
    assert Learned.from_json(again).to_json() == again


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("model", "A"), [[1.0]], r"^model.B must be of shape \(1, 4\), not \(2, 4\)"),
        (("model", "offset"), ["one", 2.0], r"^model.offset must be numbers of shape \(n\)"),
        (("settled",), "yes", "^settled must be a valid boolean, not 'yes'"),
        (("settings", "window"), None, "^window must be a whole number"),
        (("scaling", "output_scale"), [1.0, 0.0], "^scaling.output_scale must be positive"),
        (("segments",), [100, 61], "must have T = 161, not 160"),
    ],
)
def test_what_does_not_fit_is_named(path, value, message):
    values = json.loads(TEXT)
    inner = values
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(ValueError, match=message):
        Learned.from_json(json.dumps(values))


def test_what_only_physical_parameters_use_is_kept():
    flight = FLIGHT[:500]
    setpoints = np.sin(flight.time)[:, None]
    setpoints[:9] = np.nan
    further = {"setpoints": setpoints, "setpoint_names": ("roll stick",)}
    directions = np.ones(flight.inputs.shape[1])
    known = Flight(flight.time, flight.inputs, flight.outputs, effect_directions=directions, **further)
    learned = learn(known, Settings(order=3, d=2, window=9, parameter_precision=1.0))
    record = Learned.from_json(learned.to_json()).record
    np.testing.assert_array_equal(record.setpoints, setpoints)
    np.testing.assert_array_equal(record.effect_directions, directions)
    assert record.setpoint_names == ("roll stick",)
    assert record.begins == (flight.time[0],)
    assert {name: getattr(record, name) for name in LABELS} == {name: getattr(known, name) for name in LABELS}
