"""Replay: simulated attitude and body rates of a vehicle that follows logged setpoints under a logged wind torque.

The digital twin of a logged vehicle is compared with its log in this way. Only vertical speed, height and attitude are
controlled: a mean wind would move the vehicle, not turn it.
"""

from math import cos

import numpy as np

from sitl_scenarios.dynamics import AirState, Body, State
from sitl_scenarios.flight_simulation import tumbles
from sitl_scenarios.motion import Array
from sitl_scenarios.parameter_controller import controller_for, gyro_for
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import StateEstimator
from sitl_scenarios.vectors import Vector3, euler_angles
from sitl_scenarios.vehicles import GRAVITY, airframe

CLIMB_GAIN = 1.5
"""Gain of the specific thrust by the vertical speed, 1/s: slower than the motions that are replayed."""

HEIGHT_GAIN = 0.6
"""Gain of the specific thrust by the height, 1/s²: slower than the motions that are replayed."""

MIN_LIFT = GRAVITY / 5
"""Smallest specific vertical thrust, m/s²: the rotors never stop."""

SAMPLE_TOLERANCE = 1e-6
"""Time by which a cycle may begin before a sample and still count as beginning at it, in samples: for rounding only."""

MIN_UPRIGHT_COSINE = 0.5
"""Smallest cosine of the tilt by which the vertical thrust is divided: 60° of tilt."""


def replay_setpoints(
    scenario: Scenario, dt: float, setpoints: Array, torque: Array, *, is_estimated: bool = True
) -> Array:
    """Simulates how a vehicle follows setpoints of roll and pitch under a torque of the wind.

    The vehicle begins at rest in hover and flies by its autopilot's attitude and rate control. A slow control of
    vertical speed and height holds it up; nothing holds its horizontal position or its heading.

    Args:
        scenario: Only its vehicle, sensors, autopilot and seed count.
        dt: Sampling period of all arrays, s.
        setpoints: (T, 3, 2) for roll, pitch and yaw: the angle, rad, and a body rate, rad/s, that is added to the rate
            setpoint of the attitude controller. The angle of yaw is not used: the heading is not held.
        torque: (T, 3) torque of the wind by the moments of inertia, rad/s².
        is_estimated: Whether the motion is the autopilot's estimate, with the noise of its sensors, as a log has it;
            else it is the true one.

    Returns:
        (T, 3, 2) angles of roll, pitch and yaw, rad, and body rates, rad/s.

    Raises:
        ValueError: The vehicle tumbles.
    """
    cycle = scenario.cycle
    airframe_body = airframe(scenario.vehicle)
    body = Body(scenario.vehicle, cycle)
    controller = controller_for(scenario)
    gyro = gyro_for(controller)
    estimator = StateEstimator(scenario)
    cycles = round(len(torque) * dt / cycle)
    # Times of the cycles, in samples of the arrays.
    cycle_times = np.arange(cycles, dtype=np.float64) * cycle / dt
    inputs = _inputs_by_cycle(cycle_times, setpoints, torque, airframe_body.inertia)
    state = State(rotors=(airframe_body.hover_speed,) * airframe_body.rotors)
    motion = []
    for row in inputs.tolist():
        roll_setpoint, pitch_setpoint, _, p, q, r, roll_moment, pitch_moment, yaw_moment = row
        # The autopilot measures the state by its sensors, and the rates after the gyro's filters.
        estimate = estimator.estimate(state._replace(rates=gyro.filtered_rates))
        angles = euler_angles(estimate.attitude)
        roll, pitch, yaw = angles
        if is_estimated:
            motion.append((angles, estimate.rates))
        else:
            motion.append((euler_angles(state.attitude), state.rates))
        # A vehicle that sinks or is too low gets more thrust, and a tilted one more still to lift as much.
        _, _, sink_speed = state.velocity
        _, _, depth = state.position
        lift = GRAVITY + CLIMB_GAIN * sink_speed + HEIGHT_GAIN * depth
        upright = max(cos(roll) * cos(pitch), MIN_UPRIGHT_COSINE)
        thrust = airframe_body.mass * max(lift, MIN_LIFT) / upright
        # The setpoint of yaw is the heading itself: its loop only follows the rates.
        control = controller.attitude_control(
            estimate, (roll_setpoint, pitch_setpoint, yaw), (p, q, r), thrust, is_flying=True
        )
        air = AirState(roll=roll_moment, pitch=pitch_moment, yaw=yaw_moment)
        settled_speeds = body.settled_speeds(control.outputs, 1.0)
        state = gyro.advance(body, state, settled_speeds, air)
        if tumbles(state):
            raise ValueError("the vehicle is out of control: it needs other gains")
    # Each sample gets the motion at the cycle that begins at it or next; the tolerance keeps rounding out.
    samples = np.arange(len(torque))
    rows = np.searchsorted(cycle_times, samples - SAMPLE_TOLERANCE).clip(max=len(motion) - 1)
    # Each motion is (angles, rates) of three axes, (2, 3): the axes come first in the result.
    return np.array(motion)[rows].mT


def _inputs_by_cycle(
    cycle_times: Array, setpoints: Array, torque: Array, inertia: Vector3
) -> Array:
    """Interpolates setpoints and wind moments linearly at the cycles of the autopilot.

    Logs are sampled more slowly than the autopilot's loop runs.

    Args:
        cycle_times: (C,) times of the cycles, in samples: 1.5 is half-way between the second and the third sample.
        setpoints: (T, 3, 2) angles, rad, and rates, rad/s, of roll, pitch and yaw.
        torque: (T, 3) wind torque divided by the moments of inertia, rad/s².
        inertia: Moments of inertia (3,) about the body axes, kg m².

    Returns:
        (C, 9) angles, rad, rates, rad/s, and moments, N m, at the cycles.
    """
    samples = np.arange(len(torque))
    moments = torque * inertia
    angles = setpoints[..., 0]
    rates = setpoints[..., 1]
    inputs = np.column_stack([angles, rates, moments])
    return np.column_stack([np.interp(cycle_times, samples, column) for column in inputs.T])
