"""Extended Kalman filter of the wind velocity, from the specific force that drag causes.

In each step of a motion grid, the specific force along body x and y is measured:

    f = b − (c + q |u|) u + e,    u = R (v − m − w),

with lean b, linear and quadratic drag c and q, velocity v over ground, and R the body's x and y axes in north and east.
The wind velocity is the sum of gusts w, an Ornstein-Uhlenbeck process of mean 0, and a mean wind m, a random walk. The
errors e are white. The filter runs for G sets of parameters side by side. Its likelihood weighs them; its smoother,
averaged over them, is the estimate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.wind_velocity.motion_grid import MotionGrid
from mavdem.wind_velocity.vehicle_drag import LEAN, air_speed, axis_drag

WIND_SD = 5.0
"""Prior standard deviation of the mean wind along north and east, m/s: 3 to 10 are usual."""

DEGREES_OF_FREEDOM = 8.0
"""Degrees of freedom of Student's t distribution of the innovations: a choice.

A reset of the position estimate, or contact with the ground, then has little weight, and is not attributed to wind.
"""

MIN_SPEED_SQUARE = 1e-4
"""Added to the square of the air speed, m²/s², so that the drag has a derivative in calm air."""

MIN_FORCE = 1e-9
"""Least mean force whose direction is used, m/s²: it only avoids a division by 0."""

STATES = 4
"""Number of states: gusts north and east, then mean wind north and east, m/s."""

IDENTITY = np.eye(2)

TOTAL_WIND_MATRIX = np.kron([[1.0, 1.0]], IDENTITY)
"""Matrix (2, 4) that adds gusts and mean wind: the wind velocity, north and east, from the state."""


class FilterUpdate(NamedTuple):
    """Innovations of one measurement, for each of G sets of parameters."""

    innovations: Array
    """Errors of the predicted specific force along body x and y (G, 2), m/s²."""

    covariances: Array
    """Their covariances by the filter (G, 2, 2)."""


class AirflowFilter:
    """Extended Kalman filters for G sets of parameters side by side, run step by step over a motion grid.

    Attributes:
        states: (G, 4) gusts north and east, mean wind north and east, m/s.
        covariances: (G, 4, 4) of the states.
        log_likelihoods: (G,) of all measurements so far, up to a constant.
        decay: (G, 4) factors of the states in a step.
    """

    def __init__(self, parameters: Array, start: MotionGrid) -> None:
        """Begins before the first step.

        Gusts begin at 0, and the mean wind begins at the wind that explains the median force of the motion.

        Args:
            parameters: (G, 10) the six entries of ``Drag.mean``; then logarithms of the gusts' standard deviation (m/s)
                and time (s), of the change of the mean wind (m/s in 1 s), and of the standard deviation of e (m/s²).
            start: motion with the step that the filter will have.
        """
        self._linear, self._quadratic = axis_drag(parameters)
        self._lean = parameters[:, LEAN]
        gust_sd, gust_time, mean_wind_change, noise_sd = np.exp(parameters[:, LEAN.stop :]).T
        # In one step gusts decay by exp(−Δt/T), and noise restores their variance. The mean wind is a random walk.
        gust_decay = np.exp(-start.step / gust_time)
        ones = np.ones(len(parameters))
        self.decay = np.repeat(np.stack([gust_decay, ones], axis=1), 2, axis=1)
        self.covariances = _diagonal_covariances(gust_sd**2, WIND_SD**2 * ones)
        self._process_covariances = _diagonal_covariances(
            gust_sd**2 * (1 - gust_decay**2), mean_wind_change**2 * start.step
        )
        self._covariance_decay = self.decay[:, :, None] * self.decay[:, None, :]
        self._noise_covariances = (noise_sd**2)[:, None, None] * IDENTITY
        self.log_likelihoods = np.zeros(len(parameters))
        mean_wind = self._initial_mean_wind(start)
        self.states = np.hstack([np.zeros_like(mean_wind), mean_wind])

    def _initial_mean_wind(self, start: MotionGrid) -> Array:
        """Returns an initial estimate of the mean wind: the wind whose drag is the median specific force of the motion.

        The filter linearises the drag about this wind. Medians are used because resets of the position estimate cause
        outliers.

        Args:
            start: motion of the flight; its complete steps are used.

        Returns:
            Mean wind north and east (G, 2), m/s, for each set of parameters.
        """
        complete = start.complete
        level_axes = start.body_axes[complete][:, :, :2]
        # The force north and east (j), from its components along the body's axes (i) at each time t.
        level_forces = np.einsum("tij,ti->tj", level_axes, start.force[complete])
        force = np.median(level_forces, axis=0)
        size = np.hypot(*force)
        speed = air_speed(self._linear.mean(axis=1), self._quadratic.mean(axis=1), size)
        # The force has the direction of the air flow past the vehicle. The wind is that flow plus the velocity of the
        # vehicle over ground.
        flow = force / max(size, MIN_FORCE) * speed[:, None]
        return np.median(start.velocity[complete, :2], axis=0) + flow

    def predict(self) -> None:
        """Predicts the states one step ahead."""
        self.states = self.states * self.decay
        self.covariances = self.covariances * self._covariance_decay + self._process_covariances

    def update(self, motion: MotionGrid, step: int) -> FilterUpdate:
        """Updates the states by the measured force of one step: the measurement update of an extended Kalman filter.

        The states x are the gust and the mean wind, north and east; their sum is the wind. The vehicle's velocity minus
        the wind, along body x and y, is its air velocity u. The predicted specific force is lean − (c + q |u|) u, with
        linear drag c and quadratic drag q. The innovation is the measured force minus the predicted one, (G, 2), m/s²,
        for each of G sets of parameters. It is assumed to have Student's t distribution. Large innovations therefore
        have a smaller weight, as in iteratively reweighted least squares.

        Args:
            motion: motion of the flight; the step must be complete, with force and velocity.
            step: index of the step in the motion.

        Returns:
            The innovations and their covariances S.
        """
        # States (G, 4) and their covariances (G, 4, 4).
        x = self.states
        P = self.covariances
        # Body x and y (2, 3), by their components north, east and down.
        axes = motion.body_axes[step]
        u = axes @ motion.velocity[step] - x @ (axes[:, :2] @ TOTAL_WIND_MATRIX).T
        speed = np.sqrt((u * u).sum(axis=1) + MIN_SPEED_SQUARE)[:, None]
        drag = self._linear + self._quadratic * speed
        innovations = motion.force[step] + drag * u - self._lean

        # Derivative of (c + q |u|) u by u. Its product with the axes is the derivative of the predicted force by the
        # wind.
        speed_slope = (self._quadratic / speed * u)[:, :, None] * u[:, None, :]
        drag_slope = drag[:, :, None] * IDENTITY + speed_slope
        H_wind = drag_slope @ axes[:, :2]
        HP = H_wind @ TOTAL_WIND_MATRIX @ P
        motion_error = motion.force_error[step] ** 2 * IDENTITY
        S = HP @ TOTAL_WIND_MATRIX.T @ H_wind.mT + self._noise_covariances + motion_error
        # S is made exactly symmetric, since otherwise rounding errors grow from step to step.
        S = (S + S.mT) / 2
        # The inverse of a matrix of 2 by 2 is (trace · I − S) / determinant.
        determinant = (S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)[:, None, None]
        inverse_S = (S.trace(axis1=1, axis2=2)[:, None, None] * IDENTITY - S) / determinant

        # The squared Mahalanobis distance of each innovation, and the log density of Student's t distribution.
        innovation_rows = innovations[:, None]
        squares = innovation_rows @ inverse_S @ innovations[:, :, None]
        freedom = DEGREES_OF_FREEDOM
        deviance = np.log(determinant) / 2 + (freedom + 2) / 2 * np.log1p(squares / freedom)
        self.log_likelihoods -= deviance[:, 0, 0]
        weights = np.minimum((freedom + 2) / (freedom + squares), 1.0)
        gain_transposed = inverse_S * weights @ HP
        self.states = x + (innovation_rows @ gain_transposed)[:, 0]
        self.covariances = P - gain_transposed.mT @ HP
        return FilterUpdate(innovations, S)


def _diagonal_covariances(gust_variance: Array, mean_variance: Array) -> Array:
    """Returns diagonal covariances (G, 4, 4) with variances of both gust components (G,), and of the mean wind (G,)."""
    variances = np.repeat(np.stack([gust_variance, mean_variance], axis=1), 2, axis=1)
    return variances[:, :, None] * np.eye(STATES)


class SmoothedStates(NamedTuple):
    """States given the measurements of all T steps, for each of G sets of parameters."""

    states: Array
    """(T, G, 4), m/s."""

    covariances: Array
    """(T, G, 4, 4)."""


class FilteredMotion(NamedTuple):
    """Result of a filter that has run over T steps, for each of G sets of parameters."""

    log_likelihoods: Array
    """Log likelihoods (G,), up to a constant."""

    innovations: Array
    """Errors of the predicted specific force (T, G, 2), m/s²; NaN in steps that are not complete."""

    innovation_covariances: Array
    """Their covariances (T, G, 2, 2)."""

    predicted_states: Array
    """States before the measurement of each step (T, G, 4)."""

    predicted_covariances: Array
    """Their covariances (T, G, 4, 4)."""

    filtered_states: Array
    """States after the measurement of each step (T, G, 4)."""

    filtered_covariances: Array
    """Their covariances (T, G, 4, 4)."""

    decay: Array
    """Factors of the states in a step (G, 4)."""

    def smooth(self) -> SmoothedStates:
        """Smooths the states by all measurements, with the Rauch-Tung-Striebel smoother.

        It runs backwards from the last step. With the filtered state x and covariance P of a step t, the transition F,
        which is a decay of each state, the predictions x⁻ and P⁻ of step t + 1, and the gain K = P Fᵀ (P⁻)⁻¹:

            xₛ(t) = x(t) + K (xₛ(t + 1) − x⁻(t + 1)),    Pₛ(t) = P(t) + K (Pₛ(t + 1) − P⁻(t + 1)) Kᵀ

        (H. E. Rauch, F. Tung and C. T. Striebel, AIAA Journal 3(8), 1965).

        Returns:
            Smoothed states and covariances, for all sets of parameters.
        """
        states = self.filtered_states.copy()
        covariances = self.filtered_covariances.copy()
        propagated_covariances = (self.filtered_covariances[:-1] * self.decay[:, None, :]).mT
        gains = np.linalg.solve(self.predicted_covariances[1:], propagated_covariances).mT
        for t in range(len(states) - 2, -1, -1):
            K = gains[t]
            state_change = states[t + 1] - self.predicted_states[t + 1]
            covariance_change = covariances[t + 1] - self.predicted_covariances[t + 1]
            # One gain K (i, j) for each set g of parameters.
            states[t] += np.einsum("gij,gj->gi", K, state_change)
            covariances[t] += K @ covariance_change @ K.mT
        return SmoothedStates(states, covariances)


def filter_motion(parameters: Array, motion: MotionGrid) -> FilteredMotion:
    """Runs the filter over a motion, and collects the results that the smoother and the likelihood need of each step.

    Steps without force or velocity have no update; their innovations are NaN.

    Args:
        parameters: G sets of parameters (G, 10), as for :class:`AirflowFilter`.
        motion: attitude, velocity and specific force at T steps of an even time grid.

    Returns:
        States, covariances and innovations of all steps, for all sets of parameters.
    """
    airflow = AirflowFilter(parameters, motion)
    steps = len(motion.force)
    sets = len(parameters)
    predicted_states = np.empty((steps, sets, STATES))
    predicted_covariances = np.empty((steps, sets, STATES, STATES))
    filtered_states = np.empty((steps, sets, STATES))
    filtered_covariances = np.empty((steps, sets, STATES, STATES))
    innovations = np.full((steps, sets, 2), np.nan)
    innovation_covariances = np.full((steps, sets, 2, 2), np.nan)
    for t, is_complete in enumerate(motion.complete):
        if t > 0:
            airflow.predict()
        predicted_states[t] = airflow.states
        predicted_covariances[t] = airflow.covariances
        if is_complete:
            innovations[t], innovation_covariances[t] = airflow.update(motion, t)
        filtered_states[t] = airflow.states
        filtered_covariances[t] = airflow.covariances
    return FilteredMotion(
        airflow.log_likelihoods,
        innovations=innovations,
        innovation_covariances=innovation_covariances,
        predicted_states=predicted_states,
        predicted_covariances=predicted_covariances,
        filtered_states=filtered_states,
        filtered_covariances=filtered_covariances,
        decay=airflow.decay,
    )
