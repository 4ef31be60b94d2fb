"""Winds that are no chance, turbulence by its statistics, and what every wind has in common."""

from functools import partial

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark
from scipy.integrate import quad
from scipy.stats import ttest_1samp

from sitl_scenarios.files import load
from sitl_scenarios.scenario import (
    Gust,
    Jet,
    Moment,
    Profile,
    Scenario,
    SteadyWind,
    TurbulentWind,
)
from sitl_scenarios.turbulence import (
    VON_KARMAN_A,
    dryden_longitudinal,
    dryden_transverse,
    gaussian_noise,
    longitudinal_autocorrelation,
    transverse_autocorrelation,
    turbulence_scales,
    von_karman_noise,
)
from sitl_scenarios.wind import Weather, gust_speed, jet_speed

ORIGIN = (0.0, 0.0, 0.0)
DT = 0.004


def weather(samples=500, **sections):
    return Weather(Scenario(**sections), DT, DT * np.arange(samples))


def test_a_gust_rises_stays_and_falls():
    wind = Gust(kind="gust", start=10.0, speed=4.0, rise=2.0, hold=3.0)
    time = np.array([9.0, 10.0, 10.5, 11.0, 12.0, 14.9, 16.0, 17.0, 30.0])
    half = 2 * (1 - np.cos(np.pi / 4))
    assert gust_speed(wind, time) == approx([0, 0, half, 2, 4, 4, 2, 0, 0])
    assert gust_speed(wind.model_copy(update={"hold": None}), time)[-1] == 4


def test_a_jet_falls_as_one_over_the_distance_and_has_a_gaussian_profile():
    jet = Jet(kind="jet", speed=8.0, diameter=0.5)
    assert jet_speed(jet, 1.0, 0.0) == jet_speed(jet, 3.0, 0.0) == 8
    assert jet_speed(jet, 6.0, 0.0) == approx(4)
    assert jet_speed(jet, 6.0, 0.094 * 6) == approx(2)
    assert jet_speed(jet, 6.0, 2 * 0.094 * 6) == approx(4 / 16)
    assert jet_speed(jet, -0.1, 0.0) == 0
    nearer = jet.model_copy(update={"distance": 6.0, "direction": 0.0, "turbulence": 0.0})
    assert weather(wind=(nearer,), height=5.0).air_at(0, (1.5, 0.0, -5.0)).north == approx(-16 / 3)


@mark.slow
def test_a_jet_is_turbulent_by_its_share_of_the_local_mean():
    """Off the axis by a half-width at twice the core's length, 8 m/s at the mouth are 2: of that, 0.25 are 0.5 m/s."""
    jet = Jet(kind="jet", speed=8.0, direction=0.0, distance=6.0, turbulence=0.25, s=0.01)
    blown = weather(20000, wind=(jet,), height=5.0)
    air = np.array([blown.air_at(cycle, (0.0, 0.564, -5.0))[:3] for cycle in range(20000)])
    # By the noise's colour as good as 2300 independent values: 0.03 m/s are about three standard errors of a mean.
    assert air.std(axis=0) == approx([0.5, 0.5, 0.5], abs=0.03)
    assert air.mean(axis=0) == approx([-2.0, 0.0, 0.0], abs=0.03)


@mark.slow
@mark.parametrize(
    "wind",
    [
        SteadyWind(kind="steady", speed=3.0),
        TurbulentWind(kind="dryden", speed=5.0),
        TurbulentWind(kind="von_karman", speed=5.0),
        Gust(kind="gust", start=0.1, speed=3.0),
        Jet(kind="jet", speed=6.0, turbulence=0.3, offset=0.1),
    ],
)
def test_wind_from_another_direction_is_the_same_wind_turned(wind):
    """By 30°, clockwise seen from above, with the place where it is felt: along and across change places in part."""
    north = 0.3
    east = 0.2
    cos = 3**0.5 / 2
    sin = 0.5
    position_after_turn = (north * cos - east * sin, north * sin + east * cos, -4.9)
    from_north, turned = (
        weather(wind=(wind.model_copy(update={"direction": at}),)) for at in (0.0, 30.0)
    )
    for cycle in range(0, 500, 50):
        air_from_north = from_north.air_at(cycle, (north, east, -4.9))
        air_after_turn = turned.air_at(cycle, position_after_turn)
        assert air_after_turn.north == approx(
            air_from_north.north * cos - air_from_north.east * sin
        )
        assert air_after_turn.east == approx(air_from_north.north * sin + air_from_north.east * cos)
        assert air_after_turn[2:] == approx(air_from_north[2:])


def test_low_altitude_turbulence_has_the_standards_figures():
    """MIL-F-8785C at 20 ft and 15 kt: σ_w = 1.5 kt, L_w = 20 ft, L_u = 20/0.19346^1.2 ft, σ_u = σ_w/0.19346^0.4."""
    covariance_by_series = turbulence_scales(
        TurbulentWind(kind="dryden", speed=10.0, wind_at_20_feet=7.7), 20 * 0.3048, 0.44
    )
    assert covariance_by_series.vertical == approx((20 * 0.3048 / 10, 0.77))
    assert covariance_by_series.horizontal == approx((143.54 * 0.3048 / 10, 1.4859), rel=1e-3)


def test_the_airs_rotation_has_the_standards_variance_and_corner_frequency():
    """The integral of MIL-F-8785C's Φ_p, and πV/4b, with σ_w = 0.77 m/s, L_w = 20 ft, b = 0.44 m and V = 10 m/s."""
    of_wind = TurbulentWind(kind="dryden", speed=10.0, wind_at_20_feet=7.7)
    lowest, *higher = (turbulence_scales(of_wind, feet * 0.3048, 0.44) for feet in (2, 9.9, 10.1))
    assert lowest == higher[0] != higher[1]
    constant, sd = turbulence_scales(of_wind, 20 * 0.3048, 0.44).rotation
    assert (sd, 1 / constant) == approx((0.6953, 17.850), rel=1e-4)


@mark.parametrize(
    "profile, height, speed",
    [
        ({"law": "log", "roughness": 0.1}, 100.0, 6.0),
        ({"law": "log", "roughness": 0.1}, 0.1, 0.0),
        ({}, 40.0, 4.0),
    ],
)
def test_wind_grows_with_height_and_turns_clockwise_with_height_and_time(profile, height, speed):
    west = SteadyWind(kind="steady", speed=4.0, direction=270.0)
    air = weather(samples=2501, wind=(west,), profile=Profile(veer=0.5, turn=3.0, **profile))
    position_after_turn = air.air_at(2500, (0.0, 0.0, -height))
    angle = np.radians(0.5 * (height - 10) + 3.0 * 10)
    assert position_after_turn[:3] == approx((-speed * np.sin(angle), speed * np.cos(angle), 0.0))
    assert air.air_at(0, (0.0, 0.0, -10.0))[:3] == approx((0.0, 4.0, 0.0))


def test_winds_and_moments_are_summed():
    """Two steady winds and moments about roll and yaw act together."""
    east, north = (
        SteadyWind(kind="steady", speed=at, direction=by) for at, by in ((3.0, 90.0), (2.0, 0.0))
    )
    summed_weather = weather(
        wind=(east, north), moments=(Moment(sd=0.1, s=0.1), Moment(axis="yaw", sd=0.1, s=0.1))
    )
    air = summed_weather.air_at(7, ORIGIN)
    assert air[:3] == approx((-2, -3, 0))
    assert air.roll != 0 != air.yaw != air.roll and air.pitch == 0


STEPS = (0.001, 0.02)
SERIES = 30
SAMPLES = 2**14
T = 0.4
S = 0.05
SHORT = 0.006


def of_kernel(s):
    return lambda tau: np.exp(-((tau / s) ** 2) / 4)


MODELS = {
    "gaussian": (partial(gaussian_noise, S), of_kernel(S)),
    "gaussian of a few steps": (partial(gaussian_noise, SHORT), of_kernel(SHORT)),
    "dryden along": (partial(dryden_longitudinal, T), lambda tau: np.exp(-tau / T)),
    "dryden across": (
        partial(dryden_transverse, T),
        lambda tau: (1 - tau / T / 2) * np.exp(-tau / T),
    ),
    "von karman along": (
        partial(von_karman_noise, longitudinal_autocorrelation, T),
        lambda tau: longitudinal_autocorrelation(tau / T),
    ),
    "von karman across": (
        partial(von_karman_noise, transverse_autocorrelation, T),
        lambda tau: transverse_autocorrelation(tau / T),
    ),
}


@mark.slow
@mark.parametrize("dt", STEPS)
@mark.parametrize("model", MODELS)
def test_a_random_model_is_the_process_it_says(model, dt):
    """Of independent series, whose scatter says how far their mean may be: once in 10 000 that far by chance."""
    draw, autocorrelation = MODELS[model]
    series = np.array([draw(dt, SAMPLES, default_rng([0, i])) for i in range(SERIES)])
    for lag in (0, *np.unique(np.geomspace(1, 2.0 / dt, 9).astype(int)).tolist()):
        covariance_by_series = np.mean(series[:, : SAMPLES - lag] * series[:, lag:], axis=1)
        (expected,) = autocorrelation(np.array([lag * dt]))
        assert ttest_1samp(covariance_by_series, expected).pvalue > 1e-4, lag


@mark.parametrize("tau", [0.01, 0.1, 0.7, 2.0])
def test_von_karmans_autocorrelations_are_those_of_the_standards_spectra(tau):
    """R(τ) = ∫₀^∞ Φ(Ω) cos(Ωτ) dΩ, with L = V = 1 and σ = 1; MIL-F-8785C, 3.7.1.1."""

    def of(spectrum):
        low = quad(spectrum, 0, 50, weight="cos", wvar=tau, limit=500)[0]
        return low + quad(spectrum, 50, np.inf, weight="cos", wvar=tau, limit=500)[0]

    a = VON_KARMAN_A
    lags = np.array([tau])
    longitudinal = of(lambda w: 2 / np.pi / (1 + (a * w) ** 2) ** (5 / 6))
    transverse = of(lambda w: (1 + 8 / 3 * (a * w) ** 2) / np.pi / (1 + (a * w) ** 2) ** (11 / 6))
    # 1.339 is rounded: the integral scale is L to four digits.
    assert longitudinal == approx(longitudinal_autocorrelation(lags)[0], abs=5e-4)
    assert transverse == approx(transverse_autocorrelation(lags)[0], abs=5e-4)


def test_the_hover_that_docs_judge_by_the_drag_of_legs_is_of_the_same_vehicle():
    assert load("wind_hover").vehicle == load("wind_legs").vehicle
