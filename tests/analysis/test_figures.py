"""The figures of a model as plain values, and those of all axes of a log against the calls for each."""

import json
from pathlib import Path

import numpy as np
import pytest
from simulated import simulated

import mavdem
from mavdem import evaluate
from mavdem.analysis.figures import model_figures
from mavdem.dem import physical
from mavdem.evaluate.comparison import JOINT
from mavdem.report.blocks import Table
from mavdem.report.screen import vehicle_blocks

LOGS = Path(__file__).parents[2] / "logs"
FLIGHT, SLOW = LOGS / "px4_wind5_steps.tlog", LOGS / "ardupilot_default_rates.tlog"


@pytest.mark.slow
def test_the_figures_of_a_model_are_plain_json_and_put_the_best_first():
    flight = simulated(samples=600, wind=1.0)
    train, test = flight[:500], flight[500:]
    learned = mavdem.learn(train, mavdem.Settings(window=9, parameter_precision=1.0))
    report = model_figures([train], learned, evaluate.held_out_test(train, test, learned))
    assert json.loads(json.dumps(report)) == report
    for errors in (report["one_step_mspe"], report["forecast_mspe"]):
        ratios = [error["relative"] for error in errors.values()]
        assert ratios == sorted(ratios) and errors["constant mean"]["relative"] == 1
    forecast, one_step = learned.forecast(test.inputs), learned.one_step()
    assert report["forecast_mspe"][JOINT]["total"] == pytest.approx(evaluate.mspe(test.outputs, forecast).total)
    one_step_error = evaluate.mspe(train.outputs[1:], one_step[1:]).total
    assert report["one_step_mspe"][JOINT]["total"] == pytest.approx(one_step_error)
    assert report["held_out"]["error_ratio"]["forecast"] == report["forecast_over_constant_mean"]
    variance = learned.forecast_variance(test.inputs).mean(axis=0) / train.outputs.var(axis=0)
    assert report["expected_error"] == pytest.approx(variance.mean())
    parameters, wind = report["physical"], report["wind"]
    assert parameters["effect"] == learned.physical.effect.tolist()
    for name, status in parameters["status"].items():
        assert (parameters["interval_90_percent"][name] is None) == (status == "not identifiable")
    assert (wind["mean"], wind["sd"], wind["resolved"]) == (learned.wind.mean, learned.wind.sd, learned.wind.resolved)
    ahead = evaluate.relative_mspe(train, test, learned.predict(len(test)))
    assert report["prediction"]["error_ratio"] == pytest.approx(ahead)
    assert report["free_energy"]["end"] == pytest.approx(sum(report["free_energy"]["terms"].values()))
    assert sum(report["joint"]["free_energy"].values()) == pytest.approx(learned.joint.free_energy)
    np.testing.assert_array_equal(np.transpose(report["joint"]["combinations"]), learned.joint.combinations)


@pytest.mark.slow
def test_each_axis_is_as_by_itself_and_the_motors_are_those_of_hover():
    found = mavdem.vehicle(FLIGHT)
    assert list(found.axes) == ["roll", "pitch", "yaw"]
    alone = physical(mavdem.read_segments(FLIGHT, axis="yaw"))
    np.testing.assert_allclose(found.axes["yaw"].physical.effect, alone.effect)
    assert found.axes["yaw"].physical.status == alone.status
    assert found.hover == mavdem.hover(FLIGHT)
    axes, motors = (block for block in vehicle_blocks(found) if isinstance(block, Table))
    assert [row[0] for row in axes.rows] == ["roll", "pitch", "yaw"]
    assert len(motors.rows) == len(found.hover.motors)


def test_a_log_too_slow_for_parameters_has_hover_figures_and_the_reason():
    slow = mavdem.vehicle(SLOW, axis="pitch")
    assert list(slow.axes) == ["pitch"] and slow.axes["pitch"].physical is None
    assert "4.0 Hz" in slow.axes["pitch"].reason and slow.hover is not None
    assert slow.as_dict()["axes"]["pitch"]["physical"] is None
    (motors,) = (block for block in vehicle_blocks(slow._replace(axes={})) if isinstance(block, Table))
    assert len(motors.rows) == len(slow.hover.motors)
    with pytest.raises(ValueError, match="axis must be one of roll, pitch, yaw, all, not 'heave'"):
        mavdem.vehicle(FLIGHT, axis="heave")
