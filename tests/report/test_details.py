"""The details of a learnt flight: the model as textbooks print it, and how it was learnt."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import mavdem
from mavdem.analysis.figures import model_figures
from mavdem.analysis.findings import findings_of
from mavdem.evaluate import held_out_test
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
TEST = FLIGHT[400:]


@pytest.fixture(scope="module")
def learned():
    return mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))


def altered(learned, **fields):
    """With other fields, and its physical parameters, which take time to fit and are of the data alone."""
    return replace(learned, **fields).with_physical(learned.physical)


def told(learned):
    """The details of a model of ``TRAIN``."""
    return detail_blocks(learned, findings_of(learned))


def words(blocks):
    return "\n".join(
        f"{block.lead} {block.text}" for block in blocks if isinstance(block, Sentence)
    )


def test_the_model_can_be_used_from_what_is_reported(learned):
    tables = {block.header[0]: block for block in told(learned) if isinstance(block, Table)}
    assert tables["A"].header == ["A", "roll", "roll rate", "hidden 1"]
    assert tables["B"].header == ["B", "input 1", "input 2", "d"]
    half = learned.model_interval(0.9)
    for name, values, width in (("A", learned.model.A, half.A), ("B", learned.model.B, half.B)):
        rows = tables[name].rows
        assert [row[0] for row in rows] == ["d/dt roll", "d/dt roll rate", "d/dt hidden 1"]
        for row, cells in enumerate(rows):
            for column, cell in enumerate(cells[1 : 1 + values.shape[1]]):
                tolerance = (
                    0.6 * width[row, column] if "±" in cell else 6e-3 * abs(values[row, column])
                )
                power = float(
                    cell.partition("e")[0] == cell or 10.0 ** float(cell.partition(")e")[2] or 0)
                )
                shown = power * float(cell.lstrip("(").split()[0])
                assert shown == pytest.approx(values[row, column], abs=tolerance + 1e-12), cell
    trims = {block.lead: block.text for block in told(learned) if isinstance(block, Sentence)}
    assert trims["y₀:"].startswith(f"roll {TRAIN.outputs[:, 0].mean():.4g} rad (")
    assert trims["u₀:"].endswith(f"input 2 {TRAIN.inputs[:, 1].mean():.4g} µs.")


def test_what_is_not_known_of_the_parameters_is_not_reported(learned):
    def cells(one):
        return " ".join(
            cell
            for block in told(one)
            if isinstance(block, Table)
            for row in block.rows
            for cell in row
        )

    assert "±" in cells(learned)
    unknown = cells(altered(learned, simulation_fit=None))
    assert "±" not in unknown and "nan" not in unknown
    notebook = "".join(ElementTree.fromstring(learned._repr_html_()).itertext())
    assert "control effectiveness" in notebook and "3 states, from 4 s at 100 Hz" in notebook


def shown(A):
    (poles,) = poles_of(A)
    return poles.text


def test_poles_have_a_frequency_and_a_damping_ratio_or_a_time_constant():
    swing = 2 * np.pi * 1.5
    assert (
        shown(np.diag([-2.0, -0.1]))
        == "-0.1: time constant 10 s; -2: time constant 0.5 s. The model is stable."
    )
    assert shown(np.array([[-4.0, swing], [-swing, -4.0]])) == (
        "-4 ± 9.42j: 1.6 Hz, damping ratio 0.39. The model is stable."
    )
    assert shown(np.array([[0.5, swing], [-swing, 0.5]])) == (
        "0.5 ± 9.42j: 1.5 Hz, damping ratio -0.053. The model is unstable."
    )
    assert shown(np.diag([0.5, 0.0, -1.0])) == (
        "0.5: grows with time constant 2 s; 0: integrator; -1: time constant 1 s. The model is unstable."
    )


def test_it_says_how_far_ahead_predictions_without_the_inputs_are_worth_something(learned):
    report = model_figures([TRAIN], learned, held_out_test(TRAIN, TEST, learned))
    assert report["prediction"]["half_explained_seconds"] == (learned.useful_steps * DT).tolist()
    first, second = learned.useful_steps * DT
    assert f"half of the variance of roll up to {first:.2g} s ahead, roll rate" in words(
        told(learned)
    )


def test_it_says_which_samples_count_and_which_motors_are_taken_to_turn_the_axis(learned):
    assert f"each sample from the {learned.joint.choice.lags} before it" in words(told(learned))
    assert "turn the axis" not in words(told(learned))  # two inputs are demands, and no motors
    motors = np.hstack([MOTORS, MOTORS[::-1]])
    flight = replace(FLIGHT, inputs=motors, input_units=("µs",) * 4, input_names=tuple("abcd"))
    for known, said in (
        (None, "Chosen by F̄."),
        ([1, -1, 0.1, 0], "a against b. Known for these inputs."),
    ):
        four = mavdem.learn(replace(flight, effect_directions=known), learned.settings)
        assert said in words(detail_blocks(four))
