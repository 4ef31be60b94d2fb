"""The details of a learnt flight: the model as textbooks print it, and how it was learnt."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import mavdem
from mavdem.analysis.findings import findings_of
from mavdem.report.blocks import Sentence, Table
from mavdem.report.screen import detail_blocks, poles_of

pytestmark = pytest.mark.slow
DT = 0.01
MOTORS = 1500 + 50 * gaussian_filter1d(
    np.random.default_rng(0).standard_normal((500, 2)), 6, axis=0
)
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


@pytest.fixture(scope="module")
def learned():
    return mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))


def told(learned):
    """The details of a model of ``TRAIN``: tables by the head of their first column, sentences by their lead."""
    blocks = detail_blocks(learned, findings_of(learned))
    tables = {block.header[0]: block for block in blocks if isinstance(block, Table)}
    return tables, {block.lead: block.text for block in blocks if isinstance(block, Sentence)}


def test_the_model_can_be_used_from_what_is_reported(learned):
    tables, sentences = told(learned)
    assert tables["A"].header == ["A", "roll", "roll rate", "hidden 1"]
    assert tables["B"].header == ["B", "input 1", "input 2", "d"]
    half = learned.model_interval(0.9).A
    for number, (name, *cells) in enumerate(tables["A"].rows[1:], 1):
        assert name == f"d/dt {tables['A'].header[1:][number]}"
        for cell, value, width in zip(cells, learned.model.A[number], half[number], strict=True):
            shown, _, power = cell.removeprefix("(").partition(")e")
            found = float(shown.split()[0]) * 10 ** float(power or 0)
            assert found == pytest.approx(value, abs=max(0.6 * width, 0.006 * abs(value)))
    assert sentences["y₀:"].startswith(f"roll {TRAIN.outputs[:, 0].mean():.4g} rad (")
    assert sentences["u₀:"].endswith(f"input 2 {TRAIN.inputs[:, 1].mean():.4g} µs.")


def test_what_is_not_known_of_the_parameters_is_not_reported(learned):
    assert "±" in str(told(learned)[0])
    # with the physical parameters, which take time to fit and are of the data alone
    unknown = replace(learned, simulation_fit=None).with_physical(learned.physical)
    cells = str(told(unknown)[0])
    assert "±" not in cells and "nan" not in cells
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
