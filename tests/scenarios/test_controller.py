"""What the autopilot asks of motors, and the plan it follows."""

from math import radians

import numpy as np
import pytest

from sitl_scenarios.dynamics import IDLE_COMMAND, State, frame, mix
from sitl_scenarios.plan import FULL_STICK, Plan
from sitl_scenarios.scenario import Chirp, Doublets, Multisine, Scenario, Sensors, Sticks
from sitl_scenarios.sensors import Sensing

X = frame("x", (0.1, 0.1))
CYCLE = 0.004


def test_roll_to_the_right_speeds_up_the_motors_on_the_left():
    assert mix(X, (0.1, 0.0, 0.0, 0.5)) == pytest.approx((0.4, 0.6, 0.6, 0.4))
    assert mix(X, (0.0, 0.1, 0.0, 0.5)) == pytest.approx((0.6, 0.4, 0.6, 0.4))
    assert mix(X, (0.0, 0.0, 0.1, 0.5)) == pytest.approx((0.6, 0.6, 0.4, 0.4))


def test_saturation_takes_thrust_first_and_keeps_the_demands_in_proportion():
    full = np.array(mix(X, (0.3, 0.0, 0.0, 1.0)))
    assert full.max() == pytest.approx(1)
    assert full[1] - full[0] == pytest.approx(0.6)
    beyond = np.array(mix(X, (0.9, 0.6, 0.0, 0.5)))
    assert beyond.min() == pytest.approx(IDLE_COMMAND)
    assert beyond.max() == pytest.approx(1)
    roll, pitch = beyond @ X.roll, beyond @ X.pitch
    assert roll / pitch == pytest.approx(1.5)


def sensed(sensors, states, seed=0):
    sensing = Sensing(sensors, CYCLE, np.random.default_rng(seed))
    return [sensing.estimate(state) for state in states]


def test_what_is_known_is_late_by_the_delay():
    states = [State(velocity=(float(k), 0.0, 0.0)) for k in range(10)]
    quiet = {"rate_sd": 0.0, "attitude_sd": 0.0, "position_sd": 0.0, "velocity_sd": 0.0}
    known = sensed(Sensors(**quiet, delay=0.010), states)
    assert [each.velocity[0] for each in known[3:]] == pytest.approx(np.arange(3, 10) - 2.5)
    at_once = sensed(Sensors(**quiet, delay=0.0), states)
    assert [each.velocity[0] for each in at_once] == list(range(10))


def test_what_is_known_is_as_noisy_as_asked():
    sensors = Sensors(rate_sd=0.1, attitude_sd=0.02, position_sd=0.5, velocity_sd=0.3)
    known = sensed(sensors, [State()] * 20000)
    # The standard error of a standard deviation of 60000 values is 0.3 %.
    assert np.std([each.rates for each in known]) == pytest.approx(0.1, rel=0.012)
    assert np.std([each.velocity for each in known]) == pytest.approx(0.3, rel=0.012)
    assert np.std([each.position for each in known]) == pytest.approx(0.5, rel=0.012)
    assert 2 * np.std([each.attitude[1:] for each in known]) == pytest.approx(0.02, rel=0.012)


def excited(excitation, duration=60.0):
    plan = Plan(Scenario(duration=duration, excitation=excitation), CYCLE)
    return [plan.at(k * CYCLE) for k in range(round(duration / CYCLE))]


def test_a_flight_takes_off_hovers_and_lands():
    states = [wanted.landed_state for wanted in excited(None)]
    assert list(dict.fromkeys(states)) == [1, 3, 2, 4]
    assert max(wanted.height for wanted in excited(None)) == pytest.approx(5)
    # A climb's rate is that of its height.
    heights = np.array([wanted.height for wanted in excited(None)])
    climbs = np.array([wanted.climb for wanted in excited(None)])
    assert np.allclose(np.gradient(heights, CYCLE)[1:-1], climbs[1:-1], atol=0.01)


def test_a_multisine_has_its_power_where_it_should_and_a_low_peak():
    wanted = Multisine(kind="multisine", sd=2.0, lowest=0.5, highest=4.0, period=10.0)
    rolls = np.degrees([at.demand[0] for at in excited(wanted)])
    period = rolls[round(20 / CYCLE) : round(30 / CYCLE)]
    assert period.std() == pytest.approx(2)
    assert np.abs(period).max() < 2.2 * 2
    power = np.abs(np.fft.rfft(period)) ** 2
    inside = power[5:41]
    assert inside.sum() == pytest.approx(power.sum())
    assert inside == pytest.approx(inside.mean())


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
@pytest.mark.parametrize("kind", [Doublets, Chirp, Multisine, Sticks])
def test_an_excitation_is_about_its_axis(kind, axis):
    (name,) = kind.model_fields["kind"].annotation.__args__
    demands = np.array([at.demand for at in excited(kind(kind=name, axis=axis), duration=30.0)])
    about = np.array(["roll", "pitch", "yaw"]) == axis
    assert not demands[:, ~about].any()
    rolls = np.array([at.demand[0] for at in excited(kind(kind=name), duration=30.0)])
    if kind is not Sticks:
        np.testing.assert_array_equal(demands[:, about][:, 0], rolls)
    assert demands[:, about].std() > radians(1)


def test_multisines_of_all_axes_share_no_frequency_and_are_orthogonal():
    wanted = Multisine(kind="multisine", axis="all", sd=3.0, lowest=0.5, highest=5.0, period=10.0)
    demands = np.degrees([at.demand for at in excited(wanted)])[round(20 / CYCLE) : round(30 / CYCLE)]
    np.testing.assert_allclose(np.cov(demands.T, bias=True), 9.0 * np.eye(3), atol=1e-9)
    power = np.abs(np.fft.rfft(demands, axis=0)) > 1e-6
    assert power.sum(0).tolist() == [16, 15, 15]
    assert power.sum(1).max() == 1


@pytest.mark.slow
def test_sticks_move_as_slowly_as_asked_and_each_for_itself():
    wanted = Sticks(kind="sticks", axis="all", sd=4.0, s=0.25)
    flown = excited(wanted, duration=600.0)
    hover = [at for at in flown if at.by_stick]
    assert {at.demand for at in flown if not at.by_stick} == {(0.0, 0.0, 0.0)}
    assert len(hover) * CYCLE == pytest.approx(587, abs=0.5)
    demands = np.degrees([at.demand for at in hover])
    # 587 s hold about 587/(2√π 0.25) = 660 independent values: standard errors of 2.8 % and of 0.04.
    assert demands.std(0) == pytest.approx([4, 4, 4], rel=0.11)
    assert np.abs(np.corrcoef(demands.T) - np.eye(3)).max() < 0.16
    # The derivative of Gaussian-kernel noise has the standard deviation 1/(√2 s).
    assert (np.diff(demands, axis=0) / CYCLE).std(0) == pytest.approx(4 / (2**0.5 * 0.25) * np.ones(3), rel=0.11)
    assert not any(at.by_stick for at in excited(Doublets(kind="doublets")))


def test_sticks_follow_from_the_seed_and_stop_at_their_ends():
    wanted = Sticks(kind="sticks", axis="roll", sd=30.0, s=0.1)
    plans = [Plan(Scenario(duration=30.0, seed=seed, excitation=wanted), CYCLE) for seed in (3, 3, 4)]
    first, again, other = (np.array([plan.at(k * CYCLE).demand for k in range(2000, 4000)]) for plan in plans)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.abs(first[:, 0]).max() == FULL_STICK[0]
