"""What to fly so that the wind is known better, and how well it would then be known.

The speed of the wind is uncertain because of noise, the drag of the vehicle, and its lean. Flight in several directions
shows the drag. Turns of the heading show the lean, which turns with the vehicle, as wind does not.
"""

from typing import NamedTuple

import numpy as np

from mavdem.confidence import coverage_factor
from mavdem.facts import Fact
from mavdem.facts.online import DragSource
from mavdem.facts.wind import WindAdvice
from mavdem.wind_velocity.compass import HEADING_SD
from mavdem.wind_velocity.vehicle_drag import LEAN, LOG_LINEAR, LOG_QUADRATIC, Drag

BOX_DRAG_SD = 0.13
"""Relative standard deviation of the drag, in the same flight and others, by a flight with a box for a minute.

Measured with simulated flights (docs/evidence/wind.md): sides of 8 to 30 m at 3 to 7 m/s all give about as much.
"""

BOX_LEAN_SD = 0.12
"""Standard deviation of the lean, m/s², in a flight with a box whose corners turn the heading: by the same flights."""

TURNED_LEAN_SD = 0.08
"""Standard deviation of the lean, m/s², in a hover with four turns of the heading by 90°: by the same flights."""

MAX_ERROR_RATIO = 0.7
"""Ratio of the expected error to the present one, up to which a flight is advised: a choice."""

MIN_WIND_SPEED = 1e-9
"""Least wind speed in a denominator, m/s: it only avoids a division by 0."""


class WindErrors(NamedTuple):
    """How uncertain the mean wind of a flight is."""

    speed: float
    """Speed of the mean wind, m/s."""

    speed_error: float
    """Half width of the speed's 90 % interval, m/s."""

    direction_error: float | None
    """Half width of the direction's 90 % interval, rad; None if it is small enough, or the air may be still."""

    noise_sd: float
    """Standard deviation of the mean wind by noise alone, along one direction, m/s."""

    drag_sd: float
    """Relative standard deviation of the drag at the air speed of the flight."""


class _Sensitivity(NamedTuple):
    """How the error of the mean wind depends on those of drag and lean."""

    errors: WindErrors
    """The present errors."""

    speed_per_drag: float
    """Change of the speed per relative change of the drag, m/s."""

    speed_per_lean: float
    """Change of the speed, and of the wind across it, per change of the lean, m/s per m/s²."""

    def speed_error(self, drag_sd: float, lean_sd: float) -> float:
        """Returns the half width of the speed's 90 % interval, m/s, with other errors of drag and lean (m/s²)."""
        sd = np.hypot(self.across_sd(lean_sd), drag_sd * self.speed_per_drag)
        return float(coverage_factor() * sd)

    def across_sd(self, lean_sd: float) -> float:
        """Returns the standard deviation of the wind across its mean direction, m/s, with another one of the lean."""
        return float(np.hypot(self.errors.noise_sd, lean_sd * self.speed_per_lean))

    def direction_error(self, lean_sd: float) -> float:
        """Returns the half width of the direction's 90 % interval, rad, with another error of the lean (m/s²)."""
        half_width_across = coverage_factor() * self.across_sd(lean_sd)
        angle = np.arctan(half_width_across / max(self.errors.speed, MIN_WIND_SPEED))
        return float(np.hypot(angle, np.radians(coverage_factor() * HEADING_SD)))


def advised_flight(errors: WindErrors, drag: Drag) -> Fact | None:
    """Returns the flight that would make the wind known much better, with the errors that are then to be expected.

    At a wind speed v the force by drag is f = c v + q v². So the speed that a given force means changes by
    −v (c + q v) / (c + 2 q v) per relative change of the drag. It changes by 1 / (c + 2 q v) per change of the lean,
    which adds to the force. The errors by drag, lean and noise are independent.

    Three flights are compared. A box shows the drag, which the vehicle keeps, so that the speed in this very log is
    known better. Turns of the heading in hover show the lean, but only in the flight that has them. In a flight with a
    box whose corners turn the heading, both are known.

    Args:
        errors: how uncertain the wind is now.
        drag: drag and lean of the vehicle as this flight shows them, with their uncertainty.

    Returns:
        The advice; None if no flight reduces the error of the speed or of the direction to ``MAX_ERROR_RATIO`` of what
        it is. The box is advised where it reduces the error of the speed in this log more than turns do in another. If
        the drag is that of an earlier flight, it is advised as a better prior (``BETTER_PRIOR``).
    """
    linear, quadratic = np.exp(drag.mean[[LOG_LINEAR, LOG_QUADRATIC]])
    force_slope = linear + 2 * quadratic * errors.speed
    sensitivity = _Sensitivity(
        errors,
        speed_per_drag=errors.speed * (linear + quadratic * errors.speed) / force_slope,
        speed_per_lean=1 / force_slope,
    )
    lean_sd = float(np.sqrt(np.diag(drag.covariance)[LEAN].mean()))
    box_drag_sd = min(errors.drag_sd, BOX_DRAG_SD)
    turned_lean_sd = min(lean_sd, TURNED_LEAN_SD)
    largest_advised_error = MAX_ERROR_RATIO * errors.speed_error
    error_by_box = sensitivity.speed_error(box_drag_sd, lean_sd)
    error_by_turns = sensitivity.speed_error(errors.drag_sd, turned_lean_sd)
    if error_by_box <= min(error_by_turns, largest_advised_error):
        has_prior_of_user = drag.source is DragSource.EARLIER_FLIGHT
        if has_prior_of_user:
            # What is missing is a better prior.
            return Fact(
                WindAdvice.BETTER_PRIOR,
                speed_error=errors.speed_error,
                expected_speed_error=error_by_box,
                drag_error=coverage_factor() * errors.drag_sd,
            )
        return Fact(
            WindAdvice.FLY_BOX,
            speed_error=errors.speed_error,
            expected_speed_error=error_by_box,
            in_this_log=True,
        )
    direction_by_turns = sensitivity.direction_error(turned_lean_sd)
    improves_speed = error_by_turns <= largest_advised_error
    improves_direction = (
        errors.direction_error is not None
        and direction_by_turns <= MAX_ERROR_RATIO * errors.direction_error
    )
    error_in_box = sensitivity.speed_error(box_drag_sd, min(lean_sd, BOX_LEAN_SD))
    if not improves_speed and error_in_box <= largest_advised_error:
        return Fact(
            WindAdvice.FLY_BOX,
            speed_error=errors.speed_error,
            expected_speed_error=error_in_box,
            in_this_log=False,
        )
    if not (improves_speed or improves_direction):
        return None
    return Fact(
        WindAdvice.TURN_HEADING,
        speed_error=errors.speed_error if improves_speed else None,
        expected_speed_error=error_by_turns,
        direction_error=errors.direction_error if improves_direction else None,
        expected_direction_error=direction_by_turns,
    )
