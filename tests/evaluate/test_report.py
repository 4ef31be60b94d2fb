import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import mavdem
from mavdem import evaluate
from mavdem.analysis.figures import model_figures

DT = 0.01


def flight(samples: int = 500) -> mavdem.Flight:
    rng = np.random.default_rng(0)
    motors = gaussian_filter1d(rng.standard_normal((samples, 2)), 6, axis=0)
    rate = np.cumsum(motors @ [1.0, -1.0]) * DT
    return mavdem.Flight(DT * np.arange(samples), motors, np.stack([np.cumsum(rate) * DT, rate], axis=1))


@pytest.mark.slow
def test_the_report_is_plain_json_and_puts_the_best_first():
    train, test = flight()[:400], flight()[400:]
    learned = mavdem.learn(train, mavdem.Settings(window=9, parameter_precision=1.0))
    held_out = evaluate.held_out_test(train, test, learned)
    report = model_figures([train], learned, held_out)
    assert json.loads(json.dumps(report)) == report
    for errors in (report["one_step_mspe"], report["forecast_mspe"]):
        ratios = [error["relative"] for error in errors.values()]
        assert ratios == sorted(ratios)
        assert errors["constant mean"]["relative"] == 1
    forecast = evaluate.mspe(test.outputs, learned.forecast(test.inputs))
    assert report["forecast_mspe"]["DEM"]["total"] == pytest.approx(forecast.total)
    assert report["held_out"]["error_ratio"]["forecast"] == report["forecast_over_constant_mean"]
    assert report["one_step_mspe"]["DEM"]["total"] == pytest.approx(
        evaluate.mspe(train.outputs[1:], learned.one_step()[1:]).total
    )
    assert report["forecast_mspe"]["DEM"]["relative"] == report["forecast_over_constant_mean"]
    variance = learned.forecast_variance(test.inputs).mean(axis=0) / train.outputs.var(axis=0)
    assert report["expected_error"] == pytest.approx(variance.mean())
    assert report["simulation_fit"]["parameters"] == len(learned.simulation_fit.places)
    turning = learned.simulation_fit.layout and learned.simulation_fit.layout.turning
    assert report["simulation_fit"]["turning"] == (None if turning is None else turning.tolist())
    reading = report["physical"]
    assert reading["effect"] == learned.physical.effect.tolist()
    assert reading["status"] == learned.physical.status
    wind = report["wind"]
    assert (wind["mean"], wind["sd"], wind["resolved"]) == (learned.wind.mean, learned.wind.sd, learned.wind.resolved)
    assert wind["spectrum"]["density"] == learned.wind.spectrum.density.tolist()
    assert len(wind["gusts"]) == len(learned.wind.gusts)
    for name, status in reading["status"].items():
        assert (reading["interval_90_percent"][name] is None) == (status == "not identifiable")
    predicted = report["prediction"]
    assert predicted["error_ratio"] == pytest.approx(evaluate.relative_mspe(train, test, learned.predict(len(test))))
    assert predicted["half_explained_seconds"] == [steps * train.dt for steps in learned.prediction.useful_steps(0.5)]
    assert report["free_energy"]["end"] == pytest.approx(sum(report["free_energy"]["terms"].values()))
