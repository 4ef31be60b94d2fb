"""Jumps of the GPS position: what the receiver's own positions show while the filter flags a glitch."""

import numpy as np
from hover import Hover, changed, columns, evidence_of
from pytest import approx, mark

from mavdem.assessment.gps_jumps import MIN_JUMP, position_jumps
from mavdem.assessment.innovations import INNOVATION_FIELDS
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.dataset.signals import EARTH_RADIUS, Signals
from mavdem.facts.estimator import EstimatorLight

HOVER = Hover()
TIME = HOVER.stamps(5.0)
ONE_SAMPLE = (TIME > 30.0) & (TIME < 30.3)
THREE_SECONDS = (TIME > 30.0) & (TIME < 33.0)
PX4_GLITCH = 831 | 1 << 10
SPEED = 15.0


def with_positions(telemetry, north):
    """A receiver with its positions ``north`` (N,), m, at 5 Hz."""
    degrees = 47.0 + np.degrees(north / EARTH_RADIUS)
    fix = columns(TIME, fix_type=3, satellites_visible=14, lat=1e7 * degrees, lon=8e7, eph=60.0)
    return changed(telemetry, "GPS_RAW_INT", **fix)


def telemetry_with_glitch(is_flagged, north):
    """Returns a flight whose estimator flags a glitch of GPS by PX4's bit, with all innovations below their limits."""
    status = dict.fromkeys(INNOVATION_FIELDS["ESTIMATOR_STATUS"], 0.7)
    flags = np.where(is_flagged, PX4_GLITCH, 831)
    telemetry = HOVER.telemetry(20.0, 20.0)
    telemetry = changed(telemetry, "ESTIMATOR_STATUS", **columns(TIME, flags=flags, **status))
    return with_positions(telemetry, north)


def fast_flight():
    """Positions (N,), m: from rest to 15 m/s at 8 m/s², and back after half a minute."""
    speed = np.clip(8.0 * (TIME - 15.0), 0.0, SPEED) - np.clip(8.0 * (TIME - 45.0), 0.0, SPEED)
    return np.cumsum(speed) * 0.2


@mark.parametrize(
    ("is_flagged", "jump", "code"),
    [
        (ONE_SAMPLE, 0.0, EstimatorLight.FILTER_AGREED),
        (THREE_SECONDS, 0.0, EstimatorLight.GPS_DOUBTED),
        (ONE_SAMPLE, 40.0, EstimatorLight.GPS_GLITCHED),
        (THREE_SECONDS, 40.0, EstimatorLight.GPS_GLITCHED),
    ],
)
def test_a_flag_is_a_jump_only_where_the_positions_jump(is_flagged, jump, code):
    """The filter reports a glitch for one sample or three seconds, while the position jumps by 40 m or not at all."""
    north = fast_flight() + np.where(THREE_SECONDS, jump, 0.0)
    fact = estimator_light(evidence_of(Signals(telemetry_with_glitch(is_flagged, north))))
    assert fact.code is code
    if jump:
        assert fact.figures["distance"] == approx(jump, abs=1.0)
        assert fact.time == approx(30.2, abs=0.2)


def test_repeated_and_late_fixes_do_not_jump():
    north = fast_flight()
    repeated = np.repeat(north[::2], 2)[: len(TIME)]
    assert not len(position_jumps(telemetry_with_glitch(ONE_SAMPLE, repeated)).time)
    random = np.random.default_rng(1)
    late = north + random.normal(0.0, MIN_JUMP / 10, len(TIME))
    assert not len(position_jumps(telemetry_with_glitch(ONE_SAMPLE, late)).time)


@mark.slow
@mark.parametrize(("step", "code"), [(1e6, "motion_impossible"), (40.0, "filter_agreed")])
def test_a_step_that_nothing_flies_is_watched_without_a_flag(step, code):
    """The receiver, and the height above the take-off; 40 m may be what the filter accepts after a gap."""
    north = fast_flight() + np.where(TIME > 50.0, step, 0.0)
    telemetry = telemetry_with_glitch(TIME < 0.0, north)
    fact = estimator_light(evidence_of(Signals(telemetry)))
    assert fact.code == code
    if code == "motion_impossible":
        assert str(fact).startswith("GPS jumped by 1000 km within 0.2 s in flight, at 50.2 s")
        assert fact.is_watch_or_bad
    still = telemetry_with_glitch(TIME < 0.0, fast_flight())
    down = np.where(HOVER.stamps(10.0) > 30.0, -10.0 - step, -10.0)
    fact = estimator_light(evidence_of(Signals(changed(still, "LOCAL_POSITION_NED", z=down))))
    assert fact.code == code


@mark.slow
def test_a_jump_elsewhere_is_not_that_of_the_flag():
    north = fast_flight() + np.where(TIME > 50.0, 40.0, 0.0)
    fact = estimator_light(evidence_of(Signals(telemetry_with_glitch(ONE_SAMPLE, north))))
    assert fact.code is EstimatorLight.FILTER_AGREED
