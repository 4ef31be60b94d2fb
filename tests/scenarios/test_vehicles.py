"""Vehicles hover where their sources say, and their rotors are where both autopilots count them."""

import pytest

from mavdem.ingest.geometry import layout
from sitl_scenarios.frames import PAPER_ORDER, SPINS, frame
from sitl_scenarios.vehicles import AIRFRAMES, ARDRONE2, GRAVITY


@pytest.mark.parametrize("name", AIRFRAMES)
def test_a_vehicle_can_hover_and_half_as_much_again(name):
    body = AIRFRAMES[name]
    weight = body.mass * GRAVITY
    assert 4 * body.thrust_at(body.hover_speed) == pytest.approx(weight)
    assert body.rotor_speed(body.hover_command) == pytest.approx(body.hover_speed)
    assert 0.5 * body.full < body.hover_command < 0.75 * body.full
    assert 4 * body.thrust_at(body.rotor_speed(body.full)) > 1.5 * weight


def test_the_ardrone_hovers_at_its_published_pwm():
    assert ARDRONE2.hover_command == pytest.approx(169.06, abs=0.1)


def test_the_ardrone_has_the_papers_motor_effect_at_the_published_pwm():
    (a, b), (slope, _) = ARDRONE2.thrust, ARDRONE2.speed
    per_pwm = (2 * a * ARDRONE2.rotor_speed(169.06) + b) * slope
    assert round(per_pwm * ARDRONE2.arm[1] / ARDRONE2.inertia[0], 4) == 0.3748


@pytest.mark.parametrize("kind, frame_type", [("x", 1), ("plus", 0)])
def test_rotors_are_counted_as_ardupilot_does(kind, frame_type):
    functions = {f"SERVO{i}_FUNCTION": 32.0 + i for i in range(1, 5)}
    parameters = {**functions, "FRAME_CLASS": 1.0, "FRAME_TYPE": float(frame_type)}
    known = layout("QUADROTOR", "ARDUPILOTMEGA", parameters, (1, 2, 3, 4), 8)
    ours = frame(kind, (1.0, 1.0))
    for rotor, (forward, right) in enumerate(known.positions):
        length = (ours.forward[rotor] ** 2 + ours.right[rotor] ** 2) ** 0.5
        assert (ours.forward[rotor] / length, ours.right[rotor] / length) == pytest.approx((forward, right), abs=1e-6)


@pytest.mark.parametrize("kind", ["x", "plus"])
def test_demands_are_independent_of_each_other(kind):
    ours = frame(kind, (0.1, 0.2))
    for one, other in [(ours.roll, ours.pitch), (ours.roll, ours.yaw), (ours.pitch, ours.yaw)]:
        assert sum(a * b for a, b in zip(one, other, strict=True)) == 0
    assert sum(ours.roll) == sum(ours.pitch) == sum(ours.yaw) == 0
    assert ours.yaw == SPINS


def test_the_papers_order_is_clockwise_from_the_front_left():
    places = frame("x", (1.0, 1.0))
    around = [(places.forward[i], places.right[i]) for i in PAPER_ORDER]
    assert around == [(1, -1), (1, 1), (-1, 1), (-1, -1)]
