"""The terminal's report of a model names the model of each figure."""

import numpy as np
from made_up_analysis import HOVER, assessment, model, physical

from mavdem.cli.output import print_blocks
from mavdem.experiments.held_out import (
    CONSTANT_MEAN,
    FORECAST,
    HOLD_LAST,
    PREDICTION,
    HeldOut,
)
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ModelName
from mavdem.report.blocks import Sentence, Table
from mavdem.report.labels import Labels
from mavdem.report.screen import (
    analysis_blocks,
    motor_blocks,
    motor_table_of_all_flight,
    next_step_of_learning,
    prediction_blocks,
)


def test_errors_stand_beside_the_model_that_forecast_or_predicted():
    """The table of errors names the model of forecasts and of predictions."""
    measured = np.random.default_rng(3).normal(size=(2, 5, 1))
    names = (FORECAST, PREDICTION, CONSTANT_MEAN, HOLD_LAST)
    held_out = HeldOut(
        time=np.arange(10.0).reshape(2, 5),
        measured=measured,
        forecasts=dict.fromkeys(names, 0 * measured),
        band=np.ones_like(measured),
        expected=np.ones_like(measured),
        variance=np.ones(1),
        model=ModelName.DEM,
    )
    labels = Labels(("motor",), ("%",), ("roll",), ("rad",))
    table = next(block for block in prediction_blocks(labels, held_out) if isinstance(block, Table))
    methods = {row[0] for row in table.rows}
    assert {"DEM, motors recorded", "joint VAR, motors unknown"} <= methods


def test_the_next_step_of_a_sound_vehicle_is_about_its_model_only_where_one_is_learned():
    """The flight is judged without a model live, and in all other places alike; ``learn`` says what the model needs."""
    sound = assessment(physical(damping=Status.NOT_IDENTIFIABLE))
    assert next_step_of_learning(sound).text.startswith("Repeat these manoeuvres for longer")
    assert analysis_blocks(sound)[-1].text.startswith("Keep this log")


def test_what_no_motor_has_is_no_column_and_what_is_not_identifiable_is_named_once():
    unknown = dict.fromkeys(("effect", "damping", "lag"), Status.NOT_IDENTIFIABLE)
    table, sentence = motor_blocks(model(physical(**unknown)), HOVER)
    assert [*table.header][:2] == ["motor in settled flight", "command (µs)"]
    [table_of_all_flight] = motor_table_of_all_flight(HOVER)
    assert table_of_all_flight.header[0] == "motor in all flight"
    assert table_of_all_flight.rows == table.rows
    names = "control effectiveness, rate damping and motor time constant"
    assert f"; {names} not identifiable" in sentence.text
    known_table, known_sentence = motor_blocks(model(physical()), HOVER)
    assert known_table.header[1].startswith("effectiveness")
    assert "not identifiable" not in known_sentence.text


def test_a_command_in_a_sentence_is_never_broken(capsys):
    command = "`mavdem tune flight.ulg --axis all`"
    print_blocks([Sentence(f"{'word ' * 12}and then {command} advises the gains.", "Next:")])
    assert command in capsys.readouterr().out
