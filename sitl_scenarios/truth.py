"""Truth: A, B, wind, disturbance and states of a simulated flight, to compare a learnt model with."""

from __future__ import annotations

import os
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.files import atomic_write
from sitl_scenarios.linear import axis
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Axis, Scenario
from sitl_scenarios.vehicles import AIRFRAMES


def truth(scenario: Scenario, motion: Motion) -> dict[str, NDArray[Any]]:
    """Arrays by name.

    Every column of ``Motion``, and

    - ``scenario``: it, as a string of JSON;
    - ``roll_A`` (2, 2), ``roll_B`` (2, 4): ẋ = Ax + B(u − ū) for angle (rad) and rate (rad/s), u in µs, rotors that do
      not lag; ū is ``trim`` (4,), that of hover in still air;
    - ``roll_lag_A`` (3, 3), ``roll_lag_B`` (3, 4): with a third state, the angular acceleration by the rotors, rad/s²,
      which follows the commands with the time constant ``lag`` (mean, rising, falling; s);
    - ``roll_disturbance`` (N,): angular acceleration that wind and moments add to that, rad/s²;
    - likewise ``pitch_…``; and ``yaw_…``, whose only state is the rate, but for the rotors': (1, 1), (1, 4), (2, 2),
      (2, 4).

    About hover in still air; see ``sitl_scenarios.linear``.
    """
    body = AIRFRAMES[scenario.vehicle.model]
    up, down = body.lag
    arrays: dict[str, NDArray[Any]] = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays["scenario"] = np.array(scenario.model_dump_json())
    arrays["trim"] = np.full(4, 1000 + 1000 * body.hover_command / body.full)
    arrays["lag"] = np.array([(up + down) / 2, up, down])
    axes: tuple[Axis, ...] = ("roll", "pitch", "yaw")
    for number, name in enumerate(axes):
        instant, lagging = axis(scenario.vehicle, name, lag=False), axis(scenario.vehicle, name)
        arrays |= {f"{name}_A": instant.A, f"{name}_B": instant.B}
        arrays |= {f"{name}_lag_A": lagging.A, f"{name}_lag_B": lagging.B}
        # The damping by the vehicle's own rate is in A; on the ground nothing moves and nothing acts.
        acting = motion.moment[:, number] / body.inertia[number] - instant.A[-1, -1] * motion.rates[:, number]
        arrays[f"{name}_disturbance"] = acting
    return arrays


def write_truth(path: str | os.PathLike[str], scenario: Scenario, motion: Motion) -> None:
    """Writes :func:`truth` as .npz, whole or not at all; the same flight gives the same bytes.

    Raises OSError: it cannot be written.
    """
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **truth(scenario, motion))
