import pickle
from dataclasses import replace
from math import e

import numpy as np
import pytest

from mavdem import Settings
from mavdem.dem import Gaussian
from mavdem.dem.settings import CompleteSettings


@pytest.mark.parametrize(
    "settings",
    [
        Settings(),
        Settings.paper(),
        Settings(order=3, smoothness=0.02, window=9),
        Settings(prior=Gaussian([1, 2], [[2, 1], [1, 2]]), lambda_z=[1, 2], noise_groups=([0, 1], [0])),
        Settings(prior=Gaussian([1], 1), known_inputs=[True, False], learning_rates=(None, 0.5, None)),
        Settings(order=np.int64(2), smoothness=np.float32(0.5), input_precision=np.array([1.0, 2.0])),
    ],
)
def test_json_both_ways(settings):
    assert Settings.from_json(settings.to_json()) == settings


def test_paper_settings_are_those_of_section_v_d():
    paper = Settings.paper()
    assert (paper.order, paper.p, paper.d, paper.smoothness) == (2, 2, 1, None)
    assert paper.parameter_precision == pytest.approx(e**4)
    assert (paper.lambda_z, paper.lambda_w, paper.lambda_log_precision) == (20, 3, (25, 20))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("order", 0),
        ("order", 2.5),
        ("order", True),
        ("seed", "one"),
        ("lambda_z", float("nan")),
        ("noise_groups", ((0, 2), (0,))),
        ("noise_groups", ((0,), ())),
        ("known_inputs", False),
        ("known_inputs", ("yes",)),
        ("input_precision", (1.0, -1.0)),
        ("learning_rates", (0.0, None, None)),
        ("smoothness", "learn"),
        ("p", -1),
        ("d", -1),
        ("window", 2),
        ("smoothness", 0.0),
        ("correlation", "sampled"),
        ("scaling", "flat"),
        ("prior", "flat"),
        ("parameter_precision", -1.0),
        ("lambda_z", (1.0, 2.0)),
        ("lambda_log_precision", (1.0, 101.0)),
        ("lambda_log_precision", (1.0, (2.0, 3.0))),
        ("forecasts", True),
        ("input_precision", ((1.0, 2.0), (2.0, 1.0))),
        ("input_precision", float("nan")),
        ("iterations", 0),
    ],
)
def test_a_wrong_value_is_named(name, value):
    with pytest.raises(ValueError, match=f"^{name} must "):
        Settings(**{"prior": "uniform" if name == "correlation" else "regulated", name: value})


@pytest.mark.parametrize("text", ["5", "[]", "null"])
def test_a_document_of_something_else_is_refused(text):
    with pytest.raises(ValueError, match="^settings must be an object"):
        Settings.from_json(text)


def test_an_unknown_setting_is_named():
    with pytest.raises(ValueError, match="not a setting: colour"):
        Settings.from_json('{"colour": 1}')


def test_complete_settings_keep_what_was_fixed_and_leave_nothing_open():
    complete = Settings(window=9, lambda_w=2).completed(order=3, d=2, window=11, parameter_precision=1.0)
    assert (complete.order, complete.window, complete.lambda_w, complete.smoothness) == (3, 9, 2.0, None)
    assert complete == Settings(order=3, d=2, window=9, parameter_precision=1.0, lambda_w=2)
    assert hash(complete) == hash(Settings.from_dict(complete.to_dict()))
    assert pickle.loads(pickle.dumps(complete)) == complete == CompleteSettings.from_json(complete.to_json())
    assert CompleteSettings.paper() == Settings.paper()


@pytest.mark.parametrize(
    ("name", "value"),
    [("order", None), ("d", None), ("window", None), ("parameter_precision", None)],
)
def test_complete_settings_refuse_what_is_open(name, value):
    with pytest.raises(ValueError, match=f"^{name} must "):
        replace(CompleteSettings.paper(), **{name: value})
