"""Drag of a multirotor: linear and quadratic coefficients along body x and y, with their uncertainty.

The specific force by drag is −(c + q |u|) u per axis, with the velocity u relative to the air, linear drag c (1/s,
mostly of the rotors) and quadratic drag q (1/m, of the body). A lean b (m/s²) is specific force that no wind causes,
such as by a misaligned attitude estimate or an offset load.

The coefficients are estimated as logarithms, in this order: ln c and ln q, each the geometric mean of both axes;
ln(c_y / c_x) and ln(q_y / q_x); then the lean along x and y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import IntervalEstimate, coverage_factor
from mavdem.containers import JsonValues
from mavdem.dem.engine.linalg import require_positive_definite
from mavdem.facts.online import DragSource
from mavdem.immutable import ImmutableResult
from mavdem.ingest.vocabulary import SIH_AIRFRAMES

LOG_LINEAR = 0
"""Index of ln c in ``Drag.mean``."""

LOG_QUADRATIC = 1
"""Index of ln q in ``Drag.mean``."""

LOG_LINEAR_RATIO = 2
"""Index of ln(c_y / c_x) in ``Drag.mean``."""

LOG_QUADRATIC_RATIO = 3
"""Index of ln(q_y / q_x) in ``Drag.mean``."""

LOG_COEFFICIENTS = slice(0, 4)
"""Indices of the four logarithms of the drag in ``Drag.mean``."""

LEAN = slice(4, 6)
"""Indices of the lean along body x and y in ``Drag.mean``."""

DRAG_PARAMETERS = 6
"""Number of entries of ``Drag.mean``."""

AXIS_FRACTIONS = np.array([-0.5, 0.5])
"""Part of a log ratio y to x that is added to the logarithms of x and of y."""

POPULATION_MEAN = np.log([0.3, 0.014, 1.0, 1.0])
"""Logarithms of typical linear drag (1/s), quadratic drag (1/m), and their ratios of body y to x.

They are of 8 vehicles, 3 of them real, whose linear drag is 0.15 to 0.6 1/s. PX4's simulator SIH has 1, and is known
by its own parameters.
"""

POPULATION_SD = np.array([0.6, 0.9, 0.2, 0.35])
"""Standard deviations of these logarithms for another vehicle, by the same vehicles.

The range of 8 normal values is 2.85 standard deviations in the mean, so that of the linear drag over the vehicles is
ln(0.6 / 0.15) / 2.85 = 0.49. The interval that contains another vehicle with 90 % probability is wider, since mean and
deviation are of 8 only: by √(1 + 1/8), and by Student's t with 7 degrees of freedom.
"""

LEAN_SD = 0.18
"""Standard deviation of the lean over vehicles and flights, m/s²: 1° of misaligned attitude or offset load."""

LEAN_CHANGE_SD = 0.1
"""Standard deviation of the part of the lean that changes from flight to flight, m/s².

It was measured with a Solo next to an anemometer. PX4's simulator draws 0.05 to 0.4 m/s² of accelerometer bias a
flight.
"""

HALF_AIR_DENSITY = 1.225 / 2
"""Half of the air density at sea level, kg/m³, by which both autopilots define a ballistic coefficient."""

CONFIGURED_SD = 0.3
"""Standard deviation of the logarithm of a coefficient that a user set in the autopilot: few are calibrated."""

SIMULATED_DRAG_PARAMETERS = ("SIH_KDV", "SIH_MASS")
"""Names of PX4's parameters with the linear drag, N/(m/s), and the mass, kg, that its simulator SIH flies with."""

SIMULATED_SD = 0.1
"""Standard deviation of the logarithm of a simulator's drag: its equations are known, but not of each version."""

NO_QUADRATIC_DRAG = 1e-4
"""Quadratic drag, 1/m, of a simulator without any: at 10 m/s it is a hundredth of a small linear drag."""

MIN_MOMENTUM_DRAG = 0.001
"""Momentum drag coefficient, 1/s, up to which PX4's EKF2 takes that part of its drag model for switched off."""

MIN_BALLISTIC_COEFFICIENT = 1.0
"""Ballistic coefficient, kg/m², up to which PX4's EKF2 takes that part of its drag model for switched off."""

DRAG_PARAMETER_NAMES = {
    "ARDUPILOTMEGA": ("EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_"),
    "PX4": ("EKF2_MCOEF", "EKF2_BCOEF_"),
}
"""Names of the parameters of each autopilot's drag model.

They are the momentum drag coefficient, 1/s at sea level, and the ballistic coefficients along X and Y (a suffix of the
name), kg/m²: half of the air density over the quadratic drag.
"""

DRAG_MODEL_SETTINGS = {
    "ARDUPILOTMEGA": ("EK3_DRAG_MCOEF", "above 0"),
    "PX4": ("EKF2_DRAG_CTRL", "1"),
}
"""Parameter and value with which each autopilot estimates the wind itself, from drag: it is off by default.

Sources: ArduPilot ``AP_NavEKF3_Measurements.cpp`` (``SampleDragData``, from 0.001 1/s), PX4 ``drag_fusion.cpp``.
"""

MAX_BALLISTIC_COEFFICIENTS = {"ARDUPILOTMEGA": 1000.0, "PX4": 200.0}
"""Largest ballistic coefficient, kg/m², that each autopilot's documentation of its parameters allows.

A vehicle with more has so little quadratic drag that this part of the drag model is to be left switched off.
"""

MAX_MOMENTUM_COEFFICIENT = 1.0
"""Largest momentum drag coefficient, 1/s, that both autopilots' documentation of their parameters allows."""

FACTORY_VALUES = {
    "EKF2_MCOEF": (0.15,),
    "EKF2_BCOEF_X": (25.0, 100.0),
    "EKF2_BCOEF_Y": (25.0, 100.0),
}
"""Values that PX4's parameters have in some version unless a user sets others; ArduPilot's are 0, switched off."""

MAX_DEVIATION = np.array([4.0, 6.0, 3.0, 3.0, 5.0, 5.0])
"""Largest plausible deviation of each entry of ``Drag.mean`` from the population.

It is a factor of 20 to 400 for the logarithms, and in m/s² for the lean.
"""

PARAMETER_DECIMALS = 6
"""Decimals of a parameter that are compared with its factory value: it was a float of 32 bits."""


def drag_model_setting(autopilot: str, parameters: Mapping[str, float]) -> str:
    """Returns the setting with which an autopilot estimates the wind itself, such as "EKF2_DRAG_CTRL 1".

    Args:
        autopilot: name of the autopilot.
        parameters: values of the autopilot's parameters by name; empty if they were not recorded.

    Returns:
        The setting; empty if the autopilot has none, as firmware before ArduPilot 4.1 and PX4 v1.14.
    """
    if autopilot not in DRAG_MODEL_SETTINGS:
        return ""
    name, value = DRAG_MODEL_SETTINGS[autopilot]
    # If no parameters were recorded, the firmware is assumed to have this one.
    is_missing = bool(parameters) and name not in parameters
    return "" if is_missing else f"{name} {value}"


class AxisDrag(NamedTuple):
    """Drag coefficients along body x and y."""

    linear: Array
    """Linear drag (…, 2), 1/s."""

    quadratic: Array
    """Quadratic drag (…, 2), 1/m."""


def axis_drag(logarithms: Array) -> AxisDrag:
    """Returns the drag along body x and y, from the logarithms of its mean over both axes and of the ratio of y to x.

    With the mean m and the ratio r of a coefficient, it is m / √r along x and m · √r along y.

    Args:
        logarithms: (…, 4 or more) logarithms; the first four are ordered as in ``Drag.mean``.

    Returns:
        Linear and quadratic coefficients (…, 2) along body x and y.
    """
    log_linear = logarithms[..., [LOG_LINEAR]]
    log_quadratic = logarithms[..., [LOG_QUADRATIC]]
    log_linear_ratio = logarithms[..., [LOG_LINEAR_RATIO]]
    log_quadratic_ratio = logarithms[..., [LOG_QUADRATIC_RATIO]]
    # ``AXIS_FRACTIONS`` is −1/2 for x and 1/2 for y.
    return AxisDrag(
        np.exp(log_linear + log_linear_ratio * AXIS_FRACTIONS),
        np.exp(log_quadratic + log_quadratic_ratio * AXIS_FRACTIONS),
    )


@dataclass(frozen=True, eq=False)
class Drag(ImmutableResult):
    """Drag of one vehicle per mass, c u + q u² at an air speed u along each body axis, with its uncertainty.

    Attributes:
        mean: (6,) ln c and ln q, geometric means of both axes; ln(c_y / c_x) and ln(q_y / q_x); and :attr:`lean`.
        covariance: (6, 6) of these.
        source: what the drag is known from.
    """

    mean: Array
    covariance: Array
    source: DragSource = DragSource.POPULATION

    @classmethod
    def from_parameters(
        cls, autopilot: str = "", parameters: Mapping[str, float] = MappingProxyType({})
    ) -> Drag:
        """Returns a first estimate of a vehicle's drag, from typical multirotors and the autopilot's parameters.

        The state estimators of both autopilots have a drag model, with parameters for linear drag (the momentum drag
        coefficient, 1/s) and for quadratic drag (a ballistic coefficient along body x and y, kg/m²). Coefficients that
        have been set there replace the typical ones of ``POPULATION_MEAN``, with the smaller standard deviation
        ``CONFIGURED_SD``. Factory values, and values so small that they disable a part of that model, contain no
        information on this vehicle, and are ignored. PX4's simulator SIH states the drag that it flies with.

        Args:
            autopilot: "ARDUPILOTMEGA" or "PX4"; of others no parameters are known.
            parameters: values of the autopilot's parameters by name, in the autopilot's units.

        Returns:
            The drag, with independent entries (a diagonal covariance), a lean of zero mean, and its source.
        """
        momentum_name, ballistic_prefix = DRAG_PARAMETER_NAMES.get(autopilot, ("", ""))
        momentum = _configured_value(momentum_name, parameters)
        ballistic_x = _configured_value(f"{ballistic_prefix}X", parameters)
        ballistic_y = _configured_value(f"{ballistic_prefix}Y", parameters)
        logarithms = POPULATION_MEAN.copy()
        sd = POPULATION_SD.copy()
        source = DragSource.POPULATION
        if momentum > MIN_MOMENTUM_DRAG:
            logarithms[LOG_LINEAR] = np.log(momentum)
            sd[LOG_LINEAR] = CONFIGURED_SD
            source = DragSource.PARAMETERS
        if ballistic_x > MIN_BALLISTIC_COEFFICIENT and ballistic_y > MIN_BALLISTIC_COEFFICIENT:
            # Quadratic drag is half of the air density divided by the ballistic coefficient. So its geometric mean over
            # both axes follows from the mean of the coefficients, and its ratio of y to x is the inverse of their
            # ratio.
            quadratic = HALF_AIR_DENSITY / np.sqrt(ballistic_x * ballistic_y)
            ratio = ballistic_x / ballistic_y
            logarithms[[LOG_QUADRATIC, LOG_QUADRATIC_RATIO]] = np.log([quadratic, ratio])
            sd[[LOG_QUADRATIC, LOG_QUADRATIC_RATIO]] = CONFIGURED_SD
            source = DragSource.PARAMETERS
        simulated_drag, mass = (parameters.get(name, 0.0) for name in SIMULATED_DRAG_PARAMETERS)
        # Boards of real vehicles have these parameters too, with their factory values.
        is_simulated = parameters.get("SYS_AUTOSTART") in SIH_AIRFRAMES
        if is_simulated and simulated_drag > 0 and mass > 0:
            logarithms[[LOG_LINEAR, LOG_QUADRATIC]] = np.log(
                [simulated_drag / mass, NO_QUADRATIC_DRAG]
            )
            sd[:] = SIMULATED_SD
            source = DragSource.PARAMETERS
        mean = np.append(logarithms, [0.0, 0.0])
        variances = np.append(sd, [LEAN_SD, LEAN_SD]) ** 2
        return cls(mean, np.diag(variances), source)

    @classmethod
    def validated_or_population(cls, drag: Drag | None) -> Drag:
        """Checks a drag that a caller has passed, and replaces None by the drag of the population.

        Args:
            drag: drag of the vehicle, for example from an earlier flight; ``None`` if it is not known.

        Returns:
            The drag itself, or the drag of the population of typical multirotors.

        Raises:
            ValueError: it is not a ``Drag``, or its values are impossible.
        """
        if drag is None:
            return cls.from_parameters()
        if not isinstance(drag, cls):
            raise ValueError(f"drag must be a Drag, not {drag!r}")
        return drag.validated()

    @property
    def linear(self) -> Array:
        """Linear drag (2,) along body x and y, 1/s: medians."""
        return axis_drag(self.mean).linear

    @property
    def quadratic(self) -> Array:
        """Quadratic drag (2,) along body x and y, 1/m: medians."""
        return axis_drag(self.mean).quadratic

    @property
    def lean(self) -> Array:
        """Specific force (2,) along body x and y that no wind causes, m/s²."""
        return self.mean[LEAN]

    def interval(self, name: str) -> Array:
        """Returns the 90 % interval of a coefficient along body x and y.

        The logarithm of the coefficient of an axis has a normal distribution: it is the logarithm of the mean of both
        axes minus (x) or plus (y) half of the log ratio of y to x. As it is linear in :attr:`mean`, its variance
        follows from the covariance. The ends of its interval, exponentiated, are the coefficient's.

        Args:
            name: "linear" (1/s) or "quadratic" (1/m).

        Returns:
            (2, 2) lower ends in the first row and upper ends in the second; columns are body x and y.
        """
        log_mean, log_ratio = {
            "linear": (LOG_LINEAR, LOG_LINEAR_RATIO),
            "quadratic": (LOG_QUADRATIC, LOG_QUADRATIC_RATIO),
        }[name]
        medians = {"linear": self.linear, "quadratic": self.quadratic}[name]
        # Row x is 1 · ln mean − ½ · ln ratio, and row y is 1 · ln mean + ½ · ln ratio.
        weights = np.zeros((2, DRAG_PARAMETERS))
        weights[:, log_mean] = 1.0
        weights[:, log_ratio] = AXIS_FRACTIONS
        log_sd = np.sqrt(np.diag(weights @ self.covariance @ weights.T))
        log_half_width = coverage_factor() * log_sd
        return np.array([medians * np.exp(-log_half_width), medians * np.exp(log_half_width)])

    def relative_sd(self, speed: float) -> float:
        """Returns the relative standard deviation of the drag force at an air speed in m/s, to first order.

        The drag per mass is c u + q u² at the speed u. Its derivatives by the parameters ln c and ln q are the two
        terms c u and q u², from which the variance follows by the covariance of the parameters. The common factor u
        cancels in the ratio of deviation and drag. Differences between body x and y are neglected.

        Args:
            speed: air speed, m/s.
        """
        parameters = [LOG_LINEAR, LOG_QUADRATIC]
        linear_term, quadratic_term = np.exp(self.mean[parameters])
        gradient = np.array([linear_term, quadratic_term * speed])
        covariance = self.covariance[np.ix_(parameters, parameters)]
        sd = np.sqrt(gradient @ covariance @ gradient)
        return float(sd / gradient.sum())

    def at_speed(self, speed: float) -> IntervalEstimate:
        """Returns the drag force per mass and air speed, c + q u, 1/s, at an air speed in m/s.

        Linear and quadratic drag of a flight are less certain than this sum of both at the speeds that were flown. The
        interval is that of a log-normal distribution, to first order (:meth:`relative_sd`). Differences between body x
        and y are neglected.

        Args:
            speed: air speed u, m/s.
        """
        linear, quadratic = np.exp(self.mean[[LOG_LINEAR, LOG_QUADRATIC]])
        value = float(linear + quadratic * speed)
        log_half_width = coverage_factor() * self.relative_sd(speed)
        return IntervalEstimate(
            value, low=value * np.exp(-log_half_width), high=value * np.exp(log_half_width)
        )

    def autopilot_parameters(self, autopilot: str) -> dict[str, IntervalEstimate]:
        """Converts the drag to the parameters of the drag model in an autopilot's state estimator.

        The momentum coefficient is the linear drag c in 1/s, common to both axes. A ballistic coefficient, kg/m², is
        the mass per effective area of one axis: half of the air density over the quadratic drag q.

        Args:
            autopilot: name of the autopilot, a key of ``DRAG_PARAMETER_NAMES``.

        Returns:
            Value with its 90 % interval by name of the parameter; empty for an autopilot without such a model. A
            coefficient beyond ``MAX_MOMENTUM_COEFFICIENT`` or ``MAX_BALLISTIC_COEFFICIENTS`` is left out, since the
            autopilot does not take it.
        """
        if autopilot not in DRAG_PARAMETER_NAMES:
            return {}
        momentum_name, ballistic_prefix = DRAG_PARAMETER_NAMES[autopilot]
        # The interval of the common coefficient is the mean of the intervals of both axes.
        low, high = self.interval("linear").mean(axis=1).tolist()
        momentum = float(np.exp(self.mean[LOG_LINEAR]))
        parameters = {}
        if momentum <= MAX_MOMENTUM_COEFFICIENT:
            parameters[momentum_name] = IntervalEstimate(momentum, low, high)
        # A ballistic coefficient is inverse to the drag, so that the ends of the interval are exchanged.
        quadratic_low, quadratic_high = self.interval("quadratic")
        values = HALF_AIR_DENSITY / self.quadratic
        lows = HALF_AIR_DENSITY / quadratic_high
        highs = HALF_AIR_DENSITY / quadratic_low
        for index, axis in enumerate("XY"):
            value = float(values[index])
            if value <= MAX_BALLISTIC_COEFFICIENTS[autopilot]:
                parameters[f"{ballistic_prefix}{axis}"] = IntervalEstimate(
                    value, float(lows[index]), float(highs[index])
                )
        return parameters

    def for_next_flight(self) -> Drag:
        """Returns the drag of this flight as the prior for another flight of the vehicle.

        The drag coefficients are the same. The lean has a constant part, as by an offset load, and a part that changes
        from flight to flight, as by the accelerometers' bias (``LEAN_CHANGE_SD``). So its mean is multiplied by the
        fraction a of its variance that is constant, and its variance P becomes a² P + (1 − a²) times the square of
        ``LEAN_SD``. This is a step of a first-order autoregression whose stationary variance is the population's.

        Returns:
            The prior, whose source is an earlier flight if this drag was identified in one.
        """
        constant_fraction = 1 - (LEAN_CHANGE_SD / LEAN_SD) ** 2
        # Factors of the means of all parameters: 1 for the coefficients of the drag.
        kept_fractions = np.ones(DRAG_PARAMETERS)
        kept_fractions[LEAN] = constant_fraction
        added_variances = np.zeros(DRAG_PARAMETERS)
        added_variances[LEAN] = LEAN_SD**2 * (1 - constant_fraction**2)
        mean = self.mean * kept_fractions
        kept_covariance = self.covariance * np.outer(kept_fractions, kept_fractions)
        source = self.source
        if source is DragSource.FLIGHT:
            source = DragSource.EARLIER_FLIGHT
        return Drag(mean, kept_covariance + np.diag(added_variances), source)

    def as_dict(self) -> JsonValues:
        """Returns plain JSON values, from which :meth:`from_dict` restores the drag.

        ``mean`` and ``covariance`` belong to the logarithms of the coefficients and of the lean; with ``source``
        they define the drag. The others are for readers: ``linear`` (1/s) and ``quadratic`` (1/m) are medians along
        body x and y, and their intervals are two rows, the lower ends and the upper ends of the 90 % intervals.
        """
        return {
            "linear": self.linear.tolist(),
            "quadratic": self.quadratic.tolist(),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "linear_interval": self.interval("linear").tolist(),
            "quadratic_interval": self.interval("quadratic").tolist(),
            "source": self.source,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Drag:
        """Makes a drag from plain values, such as a JSON file has; the inverse of :meth:`as_dict`.

        Args:
            values: ``mean`` (6,), ``covariance`` (6, 6) and ``source``; other keys are ignored.

        Returns:
            The drag.

        Raises:
            KeyError: a value is missing.
            ValueError: a value has another shape, or the drag is physically impossible.
        """
        mean = np.array(values["mean"], float).reshape(DRAG_PARAMETERS)
        covariance = np.array(values["covariance"], float)
        covariance = covariance.reshape(DRAG_PARAMETERS, DRAG_PARAMETERS)
        return cls(mean, covariance, DragSource(values["source"])).validated()

    def validated(self) -> Drag:
        """Checks that a vehicle can have this drag, and returns it unchanged.

        Logarithms of coefficients, and a lean, that differ from typical vehicles' by more than
        ``MAX_DEVIATION`` are caused by mistakes in units or in a file.

        Returns:
            This drag itself.

        Raises:
            ValueError: no vehicle can have it, or its covariance is not positive definite.
        """
        if np.shape(self.mean) != (DRAG_PARAMETERS,):
            raise ValueError(f"a drag has a mean of 6 numbers, not {np.shape(self.mean)}")
        population = np.append(POPULATION_MEAN, np.zeros(2))
        if not (abs(self.mean - population) <= MAX_DEVIATION).all():
            raise ValueError("no vehicle has such a drag")
        require_positive_definite(self.covariance, "covariance", DRAG_PARAMETERS)
        return self


def _configured_value(name: str, parameters: Mapping[str, float]) -> float:
    """Returns the value that a user has set a drag parameter to; 0 for factory values and where it is missing.

    Args:
        name: name of the parameter.
        parameters: values of the autopilot's parameters by name.
    """
    value = parameters.get(name, 0.0)
    is_factory_value = round(value, PARAMETER_DECIMALS) in FACTORY_VALUES.get(name, ())
    return 0.0 if is_factory_value else value


def air_speed(linear: Array, quadratic: Array, force: float) -> Array:
    """Returns the air speed (…), m/s, at which linear (…) and quadratic (…) drag cause a specific force in m/s²."""
    return 2 * force / (linear + np.sqrt(linear**2 + 4 * quadratic * force))
