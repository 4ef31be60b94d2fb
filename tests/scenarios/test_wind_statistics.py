"""Every random model of the wind has the variance, autocorrelation and spectrum it says, at every sampling step.

The bounds follow from the samples' number, see stationary.py; a model whose s is wrong by √2 or whose variance is wrong
by a fifth does not pass.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from stationary import Stationary, holds

from sitl_scenarios.gains import CYCLES
from sitl_scenarios.scenario import Scenario, StreamSpec, TurbulentWind
from sitl_scenarios.wind import (
    LENGTH,
    Weather,
    across,
    along,
    first_order,
    gaussian_noise,
    second_order,
    turbulence,
    von_karman_noise,
)

STEPS = (0.001, 0.004, 0.02)
SERIES, SAMPLES = 30, 2**14
T, S, SHORT = 0.4, 0.05, 0.006


def of_kernel(s):
    return lambda tau: np.exp(-((tau / s) ** 2) / 4)


MODELS = {
    "gaussian": (lambda dt, n, noise: gaussian_noise(S, dt, n, noise), of_kernel(S)),
    "gaussian of a few steps": (lambda dt, n, noise: gaussian_noise(SHORT, dt, n, noise), of_kernel(SHORT)),
    "dryden along": (lambda dt, n, noise: first_order(T, dt, n, noise), lambda tau: np.exp(-tau / T)),
    "dryden across": (
        lambda dt, n, noise: second_order(T, dt, n, noise),
        lambda tau: (1 - tau / T / 2) * np.exp(-tau / T),
    ),
    "von karman along": (lambda dt, n, noise: von_karman_noise(False, T, dt, n, noise), lambda tau: along(tau / T)),
    "von karman across": (lambda dt, n, noise: von_karman_noise(True, T, dt, n, noise), lambda tau: across(tau / T)),
}


def drawn(draw, dt, seed=0, series=SERIES):
    return np.array([draw(dt, SAMPLES, np.random.default_rng([seed, i])) for i in range(series)])


@pytest.mark.slow
@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("model", MODELS)
def test_a_random_model_is_the_process_it_says(model, dt):
    draw, autocorrelation = MODELS[model]
    found = Stationary(autocorrelation, drawn(draw, dt), dt)
    assert holds(found.variance())
    for tau in (0.02, 0.06, 0.1, 0.2, 0.8):
        assert holds(found.autocovariance(max(1, round(tau / dt)))), tau
    for band in found.spectrum():
        assert holds(band)


@pytest.mark.slow
@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("model", [model for model in MODELS if "von karman" not in model])  # a circle has no beginning
def test_a_series_begins_as_it_goes_on(model, dt):
    """A filter that started at rest would have too little variance at first."""
    draw, _ = MODELS[model]
    first = np.array([draw(dt, 2, np.random.default_rng([1, i]))[0] for i in range(1000)])
    assert holds(Stationary(lambda tau: (tau == 0).astype(float), first[None, :], dt).variance())


@pytest.mark.parametrize("tau", [0.01, 0.1, 0.7, 2.0])
def test_autocorrelations_are_those_of_the_standards_spectra(tau):
    """R(τ) = ∫₀^∞ Φ(Ω) cos(Ωτ) dΩ, with L = V = 1 and σ = 1; MIL-F-8785C, 3.7.1.1 and 3.7.1.2."""

    def of(spectrum):
        low = quad(spectrum, 0, 50, weight="cos", wvar=tau, limit=500)[0]
        return low + quad(spectrum, 50, np.inf, weight="cos", wvar=tau, limit=500)[0]

    a = LENGTH
    assert of(lambda w: 2 / np.pi / (1 + w**2)) == pytest.approx(np.exp(-tau), abs=1e-5)
    assert of(lambda w: (1 + 3 * w**2) / np.pi / (1 + w**2) ** 2) == pytest.approx(
        (1 - tau / 2) * np.exp(-tau), abs=1e-5
    )
    lags = np.array([tau])
    longitudinal = of(lambda w: 2 / np.pi / (1 + (a * w) ** 2) ** (5 / 6))
    transverse = of(lambda w: (1 + 8 / 3 * (a * w) ** 2) / np.pi / (1 + (a * w) ** 2) ** (11 / 6))
    # 1.339 is rounded: the integral scale is L to four digits.
    assert longitudinal == pytest.approx(along(lags)[0], abs=5e-4)
    assert transverse == pytest.approx(across(lags)[0], abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dryden", "von_karman"])
@pytest.mark.parametrize("autopilot", CYCLES)
def test_the_weather_is_as_strong_as_the_standard_says(kind, autopilot):
    wind = TurbulentWind(kind=kind, speed=8.0, direction=0.0, wind_at_20_feet=15.4)
    dt, n, flights = CYCLES[autopilot], 6000, 40
    time = dt * np.arange(n)
    of_wind = turbulence(wind, 5.0, 0.44)
    seen = []
    for seed in range(flights):
        scenario = Scenario(wind=(wind,), seed=seed, stream=StreamSpec(autopilot=autopilot))
        weather = Weather(scenario, dt, time)
        seen.append([weather.at(cycle, (0.0, 0.0, -5.0))[:5] for cycle in range(0, n, 100)])
    found = np.array(seen)
    # From the north: along is south, across is east or west.
    parts = [
        (-found[..., 0] - 8.0, of_wind.along, "along"),
        (found[..., 1], of_wind.across, "across"),
        (found[..., 2], of_wind.down, "across"),
        (found[..., 3], of_wind.rotation, "rotation"),
        (found[..., 4], of_wind.rotation, "rotation"),
    ]
    for series, (constant, sd), shape in parts:
        if shape == "rotation":
            autocorrelation = MODELS["dryden along"][1]
        else:
            autocorrelation = MODELS[f"{kind.replace('_', ' ')} {shape}"][1]
        scaled = lambda tau, constant=constant, rho=autocorrelation: rho(tau / constant * T)  # noqa: E731
        assert holds(Stationary(scaled, series / sd, dt * 100).variance())
