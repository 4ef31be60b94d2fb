"""The motion that drag and wind are identified from."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark, raises
from scipy.constants import g as GRAVITY  # noqa: N812
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import mavdem
from mavdem.assessment.identity import Identity
from mavdem.facts.online import DragSource
from mavdem.facts.vehicle import Basis
from mavdem.fleet.priors import EarlierDrag, doubt_on_prior
from mavdem.wind_velocity import drag_identification
from mavdem.wind_velocity.drag_identification import independent_fraction
from mavdem.wind_velocity.mean_wind import MeanWind
from mavdem.wind_velocity.motion_grid import motion_grid
from mavdem.wind_velocity.vehicle_drag import Drag, drag_model_setting


def test_thrust_that_climbs_and_sinks_makes_no_force_across_itself():
    """Specific force along body x and y is what thrust and weight do not explain, however much the thrust varies."""
    time = np.arange(0.0, 20.0, 0.01)
    attitude = np.tile([0.2, -0.1, 0.7], (len(time), 1))
    thrust_axis = Rotation.from_euler("ZYX", [0.7, -0.1, 0.2]).as_matrix()[:, 2]
    # Of a thrust of (1.2 + 0.3 cos t) of the weight; the vehicle climbs or sinks at up to 5 m/s² all the time.
    impulse = GRAVITY * (1.2 * time + 0.3 * np.sin(time))
    velocity = np.outer(GRAVITY * time, [0, 0, 1]) - np.outer(impulse, thrust_axis)
    grid = motion_grid(time, attitude, velocity, 0.2)
    assert grid.complete.sum() > 90 and abs(np.diff(grid.velocity[:, 2])).max() > 0.5
    assert_allclose(grid.force[grid.complete], 0.0, atol=1e-9)


@mark.slow
def test_circles_in_calm_air_show_the_drag_and_no_wind():
    """Gusts far smaller than the population's: scoring overshoots."""
    time = np.arange(0.0, 120.0, 0.2)
    north = 4 * np.sin(time / 6)
    east = 4 * np.cos(time / 6)
    still = 0 * time
    tilts = np.array([0.3 * east - north / 6, -0.3 * north - east / 6, still]) / GRAVITY
    velocity = np.array([north, east, still]).T
    velocity += default_rng(0).normal(0, 0.08, velocity.shape)
    wind = mavdem.estimate_wind(time, tilts.T, velocity)
    assert_allclose(wind.drag.linear, 0.3, atol=0.2)
    assert wind.speed_interval[0] == 0
    with raises(ValueError, match="drag must be a Drag"):
        mavdem.estimate_wind(time, tilts.T, velocity, 0.3)


def test_what_somebody_set_in_the_autopilot_takes_the_place_of_the_populations_drag():
    """Drag coefficients among the parameters replace the prior, of PX4, of ArduPilot and of a simulator.

    PX4's defaults count as not set.
    """
    usual = Drag.from_parameters(
        "PX4", {"EKF2_MCOEF": 0.15, "EKF2_BCOEF_X": 25, "EKF2_BCOEF_Y": 100}
    )
    assert_allclose(usual.mean, np.append(np.log([0.3, 0.014, 1, 1]), [0, 0]))
    assert_allclose(np.diag(usual.covariance) ** 0.5, [0.6, 0.9, 0.2, 0.35, 0.18, 0.18])
    # From flight to flight no more is forgotten than the next may differ by.
    assert_allclose(usual.for_next_flight().covariance, usual.covariance)
    leaning = replace(usual, mean=np.ones(6)).for_next_flight()
    assert_allclose(leaning.mean, np.append(np.ones(4), [1 - (5 / 9) ** 2] * 2))
    from_flight = replace(usual, source=DragSource.FLIGHT).for_next_flight()
    assert (leaning.source, from_flight.source) == (
        DragSource.POPULATION,
        DragSource.EARLIER_FLIGHT,
    )
    # The drag that a simulator flies with is that of its vehicle, and of no real one whose board has its parameters.
    simulator = {"SIH_KDV": 1.0, "SIH_MASS": 2.0, "SYS_AUTOSTART": 10040.0}
    simulated = Drag.from_parameters("PX4", simulator)
    assert simulated.source == "parameters"
    assert_allclose(simulated.linear, 0.5)
    assert simulated.interval("linear")[1].max() < 0.62
    # Without quadratic drag there is no ballistic coefficient that the autopilot would take.
    assert list(simulated.autopilot_parameters("PX4")) == ["EKF2_MCOEF"]
    assert Drag.from_parameters("PX4", simulator | {"SYS_AUTOSTART": 4001.0}).source == "population"
    names = ("EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y")
    coefficients = dict(zip(names, (0.5, 20.0, 80.0), strict=True))
    drag_by_parameters = Drag.from_parameters("ARDUPILOTMEGA", coefficients)
    assert (usual.source, drag_by_parameters.source) == ("population", "parameters")
    written = drag_by_parameters.autopilot_parameters("ARDUPILOTMEGA")
    # Both autopilots take a momentum coefficient of up to 1/s.
    draggy = Drag.from_parameters("ARDUPILOTMEGA", coefficients | {"EK3_DRAG_MCOEF": 1.2})
    assert list(draggy.autopilot_parameters("ARDUPILOTMEGA")) == [*names[1:]]
    assert {name: round(written[name][0], 6) for name in names} == coefficients
    for name, quadratic in (("EK3_DRAG_BCOEF_X", 0), ("EK3_DRAG_BCOEF_Y", 1)):
        low, high = drag_by_parameters.interval("quadratic")[:, quadratic]
        assert_allclose(written[name][1:], [0.6125 / high, 0.6125 / low])
    assert_allclose(
        [drag_by_parameters.linear, drag_by_parameters.quadratic],
        [[0.5, 0.5], [0.6125 / 20, 0.6125 / 80]],
    )
    assert_allclose(np.diag(drag_by_parameters.covariance) ** 0.5, [0.3, 0.3, 0.2, 0.3, 0.18, 0.18])


def test_errors_that_are_alike_count_for_fewer_independent_ones():
    white = default_rng(0).standard_normal((20_000, 1))
    assert independent_fraction(white) == approx(1.0, abs=0.03)
    assert independent_fraction(lfilter([1], [1, -0.8], white, axis=0)) == approx(
        0.2 / 1.8, rel=0.1
    )


@mark.parametrize(
    ("values", "has_settled"),
    [
        ([1.0, 5.0, 4.9], False),
        # It alternates between the two sides of a maximum.
        ([700.0, 754.7, 746.2, 754.8, 746.1], True),
        ([700.0, 754.7, 746.2, 754.8, 742.0], False),
        # It climbs, or is led astray, and may turn.
        ([700.0, 720.0, 740.0, 745.0, 746.0, 746.4], False),
        ([-381.5, -389.6, -375.3, -381.4], False),
        # After the usual number of iterations a small change suffices.
        ([*range(100, 220, 10), 213.0], True),
        ([*range(100, 220, 10), 220.0], False),
        ([float("nan")] * 20, False),
    ],
)
def test_a_search_ends_where_it_repeats_itself_or_hardly_changes(values, has_settled):
    """The values are log posteriors of the iterations so far, of searches that settle, climb, turn or fail."""
    assert drag_identification._has_converged(values) == has_settled


def test_firmware_without_a_drag_model_has_no_setting_that_switches_it_on():
    assert drag_model_setting("PX4", {"EKF2_DRAG_CTRL": 0.0}) == "EKF2_DRAG_CTRL 1"
    assert drag_model_setting("ARDUPILOTMEGA", {}) == "EK3_DRAG_MCOEF above 0"
    assert drag_model_setting("ARDUPILOTMEGA", {"ATC_RAT_RLL_P": 0.1}) == ""
    assert drag_model_setting("GENERIC", {}) == ""


def test_the_drag_of_a_prior_that_the_flight_excludes_is_in_doubt():
    """Only a flight that shows the drag itself can contradict an earlier one; another vehicle's name always does."""
    usual = Drag.from_parameters()
    narrow = replace(usual, covariance=usual.covariance / 100, source=DragSource.FLIGHT)
    # The logarithms of the drag come first: twice the linear and the quadratic drag.
    doubled = replace(narrow, mean=usual.mean + np.log(2) * np.isin(range(len(usual.mean)), (0, 1)))
    assert doubled.at_speed(3.0).value == approx(2 * narrow.at_speed(3.0).value)
    flight = SimpleNamespace(air_velocity=np.full((4, 2), 2.0), drag=narrow)
    identity = Identity("board 5", Basis.BOARD, 1, "PX4", "QUADROTOR", "", None)
    contradicted = doubt_on_prior(EarlierDrag(doubled, ""), flight, identity)
    assert contradicted.is_contradicted and not contradicted.is_of_another_vehicle
    assert contradicted.air_speed == approx(np.sqrt(8))
    assert not doubt_on_prior(EarlierDrag(narrow, "board 5"), flight, identity).is_contradicted
    assert doubt_on_prior(EarlierDrag(narrow, "board 6"), flight, identity).is_of_another_vehicle
    # Vehicles without names differ if their autopilots or frames do.
    for autopilot, frame, is_another in (
        ("ARDUPILOTMEGA", "QUADROTOR", True),
        ("PX4", "HEXAROTOR", True),
        ("PX4", "QUADROTOR", False),
        ("", "GENERIC", False),
    ):
        earlier = EarlierDrag(narrow, "", autopilot, frame)
        assert doubt_on_prior(earlier, flight, identity).is_of_another_vehicle is is_another
    flight.drag = replace(narrow, source=DragSource.POPULATION)
    assert not doubt_on_prior(EarlierDrag(doubled, ""), flight, identity).is_contradicted


def test_a_part_of_a_flight_in_which_still_air_is_likely_has_no_lower_end():
    assert MeanWind(0.6, 0.3, 1.1, 250.0, 60.0, 0.1).reported_values["low"] == 0
    assert MeanWind(3.0, 2.5, 3.5, 250.0, 9.0, 0.1).reported_values["low"] == 2.5
