"""Truth: A, B, wind, disturbance and states of a simulated flight, to compare a learnt model with."""

from __future__ import annotations

import os
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavdem.files import atomic_write
from sitl_scenarios.dynamics import SOUND, damages
from sitl_scenarios.holding import IN_AIR
from sitl_scenarios.linear import axis, rotor_effects
from sitl_scenarios.mixer import MAX_PULSE, MIN_PULSE
from sitl_scenarios.motion import Array, Motion
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.scenario import Axis, Scenario
from sitl_scenarios.sensors import vibration
from sitl_scenarios.simulation import CYCLES
from sitl_scenarios.vehicles import CHARGED, airframe

AXES: tuple[Axis, ...] = ("roll", "pitch", "yaw")


def truth(scenario: Scenario, motion: Motion) -> dict[str, NDArray[Any]]:
    """Arrays by name.

    Every column of ``Motion``, and

    - ``scenario``: it, as a string of JSON;
    - ``roll_A`` (2, 2), ``roll_B`` (2, 4): ẋ = Ax + B(u − ū) for angle (rad) and rate (rad/s), u in µs, rotors that do
      not lag; ū is ``trim`` (4,), that of hover in still air;
    - ``roll_lag_A`` (3, 3), ``roll_lag_B`` (3, 4): with a third state, the angular acceleration by the rotors, rad/s²,
      which follows the commands with the time constant ``lag`` (mean, rising, falling; s);
    - ``roll_disturbance`` (N,): angular acceleration that wind and moments add to that, rad/s²;
    - ``roll_effect`` (4,): roll acceleration by each motor's command, rad/s² per µs, at the mean commands, rotor speeds
      and air of the hover, which in wind is tilted; where something breaks in hover, until the first does, and
      ``roll_effect_weak`` from the last on; ``weak`` (N,) says when;
    - ``speed_left``, ``thrust_left``, ``torque_left`` (N, 4): of each motor and its propeller, shares of the sound
      ones': of the rotor's speed at a command, of thrust and torque at a speed; ``centre`` (N, 2): how far forward and
      right the centre of mass is moved, m; ``vibration`` (N, 3): what an unbalanced propeller adds, RMS, m/s²;
    - ``delay``: from a command to the measurement of what it does, s: that of the sensors, and half the autopilot's
      cycle, for which a command is held;
    - ``voltage`` (N,) of the battery, V;
    - likewise ``pitch_…``; and ``yaw_…``, whose only state is the rate, but for the rotors': (1, 1), (1, 4), (2, 2),
      (2, 4).

    About hover in still air; see ``sitl_scenarios.linear``.
    """
    body = airframe(scenario.vehicle)
    up, down = body.lag
    arrays: dict[str, NDArray[Any]] = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays["scenario"] = np.array(scenario.model_dump_json())
    arrays["trim"] = np.full(4, 1000 + 1000 * body.hover_command / body.full)
    arrays |= _effects(scenario, motion) | _damage(scenario, motion) | {"vibration": vibration(scenario, motion)}
    arrays["delay"] = np.array(scenario.sensors.delay + CYCLES[scenario.stream.speaks] / 2)
    arrays["voltage"] = CHARGED * motion.battery
    arrays["lag"] = np.array([(up + down) / 2, up, down])
    for number, name in enumerate(AXES):
        instant, lagging = axis(scenario.vehicle, name, lag=False), axis(scenario.vehicle, name)
        arrays |= {f"{name}_A": instant.A, f"{name}_B": instant.B}
        arrays |= {f"{name}_lag_A": lagging.A, f"{name}_lag_B": lagging.B}
        # The damping by the vehicle's own rate is in A; on the ground nothing moves and nothing acts.
        acting = motion.moment[:, number] / body.inertia[number] - instant.A[-1, -1] * motion.rates[:, number]
        arrays[f"{name}_disturbance"] = acting
    return arrays


def _damage(scenario: Scenario, motion: Motion) -> dict[str, NDArray[Any]]:
    """``weak``, what is left of every motor, and the centre of mass."""
    begins = [(BOOT_SECONDS + begin, condition) for begin, condition in damages(scenario)]
    left = [SOUND, *(condition for _, condition in begins)]
    number = np.searchsorted([begin for begin, _ in begins], motion.time, side="right")
    parts = {f"{name}_left": np.array([getattr(one, name) for one in left]) for name in ("speed", "thrust", "torque")}
    parts["centre"] = np.array([one.centre for one in left])
    last = len(begins) if begins else 1
    return {name: values[number] for name, values in parts.items()} | {"weak": number >= last}


def _effects(scenario: Scenario, motion: Motion) -> dict[str, Array]:
    """``roll_effect`` and its likes."""
    spec, body, found = scenario.vehicle, airframe(scenario.vehicle), dict[str, Array]()
    hover, begins = motion.landed_state == IN_AIR, damages(scenario)
    parts = {"": (hover, SOUND)}
    if begins:
        (first, _), (last, condition) = begins[0], begins[-1]
        before, after = hover & (motion.time < BOOT_SECONDS + first), hover & (motion.time >= BOOT_SECONDS + last)
        # Where it is broken in all of the hover, there is one part of it.
        parts = {"": (before, SOUND), "_weak": (after, condition)} if before.any() else {"": (after, condition)}
    for suffix, (rows, condition) in parts.items():
        if not rows.any():
            continue
        turned = Rotation.from_quat(motion.attitude[rows], scalar_first=True)
        air = turned.inv().apply(motion.wind[rows] - motion.velocity[rows]).mean(0)
        per_speed = rotor_effects(spec, motion.rotor_speeds[rows].mean(0), air, condition)
        commands = body.full * (motion.outputs[rows].mean(0) - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
        slopes = np.array([body.speed_slope(command) for command in commands.tolist()]) * condition.speed
        slopes *= motion.battery[rows].mean() * body.full / (MAX_PULSE - MIN_PULSE)
        for name, row in zip(AXES, per_speed * slopes, strict=True):
            found[f"{name}_effect{suffix}"] = row
    return found


def write_truth(path: str | os.PathLike[str], scenario: Scenario, motion: Motion) -> None:
    """Writes :func:`truth` as .npz, whole or not at all; the same flight gives the same bytes.

    Raises OSError: it cannot be written.
    """
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **truth(scenario, motion))
