"""Errors whose cause is the data or a missing package, and what is imported only when it is called for."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from math import pi
from typing import Any

from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts
from mavdem.facts.prose import Prose, prose

REMEDIES = {
    "attach",
    "check",
    "convert",
    "cut",
    "delete",
    "fetch",
    "give",
    "install",
    "make",
    "move",
    "name",
    "save",
}
"""Words that begin what to do; transitional, until each refusal is a fact of its own."""


class Refusal(ValueError):
    """What cannot be done, and why: a fact, whose sentence and remedy are the message."""

    def __init__(self, fact: Fact | str, remedy: str = "") -> None:
        super().__init__(fact, remedy)
        self.fact = prose(fact, remedy) if isinstance(fact, str) else fact

    def __str__(self) -> str:
        return f"{self.fact} {self.fact.remedy}".strip()

    @property
    def reason(self) -> str:
        """The sentence: what is wrong, with the figures."""
        return str(self.fact)

    @property
    def remedy(self) -> str:
        """What to change, with a command where there is one; may be empty."""
        return self.fact.remedy


class Unreadable(Refusal):
    """A source that cannot be opened, or that holds nothing which can be read."""

    def __init__(self, fact: Fact | str, remedy: str = "") -> None:
        if isinstance(fact, str):
            advice = fact.rpartition(": ")[2]
            remedy = remedy or (
                advice[:1].upper() + advice[1:] if advice.split(" ")[0] in REMEDIES else ""
            )
        super().__init__(fact, remedy)

    def __str__(self) -> str:
        return self.reason if self.fact.code is Prose.PROSE else super().__str__()


class NotLearnable(Refusal):
    """Data that cannot support the request: fitting them would give numbers that mean nothing."""


def fact_of(error: BaseException) -> Fact:
    """Returns what an ``error`` says: the fact of a refusal, else its message, with its type where that is unusual."""
    if isinstance(error, Refusal):
        return error.fact
    kind = "" if isinstance(error, ValueError) else type(error).__name__
    return Fact(Forecasts.FAILED, error=kind, text=str(error))


SLIPS = {57.3: "The angle seems to be in degrees", 1 / 57.3: "The rate seems to be in degrees/s"}
SLIPS |= {1e-3: "Time seems to be in milliseconds", 1e-6: "Time seems to be in microseconds"}
"""What is likely by how many times as much an angle changes as its rate says."""


def unit_slip(outputs: Any, dt: float) -> str:
    """Returns a sentence where an angle and its rate, ``outputs`` (T, 2), or time ``dt`` seem to have another unit."""
    angle = outputs[:, 0]
    turned = outputs[:, -1].cumsum() * dt
    # so that noise counts little
    changed, expected = (values[8:] - values[:-8] for values in (angle, turned))
    if (
        outputs.shape[1] != 2
        or not changed @ expected > 0.9 * (changed @ changed * (expected @ expected)) ** 0.5
    ):
        return ""  # no angle and its rate
    ratio = changed @ expected / (expected @ expected)
    most = abs(angle).max()
    cause = next((cause for slip, cause in SLIPS.items() if 0.8 < ratio / slip < 1.25), "")
    if 0.8 < ratio < 1.25 and most > pi:
        cause = "Angle and rate seem to be in degrees"
    says = f"the angle changes {ratio:.3g} times as much as its rate says, and reaches {most:.3g}"
    return f"{cause} ({says}): give seconds, rad and rad/s." if cause else ""


EXTRAS = {  # modules by the name of the extra in pyproject.toml
    "control": ("control",),
    "dask": ("distributed",),
    "pandas": ("pandas",),
    "parquet": ("pyarrow",),
    "ros2": ("mcap_ros2",),
    "urls": ("aiohttp", "fsspec"),
    "view": ("rerun",),
    "xarray": ("xarray",),
}


class MissingExtra(ImportError):
    """A package of an extra is not installed; the message is one sentence with the command that installs it."""


def missing(extra: str) -> tuple[str, ...]:
    """Returns the modules of an extra that are not installed; nothing is imported."""
    return tuple(name for name in EXTRAS[extra] if find_spec(name) is None)


def advice(purpose: str, extra: str) -> str:
    """Returns a sentence such as "The dashboard needs rerun: pip install 'mavdem[view]'."; empty if none is missing."""
    names = missing(extra)
    return f"{purpose} needs {' and '.join(names)}: pip install 'mavdem[{extra}]'." if names else ""


def require(purpose: str, extra: str) -> None:
    """Raises ``MissingExtra`` with :func:`advice` if a package of the extra is missing."""
    if sentence := advice(purpose, extra):
        raise MissingExtra(sentence)


def downstream(module: str, name: str, purpose: str = "", extra: str = "") -> Any:
    """Returns what ``mavdem.<module>`` calls ``name``, which may need an ``extra`` for a ``purpose``."""
    if extra:
        require(purpose, extra)
    return getattr(import_module(f"mavdem.{module}"), name)


class FlightDownstream:
    """What becomes of a :class:`mavdem.Flight`; ImportError is raised where a package is not installed."""

    def to_pandas(self) -> Any:
        """Returns a ``pandas.DataFrame``: a row a sample, by time in s; columns with units as in ``flight.csv``."""
        return downstream("export.conversion", "to_pandas", "Flight.to_pandas()", "pandas")(self)

    def to_xarray(self) -> Any:
        """Returns an ``xarray.Dataset``: inputs and outputs by time in s and name, their units beside them."""
        return downstream("export.conversion", "to_xarray", "Flight.to_xarray()", "xarray")(self)

    def _repr_html_(self) -> str:
        return str(downstream("report.page", "flight_html")(self))


class LearnedDownstream:
    """What becomes of a :class:`mavdem.Learned`; ImportError is raised where a package is not installed."""

    @property
    def plot(self) -> Any:
        """Its pictures: ``plot.bode()`` and others return a ``matplotlib`` figure; see ``report.figures.Plots``."""
        return downstream("report.figures", "Plots")(self)

    def summary(self) -> str:
        """Returns what the vehicle does in wind, on one screen; without windows that the model has not seen.

        ``mavdem.evaluate.held_out_windows`` forecasts such windows.
        """
        return str(downstream("report.screen", "summary")(self))

    def score(self, flight: Any) -> float:
        """Returns 1 − error ratio (NMSE) of a ``flight`` that it has not seen; :func:`mavdem.evaluate.score_of`."""
        return float(downstream("evaluate", "score_of")(self, flight))

    def to_control(self, model: str = "physical") -> Any:
        """Returns the physical plant with its delay, or DEM's own ``model="dem"``, as a ``control.StateSpace``.

        About the trim, with names of inputs and outputs; its ``name`` says which it is. ``.delay``, s, and ``.draws``,
        plants from the posterior, are the physical plant's. ``ValueError`` where there is none, with the reason.
        """
        return downstream("export.conversion", "to_control", "Learned.to_control()", "control")(
            self, model
        )

    def loop(self, controller: Any = None) -> Any:
        """Returns rate and attitude loop: the plant, and the ``controller`` of the log's parameters unless given.

        >>> loop = learned.loop()
        >>> loop.phase_margin, loop.phase_margin_interval, loop.gain_margin, loop.crossover  # degrees, dB, Hz

        Raises :class:`NotLearnable`: the plant is not identifiable, or the controller is not known.
        """
        return downstream("condition.loop.from_flight", "loop")(self, controller)

    def _repr_html_(self) -> str:
        return str(downstream("report.page", "learned_html")(self))
