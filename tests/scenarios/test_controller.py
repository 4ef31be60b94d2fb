"""What the autopilot asks of motors, and the plan it follows."""

from functools import cache
from math import radians

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, param

from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from sitl_scenarios.dynamics import State
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.mixers import px4_thrusts
from sitl_scenarios.plan import LANDING_SPEED, FlightPlan
from sitl_scenarios.rotors import IDLE_COMMAND, mixed_commands, rotor_frame
from sitl_scenarios.scenario import Chirp, Doublets, Multisine, Scenario, Sensors, Sticks
from sitl_scenarios.sensors import StateEstimator
from sitl_scenarios.simulation import fly, simulation_of

X = rotor_frame("x", (0.1, 0.1))
CYCLE = 0.004


def test_saturation_takes_thrust_first_and_keeps_the_demands_in_proportion():
    full = np.array(mixed_commands(X, (0.3, 0.0, 0.0, 1.0)))
    assert full.max() == approx(1)
    assert full[1] - full[0] == approx(0.6)
    beyond = np.array(mixed_commands(X, (0.9, 0.6, 0.0, 0.5)))
    assert beyond.min() == approx(IDLE_COMMAND)
    assert beyond.max() == approx(1)
    roll = beyond @ X.roll
    pitch = beyond @ X.pitch
    assert roll / pitch == approx(1.5)
    turned = px4_thrusts(np.array([X.roll, X.pitch, X.yaw]), (0.0, 0.0, 0.3, 0.9))
    # The demand is a little larger than the largest possible one.
    assert np.ptp(turned) == approx(0.5)


def sensed(sensors, states):
    sensing = StateEstimator(Scenario(sensors=sensors))
    return [sensing.estimate(state) for state in states]


def test_what_is_known_is_late_by_the_delay():
    states = [State(velocity=(float(k), 0.0, 0.0)) for k in range(10)]
    quiet = {"rate_sd": 0.0, "attitude_sd": 0.0, "position_sd": 0.0, "velocity_sd": 0.0}
    measured_states = sensed(Sensors(**quiet, delay=0.010), states)
    assert [each.velocity[0] for each in measured_states[3:]] == approx(np.arange(3, 10) - 2.5)
    at_once = sensed(Sensors(**quiet, delay=0.0), states)
    assert [each.velocity[0] for each in at_once] == list(range(10))


@mark.slow
def test_what_is_known_is_as_noisy_as_asked():
    """The measured states of a vehicle at rest have the standard deviations of the sensors' noise."""
    sds = {"rates": 0.1, "attitude": 0.02, "position": 0.5, "velocity": 0.3}
    sensors = Sensors(**{f"{name.removesuffix('s')}_sd": sd for name, sd in sds.items()})
    measured_states = sensed(sensors, [State()] * 20000)
    for name, sd in sds.items():
        measured = np.array(
            [
                [2 * e for e in each.attitude[1:]] if name == "attitude" else getattr(each, name)
                for each in measured_states
            ]
        )
        # The standard error of a standard deviation of 60000 values is 0.3 %.
        assert measured.std() == approx(sd, rel=0.012)


def excited(excitation, duration=60.0, cycle=CYCLE):
    plan = FlightPlan(Scenario(duration=duration, excitation=excitation))
    return [plan.reference_at(k * cycle) for k in range(round(duration / cycle))]


@cache
def demands_of_kind(kind, axis):
    """The attitudes (N, 3) that an excitation of this kind about an axis demands, in 30 s."""
    (name,) = kind.model_fields["kind"].annotation.__args__
    references = excited(kind(kind=name, axis=axis), duration=30.0)
    return np.array([reference.attitude_demand for reference in references])


@mark.slow
@mark.parametrize("axis", ["roll", "pitch", "yaw"])
@mark.parametrize("kind", [Doublets, Chirp, Multisine, Sticks])
def test_an_excitation_is_about_its_axis(kind, axis):
    demands = demands_of_kind(kind, axis)
    about = np.array(["roll", "pitch", "yaw"]) == axis
    assert not demands[:, ~about].any()
    if kind is not Sticks:
        rolls = demands_of_kind(kind, "roll")[:, 0]
        assert_array_equal(demands[:, about][:, 0], rolls)
    assert demands[:, about].std() > radians(1)


@mark.slow
def test_a_chirp_turns_as_often_as_its_mean_frequency_says():
    """A chirp from 1 Hz to 4 Hz over 20 s has 50 periods, since its mean frequency is 2.5 Hz."""
    excitation = Chirp(kind="chirp", lowest=1.0, highest=4.0, period=20.0)
    demands = np.array([at.attitude_demand[0] for at in excited(excitation)])[: round(50 / CYCLE)]
    periods = demands[demands != 0]
    turns = np.count_nonzero(np.diff(np.sign(periods[-round(20 / CYCLE) :]))) / 2
    assert turns == approx(20.0 * 2.5, abs=1)
    assert abs(periods).max() == approx(radians(excitation.amplitude), rel=1e-3)


@mark.slow
def test_doublets_of_all_axes_take_turns():
    excitation = Doublets(kind="doublets", axis="all", period=1.0)
    demands = np.array([at.attitude_demand for at in excited(excitation, duration=30.0)])
    assert (demands != 0).sum(axis=1).max() == 1
    assert (demands != 0).any(axis=0).all()


@mark.slow
def test_multisines_of_all_axes_share_no_frequency_and_are_orthogonal():
    """Over one period, demands of the three axes are uncorrelated and have the requested deviation of 3°."""
    excitation = Multisine(
        kind="multisine", axis="all", sd=3.0, lowest=0.5, highest=5.0, period=10.0
    )
    demands = np.degrees([at.attitude_demand for at in excited(excitation)])[
        round(20 / CYCLE) : round(30 / CYCLE)
    ]
    assert_allclose(np.cov(demands.T, bias=True), 9.0 * np.eye(3), atol=1e-9)
    power = abs(np.fft.rfft(demands, axis=0)) > 1e-6
    assert power.sum(0).tolist() == [16, 15, 15]
    assert power.sum(1).max() == 1


@mark.parametrize("height", [0.6, 1.5, 5.0, 12.0])
def test_a_descent_never_climbs_and_ends_at_the_landing_speed_until_touch_down(height):
    plan = FlightPlan(Scenario(duration=60.0, height=height))
    landing = [plan.reference_at(time) for time in np.arange(40, 65, CYCLE)]
    heights = np.array([at.height for at in landing])
    rates = np.array([at.climb_rate for at in landing])
    assert_allclose(np.diff(heights) / CYCLE, (rates[1:] + rates[:-1]) / 2, atol=1e-3)
    assert rates.max() == 0 and heights[0] == height
    assert (rates[heights < 0.3] == -LANDING_SPEED).all() and heights[-1] < -2
    # Touch-down is planned a second before disarming.
    assert heights[round((60 - 1 - 40) / CYCLE)] == approx(0, abs=0.01)


@mark.slow
def test_sticks_move_as_slowly_as_asked_and_each_for_itself():
    """Random stick motions are noise with a Gaussian kernel of 0.25 s, independent on each axis."""
    cycle = 0.02
    demands = np.degrees(
        [
            at.attitude_demand
            for at in excited(Sticks(kind="sticks", axis="all"), 600.0, cycle)
            if at.by_stick
        ]
    )
    assert len(demands) * cycle == approx(586.3, abs=0.5)
    # 586 s hold about 586/(2√π 0.25) = 660 independent values: standard errors of 2.8 % and of 0.04.
    assert demands.std(0) == approx([4, 4, 4], rel=0.11)
    assert abs(np.corrcoef(demands.T) - np.eye(3)).max() < 0.16
    # The derivative of Gaussian-kernel noise has the standard deviation 1/(√2 s).
    assert (np.diff(demands, axis=0) / cycle).std(0) == approx(
        4 / (2**0.5 * 0.25) * np.ones(3), rel=0.11
    )


@mark.slow
@mark.usefixtures("coarse_physics")
@mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_parameters_that_are_sent_fly_as_the_own_controller_does(autopilot):
    """A flight by the parameters of the autopilot equals one by the simulator's own gains.

    With a lower gain it differs more.
    """
    vehicle = {"quadratic_thrust": 0.4, "frame": "plus"}
    table = {
        "duration": 15,
        "vehicle": vehicle,
        "excitation": {"kind": "doublets"},
        "stream": {"autopilot": autopilot},
    }
    scenario = scenario_from_table(table)
    parameters = {
        name: value
        for name, value in control_parameters(scenario).items()
        if CONTROL_PARAMETERS.match(name)
    }
    changed_parameters = parameters | {
        next(name for name in parameters if name in ("MC_ROLLRATE_P", "ATC_RAT_RLL_P")): 0.05
    }
    flown = [
        fly(scenario_from_table(table | {"vehicle": vehicle | {"parameters": one}})).rates
        for one in ({}, parameters, changed_parameters)
    ]
    rates_by_own_controller = flown[0]
    difference = flown[1] - flown[0]
    difference_with_lower_gain = flown[2] - flown[0]
    assert (
        difference.std(0).max()
        < 0.06 * rates_by_own_controller[:, 0].std()
        < 0.1 * difference_with_lower_gain[:, 0].std()
    )


@mark.slow
@mark.parametrize("instruments", [False, param(True, marks=mark.in_full)])
def test_a_parameter_set_in_flight_is_flown_from_then_on(instruments):
    """The attitude gain of one of two flights is lowered, so that its rates stay smaller."""
    parameters = {"IMU_GYRO_RATEMAX": 100.0}
    spec = {
        "duration": 16,
        "vehicle": {"parameters": parameters},
        "stream": {"instruments": instruments},
    }
    spec["excitation"] = {"kind": "doublets", "axis": "roll"}
    changed, unchanged = (simulation_of(scenario_from_table(spec)) for _ in range(2))
    changed.advance(800)
    unchanged.advance(800)
    assert not changed.set_parameter("MC_ROLLRATE_P", -1.0)
    assert not changed.set_parameter("NOTHING", 1.0)
    assert changed.set_parameter("MC_ROLL_P", 2.0)
    slow, fast = (simulation.advance(800) for simulation in (changed, unchanged))
    assert abs(slow.rates[:, 0]).max() < 0.8 * abs(fast.rates[:, 0]).max()
