"""Lean on the ground: a misaligned autopilot reads it in the hover too, and there it looks like wind."""

import numpy as np
from hover import Hover, changed, columns
from pytest import approx, mark

from mavdem.dataset.attitude import attitude_from_messages
from mavdem.dataset.axes import AXES, YAW
from mavdem.dataset.signals import Signals
from mavdem.facts.online import DragSource
from mavdem.wind_velocity.from_log import wind_evidence
from mavdem.wind_velocity.ground_lean import lean_on_ground, with_lean_on_ground
from mavdem.wind_velocity.vehicle_drag import Drag

HOVER = Hover(sway=0.0, hovering=60.0)


def standing(before, after, in_flight=(0.0, 0.0)):
    """A hover of a vehicle that reads these roll and pitch, degrees, on the ground before and after, and in flight."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    time = telemetry.messages["ATTITUDE"]["time"]
    is_before, is_after = time < 6.0, time >= HOVER.landed
    angles = {}
    for number, name in enumerate(("roll", "pitch")):
        landed = np.where(is_after, after[number], in_flight[number])
        angles[name] = np.radians(np.where(is_before, before[number], landed))
    yaw = 1e-3 * np.sin(time)
    return changed(telemetry, "ATTITUDE", yaw=yaw, **angles)


def lean(telemetry):
    signals = Signals(telemetry)
    angles = [attitude_from_messages(telemetry, axis) for axis in AXES[:YAW]]
    return lean_on_ground(signals, angles, 0, (20.0, 60.0))


@mark.parametrize(
    ("before", "after", "shared"),
    [
        ((0, 3), (0, 3), (3, 0)),
        ((-4, 0), (-2, 0), (0, 2)),
        ((2, 3), (-2, 1), (1, 0)),
    ],
)
def test_the_lean_that_both_stands_share_may_be_of_the_autopilot(before, after, shared):
    assert lean(standing(before, after)) == approx(9.81 * np.tan(np.radians(shared)), rel=0.01)


@mark.parametrize(("before", "after"), [((30, 0), (0, -80)), ((0, 3), (0, -80)), ((30, 0), (0, 3))])
def test_a_vehicle_that_lies_on_its_side_before_or_after_the_flight_shows_no_lean(before, after):
    assert lean(standing(before, after)) is None


@mark.slow
def test_a_misaligned_autopilot_in_still_air_shows_no_wind():
    """A lean of 5° would be a wind of about 2.5 m/s; with a level stand before and after it is one."""
    stamps = HOVER.stamps(5.0)
    rng = np.random.default_rng(3)
    velocity = {name: 0.02 * rng.standard_normal(len(stamps)) for name in ("vx", "vy")}
    height = np.cumsum(HOVER.climb(stamps)) / 5.0
    place = columns(stamps, x=0.0, y=0.0, z=-height, vz=-HOVER.climb(stamps), **velocity)

    def wind(before, after):
        telemetry = standing(before, after, in_flight=(3.0, 4.0))
        return wind_evidence(Signals(changed(telemetry, "LOCAL_POSITION_NED", **place))).estimate

    assert wind((0, 0), (0, 0)).speed_interval[0] > 0.5
    misaligned = wind((3, 4), (3, 4))
    assert misaligned.speed_interval[0] == 0 and not misaligned.direction_identifiable
    # A slope on one side of the flight only is no misalignment.
    assert wind((3, 4), (0, 0)).speed_interval[0] > 0.5
    assert misaligned.drag.source is DragSource.POPULATION


def test_a_measured_lean_is_kept():
    known = Drag.from_parameters()
    known = Drag(known.mean, known.covariance, DragSource.CALIBRATION)
    telemetry = standing((3, 4), (3, 4))
    angles = [attitude_from_messages(telemetry, axis) for axis in AXES[:YAW]]
    assert with_lean_on_ground(known, Signals(telemetry), angles, 0, (20.0, 60.0)) is known
