"""Maximisation by damped Gauss-Newton steps (Levenberg and Marquardt) of a function that is nearly quadratic."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array

FINITE_DIFFERENCE_STEP = 1e-4
"""Relative change of a parameter by which derivatives are computed as finite differences.

Smaller steps lose the difference in rounding, larger ones measure the curvature as well.
"""

CONVERGED_STEP_NATS = 5e-3
"""Gain of the last step, nats, below which a maximisation has converged.

A choice: strong evidence for one of two models is 3 nats, so such a gain does not decide between models.
"""

MAX_STEPS = 40
"""Largest number of steps of one maximisation, unless the caller sets another."""

MIN_DAMPING = 1e-6
"""Smallest damping, as a fraction of the curvature's diagonal: below it, the steps are Gauss-Newton's own."""

MIN_CURVATURE_RATIO = 1e-6
"""Least eigenvalue of a corrected curvature, relative to the Fisher information, with which the correction is used."""

MIN_SECANT_COSINE = 1e-12
"""Least cosine between a step and the change of the gradient by which a curvature is updated: it must be positive."""

POOR_GAIN_FACTOR = 4
"""Factor by which the damping grows after a step that gained less than a fifth of what the expansion predicted."""


class QuadraticExpansion(NamedTuple):
    """Second-order expansion of a function about a point x₀: f(x) ≈ f(x₀) + gᵀ(x − x₀) − ½ (x − x₀)ᵀ H (x − x₀)."""

    point: Array
    """(f,) the point x₀ about which the function is expanded."""

    value: float
    """Value f(x₀) of the function at the point, nats."""

    gradient: Array
    """(f,) gradient g at the point."""

    curvature: Array
    """(f, f) negative second derivative H, positive definite; of a log posterior, its precision."""

    @property
    def predicted_gain(self) -> float:
        """Increase of the function from the point to the maximum of the expansion, ½ gᵀ H⁻¹ g."""
        return float(0.5 * self.gradient @ np.linalg.solve(self.curvature, self.gradient))


class Objective(Protocol):
    """A function of f variables to maximise."""

    def value(self, point: Array, /) -> float:
        """Returns the value at a point (f,); NaN where the function is not defined."""

    def expand(self, point: Array, /) -> QuadraticExpansion:
        """Returns the second-order expansion about a point (f,); may raise LinAlgError if there is none."""


class Damping(NamedTuple):
    """How Levenberg and Marquardt's method damps and limits its steps."""

    initial: float
    """Damping of the first step, as a fraction of the curvature's diagonal."""

    factor: float
    """Factor by which damping grows after an attempt without a gain, and shrinks after a step with a good gain."""

    max_attempts: int
    """Largest number of attempts, each damped more, at one step."""

    limit_step: Callable[[Array], Array] = np.asarray
    """Shortens a step (f,) to a length at which the expansion still holds; by default the step is not changed."""

    def after_step(self, damping: float, gain: float, predicted_gain: float) -> float:
        """Returns the damping of the next step, by how well the expansion predicted the gain of the last one.

        If the gain is more than half of the predicted one, the damping is divided by ``factor``, down to
        ``MIN_DAMPING``. If it is less than a fifth, the step was too long for the expansion, and the damping is
        multiplied by ``POOR_GAIN_FACTOR``. In between it is kept. The two fractions are a choice.

        Args:
            damping: damping of the last step, as a fraction of the curvature's diagonal.
            gain: increase of the function by that step, positive, in the unit of the function.
            predicted_gain: increase that the expansion predicted, in the unit of the function.

        Returns:
            The damping of the next step, as a fraction of the curvature's diagonal.
        """
        if gain > predicted_gain / 2:
            return max(damping / self.factor, MIN_DAMPING)
        if gain > predicted_gain / 5:
            return damping
        return POOR_GAIN_FACTOR * damping


class CurvatureCorrection:
    """Secant correction of a curvature, as in NL2SOL: it estimates the second derivatives that Gauss-Newton lacks.

    The curvature of an expansion is mostly a Fisher information, which lacks the second derivatives of the residuals.
    If residuals are large, because no model is right, each step then covers only a fraction of the way. The secant
    update of Dennis, Gay and Welsch estimates the missing part from the changes of the gradient along the steps
    (NL2SOL, ACM Trans. Math. Software 7(3), 1981).
    """

    def __init__(self, size: int) -> None:
        """Begins without a correction, for a function of so many variables."""
        # The correction A (f, f), which is added to the curvature.
        self._correction = np.zeros((size, size))
        self._is_used = False

    def curvature(self, expansion: QuadraticExpansion) -> Array:
        """Returns the curvature of an expansion, with the correction if it would have predicted the last gain better.

        The correction is left out as well if the corrected curvature would not be positive definite.

        Args:
            expansion: the expansion, in f dimensions.

        Returns:
            The curvature (f, f).
        """
        if not self._is_used:
            return expansion.curvature
        corrected_curvature = expansion.curvature + self._correction
        # The variables may have different units: they are scaled so that the uncorrected curvature has a diagonal of 1.
        scale = np.sqrt(expansion.curvature.diagonal())
        least_eigenvalue = np.linalg.eigvalsh(corrected_curvature / np.outer(scale, scale))[0]
        is_positive_definite = least_eigenvalue > MIN_CURVATURE_RATIO
        return corrected_curvature if is_positive_definite else expansion.curvature

    def update(self, current: QuadraticExpansion, next_expansion: QuadraticExpansion) -> None:
        """Updates the correction by a step, along which the gradient changed by the true mean curvature.

        With the step s, the change y of the gradient and the curvature C of the expansion, a correction A must fulfil
        the secant equation (C + A) s = y. Of all corrections that do, the update yields the one that is nearest to the
        earlier correction, in a norm weighted by the curvature (as in the quasi-Newton method DFP).

        Args:
            current: expansion about the point before the step.
            next_expansion: expansion about the point after it.
        """
        step = next_expansion.point - current.point
        gradient_change = current.gradient - next_expansion.gradient
        missing_change = gradient_change - next_expansion.curvature @ step
        # If the earlier correction is larger along the step than what is missing now, it is scaled down.
        corrected_along_step = float(step @ self._correction @ step)
        if corrected_along_step:
            missing_along_step = float(step @ missing_change)
            self._correction *= min(1.0, abs(missing_along_step) / abs(corrected_along_step))
        self._satisfy_secant_equation(step, gradient_change, missing_change)

        # It is used next if it would have predicted the gain of this step better.
        gain = next_expansion.value - current.value
        plain_prediction = predicted_gain(current, current.curvature, step)
        corrected_prediction = plain_prediction - 0.5 * float(step @ self._correction @ step)
        self._is_used = abs(corrected_prediction - gain) < abs(plain_prediction - gain)

    def _satisfy_secant_equation(
        self, step: Array, gradient_change: Array, missing_change: Array
    ) -> None:
        """Changes the correction A so that it maps the step s to the missing change z of the gradient: A s = z.

        It is the symmetric rank-two update of the quasi-Newton method DFP (Nocedal and Wright, Numerical Optimization,
        2nd ed., sec. 6.1), for the target z instead of y. With e = z − A s, what the correction still lacks,

            A⁺ = A + (e yᵀ + y eᵀ) / (sᵀ y) − (sᵀ e) y yᵀ / (sᵀ y)²

        The correction is unchanged if the gradient hardly changed along the step, since the update divides by sᵀ y.

        Args:
            step: s (f,).
            gradient_change: y (f,), by which the gradient decreased along the step.
            missing_change: z = y − C s (f,), which the curvature C of the expansion does not explain.
        """
        change_along_step = float(step @ gradient_change)
        lengths = np.linalg.norm(step) * np.linalg.norm(gradient_change)
        is_determined = change_along_step > MIN_SECANT_COSINE * lengths
        if not is_determined:
            return
        residual = missing_change - self._correction @ step
        residual_along_step = float(step @ residual)
        outer_product = np.outer(residual, gradient_change)
        outer_gradient = np.outer(gradient_change, gradient_change)
        self._correction += (outer_product + outer_product.T) / change_along_step
        self._correction -= residual_along_step / change_along_step**2 * outer_gradient


def predicted_gain(expansion: QuadraticExpansion, curvature: Array, step: Array) -> float:
    """Returns the gain of a step that a quadratic expansion predicts, nats.

    Args:
        expansion: the expansion, of which only the gradient is used.
        curvature: negative second derivative (f, f).
        step: the step (f,).
    """
    return float(expansion.gradient @ step - 0.5 * step @ curvature @ step)


class Maximisation(NamedTuple):
    """Result of a maximisation: all its iterates, of which the last is the maximum if it has converged."""

    expansions: list[QuadraticExpansion]
    """Expansions of the function about all iterates, from the starting point to the last."""

    last_gain: float
    """Gain of the last step, nats: at most ``CONVERGED_STEP_NATS`` if the maximisation has converged.

    If no attempt at a further step increased the function, it is the gain that the last expansion predicts.
    """


def gauss_newton(
    objective: Objective,
    start: QuadraticExpansion,
    damping: Damping,
    iterations: int = MAX_STEPS,
    stop: Callable[[QuadraticExpansion], bool] = lambda expansion: False,
    *,
    corrects_curvature: bool = False,
) -> Maximisation:
    """Maximises a function by Levenberg and Marquardt's method.

    Each step maximises the expansion with a damped curvature, H + damping · diag(H). If a step does not increase the
    function, it is repeated with more damping. After a step that increases it, the damping is set by how well the
    expansion predicted the gain (Nocedal and Wright, Numerical Optimization, 2nd ed., sec. 10.3).

    Args:
        objective: function to maximise, with its gradient and curvature.
        start: its expansion about the starting point.
        damping: settings of the damping of steps.
        iterations: largest number of steps.
        stop: ends the search if it returns true for the latest expansion.
        corrects_curvature: whether the curvature of expansions is corrected by the changes of the gradients. This saves
            steps if the curvature differs much from the second derivative.

    Returns:
        The expansions about all iterates, ``start`` first, and the gain of the last step, which shows whether the
        search has converged.
    """
    expansions = [start]
    present_damping = damping.initial
    gain = np.inf
    # If the step before succeeded at the first attempt, the next one probably does as well.
    is_gain_likely = True
    correction = CurvatureCorrection(len(start.point)) if corrects_curvature else None
    while gain > CONVERGED_STEP_NATS and len(expansions) <= iterations and not stop(expansions[-1]):
        present = expansions[-1]
        curvature = present.curvature if correction is None else correction.curvature(present)
        attempt = _attempt_step(
            objective, present, curvature, damping, present_damping, is_gain_likely=is_gain_likely
        )
        if attempt.expansion is None:
            return Maximisation(expansions, present.predicted_gain)
        is_gain_likely = attempt.attempts == 1
        gain = attempt.expansion.value - present.value
        present_damping = damping.after_step(
            attempt.damping, gain, predicted_gain(present, curvature, attempt.step)
        )
        if correction is not None:
            correction.update(present, attempt.expansion)
        expansions.append(attempt.expansion)
    return Maximisation(expansions, gain)


class _StepAttempt(NamedTuple):
    """A damped step of the search, after some attempts with increasing damping."""

    expansion: QuadraticExpansion | None
    """Expansion about the point after the step; None if no attempt increased the function."""
    step: Array
    """The step of the last attempt (k,)."""
    damping: float
    """The damping of a successful step."""
    attempts: int
    """Number of attempts."""


def _attempt_step(
    objective: Objective,
    current: QuadraticExpansion,
    curvature: Array,
    damping: Damping,
    first_damping: float,
    *,
    is_gain_likely: bool,
) -> _StepAttempt:
    """Takes one Newton step from an iterate, with more and more damping until it increases the function.

    More damping makes the step shorter, and turns it towards the gradient.

    Args:
        objective: function to maximise.
        current: its expansion about the iterate, a point with k coordinates.
        curvature: (k, k) curvature H of the steps: that of the expansion, or one that was corrected.
        damping: settings of the damping: by which factor it increases, how often, and the longest step.
        first_damping: damping of the first attempt, as a fraction of the curvature's diagonal.
        is_gain_likely: whether the first attempt will probably increase the function, so that the function is expanded
            there at once. Otherwise its value alone is computed first, which takes less time.

    Returns:
        The successful attempt; the last one, without an expansion, if none was successful.
    """
    step = np.zeros(len(current.point))
    present_damping = first_damping
    for number in range(1, damping.max_attempts + 1):
        damped_curvature = curvature + present_damping * np.diag(current.curvature.diagonal())
        newton_step = np.asarray(np.linalg.solve(damped_curvature, current.gradient), float)
        step = damping.limit_step(newton_step)
        is_first_attempt = number == 1
        expansion = _higher_expansion(
            objective,
            point=current.point + step,
            present_value=current.value,
            is_gain_likely=is_gain_likely and is_first_attempt,
        )
        if expansion is not None:
            return _StepAttempt(expansion, step, present_damping, attempts=number)
        present_damping *= damping.factor
    return _StepAttempt(None, step, present_damping, attempts=damping.max_attempts)


def _higher_expansion(
    objective: Objective, point: Array, present_value: float, *, is_gain_likely: bool
) -> QuadraticExpansion | None:
    """Expands a function about the point after a step, if the step raises it.

    A step is only taken if it raises the function. An expansion has the value at its point too, so that a step that
    probably raises the function is expanded at once. Of other steps the value alone is computed first, which takes less
    time than an expansion, and mostly shows that none is needed.

    Args:
        objective: function to maximise, with its gradient and curvature.
        point: (f,) the point after the step.
        present_value: value of the function before the step, nats.
        is_gain_likely: whether the step probably raises the function.

    Returns:
        Value, gradient and curvature at the point; None if the function is not higher there, or not defined.
    """
    # If the function is not defined, its value is NaN and the comparison false.
    if not is_gain_likely and not objective.value(point) > present_value:
        return None
    try:
        expansion = objective.expand(point)
    except LinAlgError:
        return None
    return expansion if expansion.value > present_value else None
