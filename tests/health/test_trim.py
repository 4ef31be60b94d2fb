"""The trim of one flight is named by its pattern, or not at all."""

import numpy as np
from frames import FRAMES, geometry
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.alignment.signals import Signals
from mavdem.analysis.analysis import motor_alarms
from mavdem.facts import Level
from mavdem.facts.motors import Trim
from mavdem.health.assessment import FAULT_RISE
from mavdem.health.balance import BalanceFigures, motor_signatures
from mavdem.health.trim import trim_of, trim_of_signals
from mavdem.ingest.motors import PlaceBasis


def flown(mean, lean=(0.0, 0.0), error=0.003):
    """A balance that the lean has not moved in this flight, as far as it shows."""
    return BalanceFigures(
        np.array(mean),
        np.full(3, error),
        np.radians(lean),
        np.zeros((3, 2)),
        np.full((3, 2), 0.5),
        60.0,
    )


@mark.parametrize(
    "mean, code, figures",
    [
        ((0.01, 0.0, 0.16), Trim.TRIM_OF_YAW, {"share": 0.16}),
        ((0.0, -0.01, -0.1), Trim.TRIM_OF_YAW, {"share": -0.1}),
        ((0.0, -0.12, 0.0), Trim.TRIM_OF_CENTRE, {"share": 0.12, "place": "rear"}),
        ((-0.1, 0.1, 0.01), Trim.TRIM_OF_CENTRE, {"share": 0.141, "place": "front right"}),
        ((0.15, 0.01, 0.0), Trim.TRIM_OF_CENTRE, {"share": 0.15, "place": "left"}),
        ((0.01, -0.06, 0.06), Trim.TRIM_OF_SEVERAL, {}),
        ((0.01, -0.02, 0.03), Trim.TRIM_EVEN, {"deviation": 0.06, "most_loss": 0.303}),
    ],
)
def test_the_pattern_is_named(mean, code, figures):
    found = trim_of(flown(mean), geometry())
    assert found.code is code and not found.subject
    assert found.level is (Level.GOOD if code is Trim.TRIM_EVEN else Level.WATCH)
    named = {name: found.figures[name] for name in figures}
    assert named == {
        name: value if isinstance(value, str) else approx(value, abs=0.005)
        for name, value in figures.items()
    }


@mark.parametrize("motors", FRAMES)
def test_one_motor_is_named_where_all_axes_have_the_ratio_of_its_place(motors):
    """Of more than four motors neighbours help the weak one, and other causes are as likely."""
    plan = geometry(motors)
    signatures = motor_signatures(plan).weak_motor[:, 1:]
    for name, signature in zip(plan.names, 0.4 * signatures, strict=True):
        found = trim_of(flown(signature), plan)
        assert found.subject == (name if motors == 4 else "")
        if found.subject:
            assert found.code is Trim.TRIM_OF_ONE_MOTOR
            assert found.figures["rise"][0] == approx(0.4, abs=0.05)
        # Of a little, or in another ratio, none is.
        assert not trim_of(flown(0.3 * signature), plan).subject
        assert not trim_of(flown(signature * [1, 1, -0.3]), plan).subject


@mark.parametrize(
    "name, code",
    [
        ("px4_pwm_main_1100_1900.ulg", Trim.TRIM_OF_YAW),
        ("ardupilot31_bitmask_already_set.BIN", Trim.TRIM_OF_SEVERAL),
        ("no_fault_while_yawing.BIN", Trim.TRIM_EVEN),
        ("armed_on_the_ground.BIN", Trim.TRIM_UNKNOWN),
    ],
)
def test_real_vehicles_whose_motors_were_named_wrongly(name, code):
    signals = Signals(recorded(f"real/logs/{name}"), inputs="motors")
    found = trim_of_signals(signals)
    assert (found.code, found.subject) == (code, "")
    assert not [change for change in motor_alarms(signals) if change.motor is not None]


def test_what_cannot_be_told_from_even_is_no_alarm():
    half = 1.645 * 0.01
    assert (
        trim_of(flown((0, 0, FAULT_RISE + 0.99 * half), error=1e-2), geometry()).level is Level.GOOD
    )
    sure = trim_of(flown((0, 0, FAULT_RISE + 1.1 * np.sqrt(3) * half), error=1e-2), geometry())
    assert sure.level is Level.WATCH
    # Steady wind leans the vehicle, and asks for torque too.
    wind = trim_of(flown((0.0, 0.12, 0.0), lean=(0, -9)), geometry())
    assert (wind.code, wind.level) == (Trim.TRIM_UNSURE, Level.UNKNOWN)
    # What is known to 8 % is even.
    known = FAULT_RISE / 1.645 / np.sqrt(3)
    for share, code in ((0.99, Trim.TRIM_EVEN), (1.01, Trim.TRIM_UNSURE)):
        assert trim_of(flown((0, 0, 0), error=share * known), geometry()).code is code


def test_nothing_is_said_of_little_flight_or_without_the_places():
    twisted = (0.0, 0.0, 0.16)
    short = trim_of(None, geometry())
    assert (short.code, short.level) == (Trim.TRIM_UNKNOWN, Level.UNKNOWN)
    unknown = trim_of(None, geometry(spins=()))
    assert (unknown.code, unknown.level) == (Trim.TRIM_OF_UNKNOWN_PLACES, Level.UNKNOWN)
    assumed = geometry(places_by=PlaceBasis.X_QUAD)
    assert trim_of(flown(twisted), assumed).figures["assumed"]
