"""Damage in flight: weak motors, chipped propellers and shifted loads of a scenario, and when each begins."""

from math import sqrt
from typing import NamedTuple

from sitl_scenarios.mishaps.motor_failures import remaining_speed, remaining_thrust_history
from sitl_scenarios.mishaps.specs import LoosePropeller, MotorFade, MotorStop
from sitl_scenarios.motion import Pair
from sitl_scenarios.rotors import rotor_count
from sitl_scenarios.scenario import MISHAP, Scenario
from sitl_scenarios.vectors import Vector4

METRES_PER_MILLIMETRE = 1e-3
"""Factor from the millimetres of a scenario's load to metres."""


class Damage(NamedTuple):
    """All damage of a vehicle at one time: what its rotors still give, and where its centre of mass is."""

    speed: Vector4 = (1.0,) * 4
    """Remaining fraction of each rotor's speed at the same command."""
    thrust: Vector4 = (1.0,) * 4
    """Remaining fraction of each rotor's thrust at the same speed."""
    torque: Vector4 = (1.0,) * 4
    """Remaining fraction of each rotor's torque at the same speed."""
    centre_of_mass: Pair = (0.0, 0.0)
    """Position of the centre of mass forward and right of the published one, m."""


def no_damage(rotors: int) -> Damage:
    """Returns the factors of a sound vehicle, 1 for each of its rotors."""
    undamaged = (1.0,) * rotors
    return Damage(speed=undamaged, thrust=undamaged, torque=undamaged)


class DamageStep(NamedTuple):
    """A time at which the damage of a vehicle changes."""

    time: float
    """Time after the first arming, s."""

    damage: Damage
    """All damage that acts from then on."""


def damage_history(scenario: Scenario) -> list[DamageStep]:
    """Lists the times at which the damage of a scenario's vehicle changes, with all its damage from then on.

    A weak motor, a chipped propeller and a shifted load may begin at different times. Each time is one step, which
    includes all damage so far. If the mishap makes a motor or propeller fail, its steps alone are returned, and other
    damage of the scenario does not act.

    Args:
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.

    Returns:
        The steps in ascending order of time; empty for a sound vehicle.
    """
    if isinstance(scenario.mishap, MotorStop | MotorFade | LoosePropeller):
        return _motor_failure_history(scenario, scenario.mishap)
    start_times = set[float]()
    if scenario.vehicle.weak_motor:
        start_times.add(scenario.vehicle.weak_from)
    if scenario.propeller.motor:
        start_times.add(scenario.propeller.start)
    if scenario.load.forward or scenario.load.right:
        start_times.add(scenario.load.start)
    return [DamageStep(time, _damage_at(scenario, time)) for time in sorted(start_times)]


def _motor_failure_history(
    scenario: Scenario, mishap: MotorStop | MotorFade | LoosePropeller
) -> list[DamageStep]:
    """Lists the damage of a vehicle over time whose mishap makes a motor or propeller fail.

    A motor that fails turns more slowly; a propeller that slips gives less thrust and torque.

    Args:
        scenario: The scenario, with duration and random numbers.
        mishap: Failure of one motor, or of one propeller.

    Returns:
        The steps in ascending order of time, each with the damage from then on.
    """
    rotors = rotor_count(scenario.vehicle.frame)
    thrust_history = remaining_thrust_history(mishap, scenario.duration, scenario.random(MISHAP))
    history = []
    for time, remaining_thrust in thrust_history:
        damage = no_damage(rotors)
        if isinstance(mishap, LoosePropeller):
            factors = _factors_by_rotor(mishap.motor, remaining_thrust, rotors)
            damage = damage._replace(thrust=factors, torque=factors)
        else:
            speed_fraction = remaining_speed(remaining_thrust)
            factors = _factors_by_rotor(mishap.motor, speed_fraction, rotors)
            damage = damage._replace(speed=factors)
        history.append(DamageStep(time, damage))
    return history


def _damage_at(scenario: Scenario, time: float) -> Damage:
    """Collects all damage that acts on a vehicle at a given time.

    A weak motor turns more slowly; a chipped propeller gives less thrust and torque at the same speed; a shifted load
    moves the centre of mass.

    Args:
        scenario: Scenario whose sections on vehicle, propeller and load state what gets damaged, and when.
        time: Time after the first arming, s.

    Returns:
        Factors on the speed, thrust and torque of each rotor, and the displacement of the centre of mass.
    """
    vehicle = scenario.vehicle
    propeller = scenario.propeller
    load = scenario.load
    # Motors are counted from 1; 0 means none.
    weak_motor = vehicle.weak_motor if time >= vehicle.weak_from else 0
    motor_of_chipped_propeller = propeller.motor if time >= propeller.start else 0
    rotors = rotor_count(vehicle.frame)
    centre_of_mass = (0.0, 0.0)
    if time >= load.start:
        centre_of_mass = (
            METRES_PER_MILLIMETRE * load.forward,
            METRES_PER_MILLIMETRE * load.right,
        )
    return Damage(
        # A scenario gives the remaining thrust of a weak motor. It is proportional to the squared speed.
        speed=_factors_by_rotor(weak_motor, sqrt(vehicle.weak_thrust), rotors),
        thrust=_factors_by_rotor(motor_of_chipped_propeller, propeller.thrust, rotors),
        torque=_factors_by_rotor(motor_of_chipped_propeller, propeller.torque, rotors),
        centre_of_mass=centre_of_mass,
    )


def _factors_by_rotor(motor: int, fraction: float, rotors: int) -> Vector4:
    """Lists the factors of a quantity for all rotors, of which at most one is damaged.

    Args:
        motor: Number of the damaged motor, from 1; 0 means none.
        fraction: Remaining fraction of the quantity at this motor's rotor.
        rotors: Number of rotors.

    Returns:
        The ``fraction`` for the damaged rotor, 1 for the others.
    """
    return tuple(fraction if motor == number else 1.0 for number in range(1, rotors + 1))
