"""The details of a learned flight: poles, and how it was learned."""

from xml.etree import ElementTree

import numpy as np
from numpy.random import default_rng
from pytest import fixture, mark
from scipy.ndimage import gaussian_filter1d

import mavdem
from mavdem.report.screen import detail_blocks, poles_of

pytestmark = mark.slow
DT = 0.01
MOTORS = 1500 + 50 * gaussian_filter1d(default_rng(0).standard_normal((500, 2)), 6, axis=0)
RATE = np.cumsum((MOTORS - 1500) @ [0.02, -0.02]) * DT
NAMES = {
    "input_units": ("µs", "µs"),
    "output_names": ("roll", "roll rate"),
    "output_units": ("rad", "rad/s"),
}
FLIGHT = mavdem.Flight(
    DT * np.arange(500), MOTORS, np.stack([np.cumsum(RATE) * DT, RATE], axis=1), **NAMES
)
TRAIN = FLIGHT[:400]


@fixture(scope="module")
def learned():
    return mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))


def test_details_say_how_it_was_learned_and_a_notebook_what_it_is_good_for(learned):
    leads = {block.lead for block in detail_blocks(learned)}
    assert any(lead.startswith("Poles of A") for lead in leads) and len(leads) >= 2
    notebook = "".join(ElementTree.fromstring(learned._repr_html_()).itertext())
    assert "control effectiveness" in notebook and "3 states, from 4 s at 100 Hz" in notebook


def test_poles_have_a_frequency_and_a_damping_ratio_or_a_time_constant():
    swing = 2 * np.pi * 1.5
    for A, said in (
        (
            [[-4.0, swing], [-swing, -4.0]],
            "-4 ± 9.42j: 1.6 Hz, damping ratio 0.39. The model is stable.",
        ),
        (
            np.diag([0.5, 0.0, -1.0]),
            "0.5: grows with time constant 2 s; 0: integrator; -1: time constant 1 s. The model is unstable.",
        ),
    ):
        (poles,) = poles_of(np.array(A))
        assert poles.text == said
