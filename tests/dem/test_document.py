"""Documents of settings and of learned models: both ways, and what is no such document."""

import json
import pickle
from dataclasses import replace
from math import e

import numpy as np
from command_line import strict_json
from numpy.testing import assert_array_equal
from pytest import approx, fixture, mark, raises
from simulated import simulated

from mavdem import Learned, Settings, learn
from mavdem.dem import Gaussian
from mavdem.dem.record import LABEL_FIELDS
from mavdem.dem.settings import CompleteSettings
from mavdem.document_heading import document_heading

FLIGHT = simulated(wind=0.5)


@fixture(scope="module")
def document():
    return learn(FLIGHT[:200], Settings(order=2, window=3, parameter_precision=1.0)).to_json()


@mark.slow
@mark.parametrize("settings", [Settings(), Settings.paper(), Settings(order=4)])
def test_json_both_ways_keeps_every_forecast(settings):
    """A model that was written as JSON and read again gives exactly the same results."""
    learned = learn(FLIGHT[:700], settings)
    text = learned.to_json()
    strict_json(text)
    restored = Learned.from_json(text)
    assert restored.to_json() == text
    for result_of in (
        lambda model: model.predict(50),
        lambda model: model.forecast(FLIGHT[700:].inputs),
        lambda model: model.one_step(),
        lambda model: model.process_noise()[1],
        lambda model: model.model_interval().B,
    ):
        assert_array_equal(result_of(restored), result_of(learned))


@mark.parametrize("text", ["5", "null", "{}", '{"settings": {}}', "not JSON"])
def test_something_else_is_no_learned_model(text):
    with raises(ValueError, match="^not the document of a learned model: "):
        Learned.from_json(text)


@mark.slow
def test_every_field_of_a_document_is_needed_and_checked(document):
    """Each field of the JSON is removed, or replaced by something of another type or length."""
    values = json.loads(document)
    # Documents of the same version that were written before F(t) was kept as a function are read all the same.
    optional = {"sample_free_energy"}
    for name in values.keys() - document_heading("model", 2, {}).keys() - optional:
        missing = {key: value for key, value in values.items() if key != name}
        with raises(ValueError, match=f"^not the document of a learned model: {name} is missing"):
            Learned.from_json(json.dumps(missing))
    record_values = values["record"]
    record_of_earlier_version = {
        name: record_values[name] for name in record_values.keys() - {"parameters", "setpoints"}
    }
    restored = Learned.from_json(json.dumps({**values, "record": record_of_earlier_version}))
    assert len(restored.record) == len(record_values["inputs"])
    for name in ("theta_covariance", "known", "state_map", "theta", "free_energy_of_samples"):
        for junk in (None, "junk", {"a": 1}):
            with raises(ValueError, match="must"):
                Learned.from_json(json.dumps({**values, name: junk}))
    for name, other in {
        "inputs": record_values["inputs"][:-1],
        "outputs": [],
        "lengths": [],
        "effect_directions": [1.0],
    }.items():
        with raises(ValueError, match="must"):
            Learned.from_json(json.dumps({**values, "record": {**record_values, name: other}}))


@mark.slow
def test_what_a_flight_says_of_its_vehicle_is_kept():
    flight = FLIGHT[:500]
    directions = np.ones(flight.inputs.shape[1])
    with_directions = replace(flight, effect_directions=directions)
    learned = learn(with_directions, Settings(order=3, d=2, window=9, parameter_precision=1.0))
    record = Learned.from_json(learned.to_json()).record
    assert_array_equal(record.effect_directions, directions)
    assert record.begins == (flight.time[0],)
    assert {name: getattr(record, name) for name in LABEL_FIELDS} == {
        name: getattr(with_directions, name) for name in LABEL_FIELDS
    }


@mark.parametrize(
    "settings",
    [
        Settings(),
        Settings.paper(),
        Settings(prior=Gaussian([1, 2], [[2, 1], [1, 2]]), lambda_z=1),
        Settings(order=np.int64(2), smoothness=np.float32(0.5), input_precision=np.float32(2.0)),
    ],
)
def test_json_both_ways(settings):
    assert Settings.from_json(settings.to_json()) == settings


def test_settings_of_former_versions_are_read():
    assert Settings.from_json('{"learning_rates": null, "p": 1}') == Settings(p=1)


def test_paper_settings_are_those_of_section_v_d():
    """The default settings, and where those of the paper (section V-D) differ from them."""
    usual = {"order": None, "p": 2, "d": None, "window": None, "scaling": "channel"}
    usual |= {"known_inputs": True, "smoothness": None, "correlation": "sampled"}
    usual |= {"prior": "regulated", "parameter_precision": None, "lambda_z": 20, "lambda_w": 3}
    usual |= {"lambda_log_precision": (25, -4.6), "input_precision": 1.6e5, "iterations": 200}
    usual |= {"seed": 0, "horizon": 0.3, "forecasts": "joint"}
    assert Settings().to_dict() == usual
    expected_settings = {
        "order": 2,
        "d": 1,
        "window": 3,
        "scaling": "paper",
        "correlation": "continuous",
    }
    expected_settings |= {"prior": "uniform", "lambda_log_precision": (25, 20), "iterations": 20}
    expected_settings |= {"parameter_precision": approx(e**4), "input_precision": approx(e**16)}
    expected_settings |= {"horizon": None, "forecasts": "plant"}
    assert Settings.paper().to_dict() == usual | expected_settings


@mark.parametrize(
    "name, value",
    [
        ("order", True),
        ("known_inputs", ("yes",)),
        ("window", 2),
        ("smoothness", 0.0),
        ("order", 13),
        ("iterations", 0),
        ("seed", -1),
        ("lambda_w", 101.0),
        ("lambda_w", -101.0),
        ("lambda_z", (1.0, 2.0)),
        ("lambda_log_precision", (1.0, 101.0)),
        ("input_precision", ((1.0, 2.0), (2.0, 1.0))),
    ],
)
def test_a_wrong_value_is_named(name, value):
    """Each setting of the learner is out of its range or of another type, and the error begins with its name."""
    with raises(ValueError, match=f"^{name} must "):
        Settings(**{name: value})


@mark.parametrize(
    "text, said", [("null", "^settings must be an object"), ('{"colour": 1}', "colour")]
)
def test_a_document_of_something_else_is_refused(text, said):
    with raises(ValueError, match=said):
        Settings.from_json(text)


def test_complete_settings_keep_what_was_fixed_and_leave_nothing_open():
    complete = CompleteSettings(window=9, lambda_w=2, order=3, d=2, parameter_precision=1.0)
    assert complete == Settings(order=3, d=2, window=9, parameter_precision=1.0, lambda_w=2)
    assert hash(complete) == hash(Settings.from_dict(complete.to_dict()))
    assert (
        pickle.loads(pickle.dumps(complete))
        == complete
        == CompleteSettings.from_json(complete.to_json())
    )
    assert CompleteSettings.paper() == Settings.paper()
    for name in ("order", "d", "window", "parameter_precision"):
        with raises(ValueError, match=f"^{name} must "):
            replace(CompleteSettings.paper(), **{name: None})
