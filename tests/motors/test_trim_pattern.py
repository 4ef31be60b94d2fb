"""The trim of one flight is named by its pattern, or not at all."""

import numpy as np
from frames import FRAMES, geometry
from pytest import approx, mark

from mavdem.facts.motors import TrimFact
from mavdem.ingest.motors import PositionSource, name_without_place
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import motor_signatures
from mavdem.motors.trim_pattern import trim_pattern
from mavdem.report.templates import with_interval

QUAD = geometry()


def trim(mean, coaxial_geometry=QUAD, lean=(0.0, 0.0), error=0.003):
    """Of a balance that the lean has not moved in this flight, as far as it shows."""
    errors = np.full(3, error), np.radians(lean), np.zeros((3, 2)), np.full((3, 2), 0.5)
    return trim_pattern(MotorBalance(np.array(mean), *errors, 60.0), coaxial_geometry)


@mark.parametrize(
    "mean, code, figures",
    [
        ((0.01, 0.0, 0.16), TrimFact.TRIM_OF_YAW, {"share": 0.16}),
        ((0.0, -0.01, -0.1), TrimFact.TRIM_OF_YAW, {"share": -0.1}),
        ((0.0, -0.12, 0.0), TrimFact.TRIM_OF_CENTRE, {"share": 0.12, "place": "rear"}),
        ((-0.1, 0.1, 0.01), TrimFact.TRIM_OF_CENTRE, {"share": 0.141, "place": "front right"}),
        ((0.15, 0.01, 0.0), TrimFact.TRIM_OF_CENTRE, {"share": 0.15, "place": "left"}),
        ((0.01, -0.06, 0.06), TrimFact.TRIM_OF_SEVERAL, {}),
        ((0.01, -0.02, 0.03), TrimFact.TRIM_EVEN, {"deviation": 0.06, "most_loss": 0.303}),
    ],
)
def test_the_pattern_is_named(mean, code, figures):
    """The mean trim in roll, pitch and yaw, relative to the thrust, has a typical pattern.

    It is that of yaw, of the centre of gravity, of several causes, or even.
    """
    trim_fact = trim(mean)
    assert trim_fact.code is code and not trim_fact.subject
    assert trim_fact.level == ("good" if code is TrimFact.TRIM_EVEN else "watch")
    assert {name: trim_fact.figures[name] for name in figures} == approx(figures, abs=0.005)


@mark.slow
@mark.parametrize("motors", FRAMES)
def test_one_motor_is_named_where_all_axes_have_the_ratio_of_its_place(motors):
    """Of eight motors neighbours help the weak one: other causes are as likely, so that it is a suspect."""
    coaxial_geometry = geometry(motors)
    signatures = motor_signatures(coaxial_geometry).weak_motor_balance[:, 1:]
    for name, signature in zip(coaxial_geometry.names, 0.4 * signatures, strict=True):
        trim_fact = trim(signature, coaxial_geometry)
        assert trim_fact.figures["worst"] == name
        if motors == 8:
            assert trim_fact.code is TrimFact.TRIM_OF_SEVERAL
            assert trim_fact.figures["names"] == (name,) and trim_fact.figures["probability"] > 0.5
        else:
            assert (trim_fact.code, trim_fact.subject) == (TrimFact.TRIM_OF_ONE_MOTOR, name)
            assert trim_fact.figures["rise"][0] == approx(0.4, abs=0.15)
        # Of a little, it is a suspect at most; in another ratio none is.
        little = trim(0.3 * signature, coaxial_geometry)
        assert not little.subject and little.figures.get("names", ()) in ((), (name,))
        other_ratio = trim(signature * [1, 1, -0.3], coaxial_geometry)
        assert not other_ratio.subject and not other_ratio.figures.get("names")


def test_two_motors_that_explain_a_trim_alike_are_suspects_both():
    """Of two motors above each other that turn the same way, no trim shows which one is weak."""
    places = [*np.repeat(FRAMES[4][0], 2, axis=0)]
    coaxial_geometry = geometry(
        8, positions=tuple(map(tuple, places)), spins=(1, 1, 1, 1, -1, -1, -1, -1)
    )
    trim_fact = trim(
        0.4 * motor_signatures(coaxial_geometry).weak_motor_balance[0, 1:], coaxial_geometry
    )
    assert (trim_fact.code, trim_fact.subject) == (TrimFact.TRIM_OF_SEVERAL, "")
    assert set(trim_fact.figures["names"]) == set(coaxial_geometry.names[:2])
    first, second = map(name_without_place, coaxial_geometry.names[:2])
    assert f"{first} or {second} may be weak" in trim_fact.sentence


def test_an_even_trim_that_may_hide_a_lost_motor_is_not_called_good():
    """Of eight motors the weak one deviates by less than half of what it lacks."""
    for motors, code in ((4, TrimFact.TRIM_EVEN), (8, TrimFact.TRIM_UNSURE)):
        fact = trim((0.0, 0.0, 0.0), geometry(motors), error=0.02)
        assert fact.code is code
    assert "may hide that one lost 56 % of its thrust" in fact.sentence
    assert trim((0.0, 0.0, 0.0), geometry(8)).code is TrimFact.TRIM_EVEN


def test_what_cannot_be_told_from_even_is_no_alarm():
    """A trim is reported only if it exceeds the limit by more than its error."""
    half = 1.645 * 0.01
    limit = FAULT_RISE
    for yaw, code, level in (
        (0.99 * limit, TrimFact.TRIM_EVEN, "good"),
        (limit + 0.99 * half, TrimFact.TRIM_NEAR_LIMIT, "unknown"),
        (limit + 1.1 * np.sqrt(3) * half, TrimFact.TRIM_OF_YAW, "watch"),
    ):
        fact = trim((0, 0, yaw), error=1e-2)
        assert (fact.code, fact.level) == (code, level)
        # The figure that decides is written, whatever the pattern.
        assert abs(fact.figures["deviation"]) == approx(yaw)
        figure = with_interval(abs(fact.figures["deviation"]), fact.figures["half"])
        assert figure in fact.sentence
    # Steady wind leans the vehicle, and asks for torque too.
    wind = trim((0.0, 0.12, 0.0), lean=(0, -9))
    assert (wind.code, wind.level) == (TrimFact.TRIM_UNSURE, "unknown")
    # What is known to 8 % is even.
    half_width = FAULT_RISE / 1.645 / np.sqrt(3)
    for share, code in ((0.99, TrimFact.TRIM_EVEN), (1.01, TrimFact.TRIM_UNSURE)):
        assert trim((0, 0, 0), error=share * half_width).code is code


@mark.parametrize(
    "share, error, code",
    [
        (1.05, 0.003, TrimFact.TRIM_OF_LEADING_MOTOR),
        (0.95, 0.003, TrimFact.TRIM_EVEN),
        # An estimate that may as well be half of it is none, but it is not called even.
        (1.05, 0.02, TrimFact.TRIM_NEAR_LIMIT),
    ],
)
def test_one_motor_that_leads_alone_is_to_be_watched(share, error, code):
    """The trim is the signature of motor 2, just above or below the limit."""
    signature = motor_signatures(QUAD).weak_motor_balance[1, 1:]
    fact = trim(share * FAULT_RISE / 0.75 * signature, error=error)
    assert fact.code is code
    assert fact.subject == (QUAD.names[1] if code is TrimFact.TRIM_OF_LEADING_MOTOR else "")


def test_nothing_is_said_of_little_flight_or_without_the_places():
    assert trim_pattern(None, geometry()).code is TrimFact.TRIM_UNKNOWN
    for spins in ((), (0, 0)):  # Spins that are not known, or 0.
        fact = trim_pattern(None, geometry(spins=spins))
        assert (fact.code, fact.level) == (TrimFact.TRIM_OF_UNKNOWN_PLACES, "unknown")
    assumed = geometry(position_source=PositionSource.X_QUAD)
    assert trim((0.0, 0.0, 0.16), assumed).figures["assumed"]
