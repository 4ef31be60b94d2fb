"""Motor commands of the simulated autopilot, its state estimate, and the plan that it follows."""

from functools import cache
from math import radians

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark

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
    at_full_thrust = np.array(mixed_commands(X, (0.3, 0.0, 0.0, 1.0)))
    assert at_full_thrust.max() == approx(1)
    assert at_full_thrust[1] - at_full_thrust[0] == approx(0.6)
    # These demands of roll and pitch exceed the whole range.
    beyond_range = np.array(mixed_commands(X, (0.9, 0.6, 0.0, 0.5)))
    assert beyond_range.min() == approx(IDLE_COMMAND)
    assert beyond_range.max() == approx(1)
    roll = beyond_range @ X.roll
    pitch = beyond_range @ X.pitch
    assert roll / pitch == approx(1.5)
    # For yaw PX4 reduces the thrust only by a part.
    yawing = px4_thrusts(np.array([X.roll, X.pitch, X.yaw]), (0.0, 0.0, 0.3, 0.9))
    assert np.ptp(yawing) == approx(0.5)


def estimated_states(sensors, states):
    estimator = StateEstimator(Scenario(sensors=sensors))
    return [estimator.estimate(state) for state in states]


def test_the_estimated_state_is_late_by_the_delay():
    states = [State(velocity=(float(k), 0.0, 0.0)) for k in range(10)]
    no_noise = {"rate_sd": 0.0, "attitude_sd": 0.0, "position_sd": 0.0, "velocity_sd": 0.0}
    # 10 ms are 2.5 cycles.
    delayed = estimated_states(Sensors(**no_noise, delay=0.010), states)
    assert [state.velocity[0] for state in delayed[3:]] == approx(np.arange(3, 10) - 2.5)
    without_delay = estimated_states(Sensors(**no_noise, delay=0.0), states)
    assert [state.velocity[0] for state in without_delay] == list(range(10))


@mark.slow
def test_the_noise_of_the_estimated_state_has_the_given_deviations():
    sds = {"rates": 0.1, "attitude": 0.02, "position": 0.5, "velocity": 0.3}
    sensors = Sensors(**{f"{name.removesuffix('s')}_sd": sd for name, sd in sds.items()})
    estimates = estimated_states(sensors, [State()] * 20000)
    for name, sd in sds.items():
        values = np.array([getattr(estimate, name) for estimate in estimates])
        if name == "attitude":
            # The vector part of a quaternion is half of a small rotation.
            values = 2 * values[:, 1:]
        # The standard error of a standard deviation of 60000 values is 0.3 %.
        assert values.std() == approx(sd, rel=0.012)


def references_with(excitation, duration=60.0, cycle=CYCLE):
    plan = FlightPlan(Scenario(duration=duration, excitation=excitation))
    return [plan.reference_at(k * cycle) for k in range(round(duration / cycle))]


@cache
def demands_of_kind(kind, axis):
    """The attitudes (N, 3) that an excitation of this kind about an axis demands, in 30 s."""
    (name,) = kind.model_fields["kind"].annotation.__args__
    references = references_with(kind(kind=name, axis=axis), duration=30.0)
    return np.array([reference.attitude_demand for reference in references])


@mark.slow
@mark.parametrize("axis", ["roll", "pitch", "yaw"])
@mark.parametrize("kind", [Doublets, Chirp, Multisine, Sticks])
def test_an_excitation_is_about_its_axis(kind, axis):
    demands = demands_of_kind(kind, axis)
    is_axis = np.array(["roll", "pitch", "yaw"]) == axis
    assert not demands[:, ~is_axis].any()
    demands_of_axis = demands[:, is_axis][:, 0]
    if kind is not Sticks:
        # The same demands on every axis; those of sticks are random.
        assert_array_equal(demands_of_axis, demands_of_kind(kind, "roll")[:, 0])
    assert demands_of_axis.std() > radians(1)


def test_a_chirp_has_as_many_periods_as_its_mean_frequency_implies():
    chirp = Chirp(kind="chirp", lowest=1.0, highest=4.0, period=20.0)
    demands = np.array([reference.attitude_demand[0] for reference in references_with(chirp)])
    demands = demands[: round(50 / CYCLE)]
    excitation = demands[demands != 0]
    last_sweep = excitation[-round(20 / CYCLE) :]
    period_count = np.count_nonzero(np.diff(np.sign(last_sweep))) / 2
    assert period_count == approx(20.0 * 2.5, abs=1)
    assert abs(excitation).max() == approx(radians(chirp.amplitude), rel=1e-3)


def test_doublets_of_all_axes_take_turns():
    doublets = Doublets(kind="doublets", axis="all", period=1.0)
    references = references_with(doublets, duration=30.0)
    demands = np.array([reference.attitude_demand for reference in references])
    assert (demands != 0).sum(axis=1).max() == 1
    assert (demands != 0).any(axis=0).all()


def test_multisines_of_all_axes_share_no_frequency_and_are_orthogonal():
    multisine = Multisine(
        kind="multisine", axis="all", sd=3.0, lowest=0.5, highest=5.0, period=10.0
    )
    demands = np.degrees([reference.attitude_demand for reference in references_with(multisine)])
    # One period in hover.
    demands = demands[round(20 / CYCLE) : round(30 / CYCLE)]
    assert_allclose(np.cov(demands.T, bias=True), 9.0 * np.eye(3), atol=1e-9)
    has_frequency = abs(np.fft.rfft(demands, axis=0)) > 1e-6
    assert has_frequency.sum(axis=0).tolist() == [16, 15, 15]
    assert has_frequency.sum(axis=1).max() == 1


@mark.parametrize("height", [0.6, 1.5, 5.0, 12.0])
def test_a_descent_never_climbs_and_ends_at_the_landing_speed_until_touch_down(height):
    plan = FlightPlan(Scenario(duration=60.0, height=height))
    landing = [plan.reference_at(time) for time in np.arange(40, 65, CYCLE)]
    heights = np.array([reference.height for reference in landing])
    rates = np.array([reference.climb_rate for reference in landing])
    assert_allclose(np.diff(heights) / CYCLE, (rates[1:] + rates[:-1]) / 2, atol=1e-3)
    assert rates.max() == 0
    assert heights[0] == height
    assert (rates[heights < 0.3] == -LANDING_SPEED).all()
    assert heights[-1] < -2
    # Touch-down is planned a second before disarming.
    assert heights[round((60 - 1 - 40) / CYCLE)] == approx(0, abs=0.01)


@mark.slow
def test_sticks_move_independently_with_the_given_deviation_and_time():
    cycle = 0.02
    references = references_with(Sticks(kind="sticks", axis="all"), 600.0, cycle)
    demands = np.degrees(
        [reference.attitude_demand for reference in references if reference.by_stick]
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
def test_a_controller_from_the_reported_parameters_flies_like_the_default_controller(autopilot):
    vehicle = {"quadratic_thrust": 0.4, "frame": "plus"}
    table = {
        "duration": 15,
        "vehicle": vehicle,
        "excitation": {"kind": "doublets"},
        "stream": {"autopilot": autopilot},
    }
    reported_parameters = {
        name: value
        for name, value in control_parameters(scenario_from_table(table)).items()
        if CONTROL_PARAMETERS.match(name)
    }
    roll_p = "MC_ROLLRATE_P" if autopilot == "px4" else "ATC_RAT_RLL_P"
    assert roll_p in reported_parameters

    def rates_with(parameters):
        """The body rates of a flight with the controller of these parameters; the default one without any."""
        scenario = table | {"vehicle": vehicle | {"parameters": parameters}}
        return fly(scenario_from_table(scenario)).rates

    rates = rates_with({})
    difference = rates_with(reported_parameters) - rates
    difference_by_low_gain = rates_with(reported_parameters | {roll_p: 0.05}) - rates
    assert difference.std(axis=0).max() < 0.06 * rates[:, 0].std()
    assert 0.06 * rates[:, 0].std() < 0.1 * difference_by_low_gain[:, 0].std()


@mark.slow
@mark.parametrize("instruments", [False, True])
def test_a_parameter_set_in_flight_is_flown_from_then_on(instruments):
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
