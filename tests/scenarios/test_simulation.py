"""A flight is what its scenario says, the same every time, and the vehicle stays in the air."""

from dataclasses import fields

import numpy as np
from numpy.testing import assert_array_equal
from pytest import approx, fixture, mark, raises

from sitl_scenarios import scenario as sections
from sitl_scenarios.files import load
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation, fly, simulation_of

pytestmark = mark.slow

WINDY = (
    sections.SteadyWind(kind="steady", speed=4.0),
    sections.GaussianWind(kind="gaussian", sd=0.7, s=0.2),
)


def brief(**given):
    return Scenario(**{"duration": 15.0, "seed": 5, "wind": WINDY} | given)


def roll(motion):
    w, x, y, z = motion.attitude.T
    return np.degrees(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))


@fixture(scope="module")
def flight():
    return fly(brief())


def test_the_same_seed_gives_the_same_bits_in_pieces_too(flight):
    simulation = Simulation(brief())
    rows = []
    for cycles in (1, 7, 1000, 3, 10**6):
        rows.append(simulation.advance(cycles))
    assert simulation.finished
    for field in fields(Motion):
        together = np.concatenate([getattr(each, field.name) for each in rows])
        assert_array_equal(together, getattr(flight, field.name))


def test_a_flight_in_wind_touches_down_as_slowly_as_autopilots_do(flight):
    last_in_air = np.flatnonzero(flight.position[:, 2] < 0)[-1]
    assert 0.3 < flight.velocity[last_in_air, 2] < 0.9


@mark.in_full
def test_a_lasting_downdraught_does_not_hold_a_vehicle_on_the_ground_at_take_off():
    scenario = load("motor_stop").model_copy(update={"seed": 2502})
    motion = simulation_of(scenario).advance(round(6.0 / scenario.cycle))
    assert motion.wind[motion.armed, 2].mean() > 1.0
    planned_height = 4.0
    assert -motion.position[-1, 2] == approx(planned_height, abs=1.5)


def test_a_second_flight_is_armed_as_long_after_the_first_as_that_after_boot():
    twice = fly(brief(duration=15.0, flights=2))
    changes = twice.time[1:][np.diff(twice.armed.astype(int)) != 0]
    assert changes == approx([2, 17, 20, 35]) and twice.time[-1] == approx(36, abs=0.01)


def test_disarming_is_refused_in_the_air_unless_forced():
    simulation = Simulation(brief())
    simulation.advance(250 * 10)
    assert not simulation.set_armed(False) and simulation.armed
    assert simulation.set_armed(False, force=True)
    falling = simulation.advance(10**6)
    assert not falling.armed.any() and falling.velocity[:, 2].max() > 5
    assert falling.position[-1, 2] == 0 and falling.landed_state[-1] == 1 and simulation.finished


def test_a_vehicle_that_tumbles_is_no_flight():
    scenario = brief(
        vehicle=sections.VehicleSpec(model="crazyflie"), moments=(sections.Moment(sd=1.0, s=0.5),)
    )
    with raises(ValueError, match="the vehicle is out of control .* s after boot"):
        fly(scenario)
