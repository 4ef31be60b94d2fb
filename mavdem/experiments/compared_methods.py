"""Forecasting methods that are compared: mavdem's default, DEM's variants, other identification, trivial forecasts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from mavdem.dem import Settings, learn
from mavdem.experiments import methods
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster


class Method(NamedTuple):
    """A method to compare."""

    name: str
    """Name, unique among the methods."""

    learn: Callable[[Flight], Forecaster]
    """Trains a model on a flight. It must pickle, since it runs in other processes."""

    predicts: bool = False
    """Whether the model can also forecast without the inputs during the forecast (its method ``predict``)."""

    window_seconds: float = 0.05
    """Typical processor time for a window of the default length at 100 Hz, s: mean of a log of each autopilot."""


PLANT = Settings(forecasts="plant")
"""Settings of DEM's model with the motors as causes."""

DEM_SETTINGS = {
    MethodName.JOINT: Settings(),
    MethodName.PLANT: PLANT,
    MethodName.PLANT_P1: replace(PLANT, p=1, d=1),
    MethodName.PAPER: Settings.paper(),
    MethodName.PAPER_P1: replace(Settings.paper(), p=1, d=1, window=2),
}
"""Settings of DEM by the name of the method.

p = 1 is what the paper calls without generalized coordinates (section V.G): the first derivative only, which the model
itself needs.
"""


DEFAULT_METHOD = MethodName.JOINT
"""The method by which ``mavdem.learn`` and the commands forecast."""


def _compared_methods() -> Iterator[Method]:
    """Yields the methods of ``mavdem compare``, the reference first: mavdem's default is compared with all others.

    They are DEM by several settings; subspace identification, prediction-error method (PEM) and expectation
    maximisation (EM) with 2 or 4 states; joint vector autoregressions (VAR) of 4 and 10 lags; and three trivial
    forecasts. Methods that can forecast without the inputs are marked by ``predicts``.
    """
    for name, settings in DEM_SETTINGS.items():
        yield Method(
            name,
            partial(learn, settings=settings),
            predicts=name is DEFAULT_METHOD,
            window_seconds=0.2,
        )
    for order in (2, 4):
        yield Method(f"subspace({order})", partial(methods.subspace, order=order))
    yield Method("PEM(2)", partial(methods.pem, order=2), window_seconds=0.5)
    yield Method("PEM(4)", partial(methods.pem, order=4), window_seconds=2.8)
    yield Method("EM(2)", partial(methods.em, order=2), window_seconds=0.5)
    for order in (4, 10):
        yield Method(
            f"{MethodName.JOINT_VAR}({order})", partial(methods.var, order=order), predicts=True
        )
    yield Method(HeldOutForecast.CONSTANT_MEAN, methods.constant_mean, predicts=True)
    yield Method(HeldOutForecast.HOLD_LAST, methods.hold, predicts=True)
    yield Method("zero", methods.zero)


METHODS = tuple(_compared_methods())
"""The methods of ``mavdem compare``; the first is compared with each of the others."""

STANDARD_METHOD_NAMES = (
    DEFAULT_METHOD,
    MethodName.PLANT,
    MethodName.PLANT_P1,
    "PEM(2)",
    "subspace(2)",
    "EM(2)",
    f"{MethodName.JOINT_VAR}(10)",
    HeldOutForecast.CONSTANT_MEAN,
    HeldOutForecast.HOLD_LAST,
    "zero",
)
"""Names of the methods that are compared unless a user names others: of each kind the one that is sensible for a log.

Left out are the paper's settings, which are for its simulations, and further orders of the same methods: PEM with 4
states alone takes more time than all of these.
"""

STANDARD_METHODS = tuple(method for method in METHODS if method.name in STANDARD_METHOD_NAMES)
"""The methods of ``mavdem compare`` without ``--methods``, in the order of ``METHODS``."""

QUICK_METHOD_NAMES = (
    DEFAULT_METHOD,
    MethodName.PLANT,
    HeldOutForecast.CONSTANT_MEAN,
    HeldOutForecast.HOLD_LAST,
)
"""Names of methods that take less than a second a window: what mavdem uses, and the baselines."""
