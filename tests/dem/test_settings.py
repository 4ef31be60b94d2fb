import pickle
from dataclasses import replace
from math import e

import numpy as np
import pytest

from mavdem import Settings
from mavdem.dem import Gaussian
from mavdem.dem.settings import FORMER, CompleteSettings


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
        ("order", True),
        ("seed", "one"),
        ("lambda_z", float("nan")),
        ("noise_groups", ((0, 2), (0,))),
        ("known_inputs", ("yes",)),
        ("input_precision", (1.0, -1.0)),
        ("learning_rates", (0.0, None, None)),
        ("p", -1),
        ("window", 2),
        ("smoothness", 0.0),
        ("correlation", "sampled"),
        ("scaling", "flat"),
        ("prior", "flat"),
        ("lambda_z", (1.0, 2.0)),
        ("lambda_log_precision", (1.0, 101.0)),
        ("forecasts", True),
        ("input_precision", ((1.0, 2.0), (2.0, 1.0))),
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


@pytest.mark.parametrize(
    ("former", "now"),
    [
        ({"lambda_z_precision": 1.0, "lambda_w_precision": 0.01}, {"lambda_log_precision": (0.0, np.log(0.01))}),
        ({"lambda_w_precision": e}, {"lambda_log_precision": (25.0, 1.0)}),
        ({"last_derivative_zero": True}, {"correlation": "continuous"}),
        ({"closed_loop": False}, {"forecasts": "shrunk"}),
        ({"shrink_forecasts": False, "closed_loop": False, "state_rate": None}, {"forecasts": "model"}),
    ],
)
def test_names_of_former_versions_keep_working(former, now):
    assert Settings(**former) == Settings.from_dict(former) == Settings(**now) == replace(Settings(), **former)


@pytest.mark.parametrize("name", FORMER)
def test_a_setting_that_is_no_more_names_what_replaces_it(name):
    with pytest.raises(ValueError, match=f"^{name} is no setting any more: {FORMER[name]}"):
        Settings(**{name: 1.0})


def test_complete_settings_keep_what_was_fixed_and_leave_nothing_open():
    complete = Settings(window=9, lambda_w=2).completed(order=3, d=2, window=11, parameter_precision=1.0)
    assert (complete.order, complete.window, complete.lambda_w, complete.smoothness) == (3, 9, 2.0, None)
    assert complete == Settings(order=3, d=2, window=9, parameter_precision=1.0, lambda_w=2)
    assert hash(complete) == hash(Settings.from_dict(complete.to_dict()))
    assert pickle.loads(pickle.dumps(complete)) == complete == CompleteSettings.from_json(complete.to_json())
    assert CompleteSettings.paper() == Settings.paper()


@pytest.mark.parametrize("name", ["order", "d", "window", "parameter_precision"])
def test_complete_settings_refuse_what_is_open(name):
    with pytest.raises(ValueError, match=f"^{name} must "):
        replace(CompleteSettings.paper(), **{name: None})
