"""Trim: by which pattern the motors of one flight work unevenly, and how surely: yaw, centre of gravity, one motor.

A twisted arm or motor is balanced by yaw alone, a centre of gravity beside the middle by roll and pitch, and a weak
motor by its own signature, which is all three in the ratio of its place. Steady wind leans the vehicle and asks for
torque in roll and pitch, too: what the lean explains, by how the balance follows it in this flight, is taken away, and
what it may explain widens the intervals (``mavdem.motors.balance``).
"""

import numpy as np

from mavdem.confidence import half_width
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.motors import Trim
from mavdem.ingest.motors import MotorGeometry, position_name
from mavdem.motors.balance import (
    BLOCK_SECONDS,
    FEWEST_BLOCKS,
    SCATTER,
    SCATTER_FREEDOM,
    BalanceFigures,
    Deviation,
    balance_of_signals,
    level_balances,
    motor_signatures,
)
from mavdem.motors.health import FAULT_RISE, NAMED, PROBABLE, Candidates, lost_thrust

UNEVEN_QUADROTORS = {"healthy": 0.0, "motor": 1.0, "load": 5.0, "yaw": 11.0, "other": 6.0}
"""Of 23 real quadrotors with uneven motors, how many were so by each pattern."""


def trim_of_signals(signals: Signals) -> Fact | None:
    """Returns how even the motors of a vehicle's steady flight are; None without motor outputs."""
    motors = signals.motors
    if motors is None:
        return None
    return trim_of(balance_of_signals(signals), motors.geometry)


def trim_of(balance: BalanceFigures | None, layout: MotorGeometry) -> Fact:
    """Returns by which pattern the motors of a ``layout`` surely work unevenly, as faults; GOOD where none does.

    UNKNOWN where that would not show.
    """
    signatures = motor_signatures(layout)
    if len(signatures.axes) < 4:  # thrust, roll, pitch and yaw
        return Fact(Trim.TRIM_OF_UNKNOWN_PLACES)
    if balance is None:
        return Fact(Trim.TRIM_UNKNOWN, least_duration=FEWEST_BLOCKS * BLOCK_SECONDS)
    (level,), (variance,) = level_balances([balance])
    mixer = np.linalg.pinv(signatures.weights)[:, 1:]
    apart = mixer @ level
    half = half_width(mixer**2 @ variance)
    sure = abs(apart) - half
    most = np.argmax(sure)
    figures = {"shift": level, "deviation": apart[most], "half": half[most]}
    figures["assumed"] = layout.positions_assumed
    if sure[most] <= FAULT_RISE:
        if half.max() > FAULT_RISE:
            return Fact(Trim.TRIM_UNSURE, **figures)
        # the vehicle's own trim may have hidden as much as is even
        hidden = (FAULT_RISE + apart + half) / np.diag(mixer @ signatures.weights[1:])
        return Fact(Trim.TRIM_EVEN, most_loss=lost_thrust(hidden.max()), **figures)
    scale = np.sqrt(SCATTER**2 + variance)
    lean = float(np.linalg.norm(balance.lean))
    away = Deviation(level, scale, SCATTER_FREEDOM, lean)
    weighed = Candidates(signatures, UNEVEN_QUADROTORS).after(away)
    motor = weighed.motors.argmax()
    if weighed.motors[motor] >= NAMED:
        rise = weighed.harder[:, motor]
        return Fact(
            Trim.TRIM_OF_ONE_MOTOR,
            subject=layout.names[motor],
            probability=weighed.motors[motor],
            rise=rise,
            loss=lost_thrust(rise),
            **figures,
        )
    roll, pitch, yaw = level.tolist()
    by_yaw = weighed.shares["yaw"]
    by_load = weighed.shares["load"]
    if by_yaw >= PROBABLE:
        return Fact(Trim.TRIM_OF_YAW, share=yaw, probability=by_yaw, **figures)
    if by_load >= PROBABLE:
        return Fact(
            Trim.TRIM_OF_CENTRE,
            place=position_name((pitch, -roll)),
            share=np.hypot(roll, pitch),
            probability=by_load,
            **figures,
        )
    return Fact(Trim.TRIM_OF_SEVERAL, **figures)
