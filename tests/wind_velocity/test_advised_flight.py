"""What to fly to know the wind better: the flight that reduces the error most, with the error to be expected."""

from dataclasses import replace

import numpy as np
from pytest import approx

from mavdem.facts.online import DragSource
from mavdem.facts.wind import WindAdvice
from mavdem.wind_velocity.advised_flight import WindErrors, advised_flight
from mavdem.wind_velocity.vehicle_drag import LEAN, LOG_LINEAR, LOG_QUADRATIC, Drag


def drag(lean_sd):
    """Drag of 0.3 1/s with hardly any quadratic part, and a lean of a known error, m/s²."""
    usual = Drag.from_parameters()
    mean = usual.mean.copy()
    mean[[LOG_LINEAR, LOG_QUADRATIC]] = np.log([0.3, 1e-6])
    covariance = usual.covariance.copy()
    covariance[LEAN, LEAN] = np.eye(2) * lean_sd**2
    return replace(usual, mean=mean, covariance=covariance)


HOVER = WindErrors(speed=6.0, speed_error=3.5, direction_error=0.2, noise_sd=0.1, drag_sd=0.5)
"""Wind of a hover whose drag is that of typical vehicles."""


def test_an_unknown_drag_is_shown_by_a_box_which_also_helps_the_hover_itself():
    advice = advised_flight(HOVER, drag(lean_sd=0.18))
    assert advice.code is WindAdvice.FLY_BOX and advice.figures["in_this_log"]
    # Errors by noise, by a lean of 0.18 m/s² at 0.3 1/s, and by 13 % of drag; 1.645 standard deviations each.
    expected = 1.645 * np.sqrt(0.1**2 + (0.18 / 0.3) ** 2 + (0.13 * 6.0) ** 2)
    assert advice.figures["expected_speed_error"] == approx(expected, rel=1e-3)
    assert f"to about ±{expected:.1f} m/s instead of ±3.5 m/s" in advice.sentence
    # With a prior already, the advice says how well that is known, and not to use one.
    of_prior = replace(drag(lean_sd=0.18), source=DragSource.EARLIER_FLIGHT)
    better = advised_flight(HOVER, of_prior).sentence
    assert better.startswith("The drag of this prior is known to ±82 % only.")
    assert f"±{expected:.1f} m/s instead of ±3.5 m/s" in better and "--prior" not in better


def test_an_unknown_lean_is_shown_by_turns_of_the_heading():
    errors = HOVER._replace(speed_error=1.0, drag_sd=0.05)
    advice = advised_flight(errors, drag(lean_sd=0.18))
    assert advice.code is WindAdvice.TURN_HEADING
    expected = 1.645 * np.sqrt(0.1**2 + (0.08 / 0.3) ** 2 + (0.05 * 6.0) ** 2)
    assert advice.figures["expected_speed_error"] == approx(expected, rel=1e-3)
    # A direction that is sure enough, or that still air has not, needs no turns.
    sure = advised_flight(errors._replace(direction_error=None), drag(lean_sd=0.18))
    assert "instead of ±11°" in advice.sentence and "°" not in sure.sentence.split("turns would")[1]


def test_in_a_weak_wind_with_unknown_drag_only_a_flight_with_a_box_shows_drag_and_lean():
    errors = HOVER._replace(speed=2.8, speed_error=1.7, direction_error=None)
    advice = advised_flight(errors, drag(lean_sd=0.22))
    assert advice.code is WindAdvice.FLY_BOX and not advice.figures["in_this_log"]
    assert "In that flight" in advice.sentence


def test_what_no_flight_improves_much_needs_no_advice():
    errors = HOVER._replace(speed_error=0.8, direction_error=None, drag_sd=0.1)
    assert advised_flight(errors, drag(lean_sd=0.05)) is None
