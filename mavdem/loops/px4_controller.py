"""PX4's rate and attitude controller of one axis, read from the autopilot's parameters.

Sources: ``RateControl``, ``ControlAllocation``, ``ControlAllocationPseudoInverse`` and ``VehicleAngularVelocity`` of
https://github.com/PX4/PX4-Autopilot.
"""

from collections.abc import Iterator
from functools import lru_cache
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.errors import NotLearnable
from mavdem.facts.loops import ControllerFact
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import (
    LOOP_RATE_PARAMETERS,
    MIN_LOOP_RATE,
    MOTOR_COUNT,
    ControllerFields,
    GainNames,
    Notch,
    required_parameters,
)

UNSET_LOOP_RATE = 400.0
"""Rate of the rate loop if the log lacks ``IMU_GYRO_RATEMAX``, Hz: that parameter's default."""
GYRO_FILTER_RATE = 8000.0
"""Rate at which the gyro is filtered, Hz: its drivers filter every sample of the sensor's own buffer."""
GYRO_NOTCH_PARAMETERS = (
    ("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW"),
    ("IMU_GYRO_NF1_FRQ", "IMU_GYRO_NF1_BW"),
    ("IMU_GYRO_NF_FREQ", "IMU_GYRO_NF_BW"),
)
"""Centre and bandwidth of each static notch of the gyro, Hz; the last belongs to older versions, which had one."""
DERIVATIVE_FILTER = "IMU_DGYRO_CUTOFF"
"""Name of the cut-off frequency of the derivative's low-pass."""
OLDER_DERIVATIVE_FILTER = "MC_DTERM_CUTOFF"
"""The same in PX4 before v1.11, in ``mc_att_control_params.c``."""
MAX_CONDITION_NUMBER = 1e6
"""Largest condition number of the matrix of the motors' effects: beyond, motors cannot control each torque alone."""
MIN_RELATIVE_EFFECT = 1e-3
"""Least element of the mixer that is not 0, relative to the largest: smaller ones are rounding errors."""


def px4_controller(parameters: Parameters, axis: str, *, is_demand: bool) -> ControllerFields:
    """Returns the fields of a :class:`mavdem.loops.controllers.Controller` with PX4's parameters.

    Args:
        parameters: values of the ``CONTROL_PARAMETERS`` by the autopilot's names.
        axis: "roll", "pitch" or "yaw".
        is_demand: whether outputs are the demand itself, so that no mixer is needed.

    Returns:
        Values of the controller's fields by name.

    Raises:
        NotLearnable: a parameter is missing, or the mixer is not a quadrotor's.
    """
    gain_names = px4_gain_names(axis)
    prefix = gain_names.rate_prefix
    has_only_older_filter = (
        DERIVATIVE_FILTER not in parameters and OLDER_DERIVATIVE_FILTER in parameters
    )
    derivative_filter = OLDER_DERIVATIVE_FILTER if has_only_older_filter else DERIVATIVE_FILTER
    names = {
        "p": f"{prefix}P",
        "i": f"{prefix}I",
        "d": f"{prefix}D",
        "angle_gain": gain_names.angle_gain,
        "derivative_filter": derivative_filter,
        "thrust_expo": "THR_MDL_FAC",
    }
    gains = dict(zip(names, required_parameters(parameters, *names.values()), strict=True))
    # MC_ROLLRATE_K is a factor of P, I and D together.
    common_factor = parameters.get(f"{prefix}K", 1.0)
    for gain in ("p", "i", "d"):
        gains[gain] = common_factor * gains[gain]
    loop_rate = parameters.get(LOOP_RATE_PARAMETERS["px4"], UNSET_LOOP_RATE)
    # A demand is the torque itself, which no mixer distributes to motors.
    mixer: Numbers = (1.0,)
    if not is_demand:
        mixer = _mixer_of_airframe(_airframe_parameters(parameters))[axis]
    return {
        "parameter_names": names,
        **gains,
        "ff": parameters.get(f"{prefix}FF", 0.0),
        "derivative_of_error": False,
        "output_filter": parameters.get("MC_YAW_TQ_CUTOFF", 0.0) if axis == "yaw" else 0.0,
        "gyro_filter": parameters.get("IMU_GYRO_CUTOFF", 0.0),
        "gyro_rate": GYRO_FILTER_RATE,
        "notches": tuple(_gyro_notches(parameters)),
        "loop_period": 1 / max(loop_rate, MIN_LOOP_RATE),
        "mixer": mixer,
    }


def _gyro_notches(parameters: Parameters) -> Iterator[Notch]:
    """Yields PX4's static notch filters of the gyro that are on.

    Args:
        parameters: parameters of the log, by name. A filter is off if its centre or its bandwidth, both in Hz, is 0.
    """
    for frequency_name, bandwidth_name in GYRO_NOTCH_PARAMETERS:
        frequency = parameters.get(frequency_name, 0.0)
        bandwidth = parameters.get(bandwidth_name, 0.0)
        if frequency > 0 and bandwidth > 0:
            # PX4's notches take all of the signal at their centre.
            yield Notch(frequency, bandwidth, attenuation=inf)


def px4_gain_names(axis: str) -> GainNames:
    """Returns how PX4 names the gains of one axis, as "MC_ROLLRATE_…" and "MC_ROLL_P".

    Args:
        axis: "roll", "pitch" or "yaw".
    """
    return GainNames(rate_prefix=f"MC_{axis.upper()}RATE_", angle_gain=f"MC_{axis.upper()}_P")


def _airframe_parameters(parameters: Parameters) -> tuple[tuple[str, float], ...]:
    """Returns the parameters that describe the airframe, which begin with ``CA_`` (control allocation).

    Args:
        parameters: parameters of the log, by name.

    Returns:
        Names and values (in PX4's units), sorted by name: a tuple, so that it can be the key of a cache.

    Raises:
        NotLearnable: there are none, as in firmware before PX4 v1.14, which has the mixer in a file.
    """
    airframe = tuple(sorted(item for item in parameters.items() if item[0].startswith("CA_")))
    if not airframe:
        raise NotLearnable(ControllerFact.MIXER_IN_FILE)
    return airframe


@lru_cache
def _mixer_of_airframe(airframe: tuple[tuple[str, float], ...]) -> dict[str, Numbers]:
    """Returns PX4's mixer: the thrust of each motor for a torque demand of 1 about each axis.

    It is the inverse of the matrix of the motors' effects, normalised as in
    ``ControlAllocationPseudoInverse::updateControlAllocationMatrixScale``: the columns of roll and pitch by the larger
    of their two norms √(Σ thrust² / pairs of motors that act on the axis), the column of yaw by its largest element.
    Results are cached, since a search for gains builds hundreds of controllers of one airframe.

    Args:
        airframe: parameters of the airframe with their values in PX4's units, such as the positions of the motors, m.

    Returns:
        Thrusts of the motors (4,) by axis, as fractions of their maximum.

    Raises:
        NotLearnable: a parameter is missing, or the vehicle is no quadrotor with upright motors of one size that
            controls roll and pitch.
    """
    unknown_mixer = NotLearnable(ControllerFact.MIXER_UNKNOWN, autopilot="px4")
    parameters = dict(airframe)
    effects = _motor_effects(parameters)
    if not _has_equal_upright_motors(parameters):
        raise unknown_mixer
    if np.linalg.cond(effects) > MAX_CONDITION_NUMBER:
        raise unknown_mixer
    # The inverse has a row for each motor, and columns for roll, pitch and yaw torque, and for total thrust.
    thrust_by_torque = np.linalg.inv(effects)[:, :3]
    # Roll and pitch share a scale; a motor acts on an axis if its thrust for the axis is not just rounding.
    thrust_by_tilt = thrust_by_torque[:, :2]
    acts_on_tilt = np.abs(thrust_by_tilt) > MIN_RELATIVE_EFFECT * np.abs(thrust_by_torque).max()
    if not acts_on_tilt.any(axis=0).all():
        raise unknown_mixer
    squared_norms = (thrust_by_tilt**2).sum(axis=0)
    motor_pairs = acts_on_tilt.sum(axis=0) / 2
    tilt_scale = np.sqrt(squared_norms / motor_pairs).max()
    yaw_scale = thrust_by_torque[:, 2].max()
    normalised_mixer = thrust_by_torque / [tilt_scale, tilt_scale, yaw_scale]
    roll, pitch, yaw = normalised_mixer.T.tolist()
    return {"roll": tuple(roll), "pitch": tuple(pitch), "yaw": tuple(yaw)}


def _motor_effects(parameters: Parameters) -> Array:
    """Returns the torques and the thrust that each motor's thrust causes, by the positions in PX4's parameters.

    ``CA_ROTORn_PX`` and ``PY`` are the distances forward and right of the centre of mass, m, and ``KM`` is the yaw
    moment per thrust. Thrust on the right rolls the vehicle to the left, thrust in front lifts the nose.

    Args:
        parameters: parameters of the log, by name.

    Returns:
        Effects (4, 4), with a column for each motor, and rows for roll, pitch and yaw torque, and for total thrust.

    Raises:
        NotLearnable: a parameter is missing.
    """
    rotors = [f"CA_ROTOR{number}_" for number in range(MOTOR_COUNT)]
    forward = required_parameters(parameters, *(f"{rotor}PX" for rotor in rotors))
    right = required_parameters(parameters, *(f"{rotor}PY" for rotor in rotors))
    yaw_moment = required_parameters(parameters, *(f"{rotor}KM" for rotor in rotors))
    return np.array([np.negative(right), forward, yaw_moment, np.ones(MOTOR_COUNT)])


def _has_equal_upright_motors(parameters: Parameters) -> bool:
    """Returns whether the airframe is a quadrotor whose motors point upwards and have one thrust coefficient.

    The matrix of ``_motor_effects`` is valid only then. ``CA_ROTORn_AX`` and ``AY`` tilt a motor's axis, ``CT`` is its
    thrust coefficient, and a ``CA_AIRFRAME`` of 0 is a multirotor.

    Args:
        parameters: parameters of the log, by name.
    """
    rotors = [f"CA_ROTOR{number}_" for number in range(MOTOR_COUNT)]
    is_tilted = any(
        parameters.get(f"{rotor}AX", 0.0) or parameters.get(f"{rotor}AY", 0.0) for rotor in rotors
    )
    thrust_coefficients = {parameters.get(f"{rotor}CT", 0.0) for rotor in rotors}
    is_multirotor = not parameters.get("CA_AIRFRAME", 0.0)
    has_four_motors = parameters.get("CA_ROTOR_COUNT") == MOTOR_COUNT
    return is_multirotor and has_four_motors and not is_tilted and len(thrust_coefficients) == 1
