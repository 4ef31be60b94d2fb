"""What rooms make of flights, models, assessments and facts for rooms below; each is imported when it is called."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

from mavdem.extras import require
from mavdem.facts import Fact, Words
from mavdem.heading import Values

if TYPE_CHECKING:
    from mavdem.assessment.assess import Assessment
    from mavdem.condition.loop.advice import Advice
    from mavdem.condition.loop.loop import Loop
    from mavdem.condition.loop.twin import Twin
    from mavdem.dem import Learned
    from mavdem.dem.engine.linalg import Array
    from mavdem.flight import Flight
    from mavdem.report.figures import Plots


def words(fact: Fact) -> Words:
    """Returns the sentence and the remedy of a ``fact``."""
    from mavdem.report.words import words

    return words(fact)


def to_pandas(flight: Flight) -> Any:
    """Returns a ``flight`` as a ``pandas.DataFrame``."""
    require("pandas", "Flight.to_pandas()")
    from mavdem.export.conversion import to_pandas

    return to_pandas(flight)


def to_xarray(flight: Flight) -> Any:
    """Returns a ``flight`` as an ``xarray.Dataset``."""
    require("xarray", "Flight.to_xarray()")
    from mavdem.export.conversion import to_xarray

    return to_xarray(flight)


def flight_html(flight: Flight) -> str:
    """Returns a ``flight`` for a notebook."""
    from mavdem.report.page import flight_html

    return flight_html(flight)


def learned_html(learned: Learned) -> str:
    """Returns a model for a notebook."""
    from mavdem.report.page import learned_html

    return learned_html(learned)


def plots(learned: Learned) -> Plots:
    """Returns the pictures of a model."""
    require("plot", "Learned.plot")
    from mavdem.report.figures import Plots

    return Plots(learned)


def summary(learned: Learned) -> str:
    """Returns what a model says of its vehicle, on one screen."""
    from mavdem.report.screen import summary

    return summary(learned)


def to_control(learned: Learned, model: str) -> Any:
    """Returns a ``model`` as a ``control.StateSpace``."""
    require("control", "Learned.to_control()")
    from mavdem.export.conversion import to_control

    return to_control(learned, model)


def loop(learned: Learned, controller: Any) -> Loop:
    """Returns the control loops of a model."""
    from mavdem.condition.loop.from_flight import loop

    return loop(learned, controller)


def advice(loop: Loop) -> Advice:
    """Returns gains for a control ``loop``."""
    from mavdem.condition.loop.advice import advise

    return advise(loop)


def replayed(twin: Twin, dt: float, setpoints: Array, torque: Array, seed: int) -> Array:
    """Returns how the simulator flies a ``twin``."""
    from mavdem.report.vehicle_files import vehicle_text
    from sitl_scenarios.files import scenario_of
    from sitl_scenarios.simulation import replayed

    vehicle = tomllib.loads(vehicle_text(twin, ".toml", ""))
    return replayed(scenario_of(vehicle | {"seed": seed}), dt, setpoints, torque)


def assessment_page(assessment: Assessment) -> str:
    """Returns the HTML of the page of an ``assessment``."""
    from mavdem.report.flight_page import review_page

    return review_page(assessment)


def assessment_document(assessment: Assessment) -> Values:
    """Returns the document of an ``assessment``."""
    from mavdem.documents import whole
    from mavdem.documents.review import review_document

    return whole("review", review_document(assessment))


def assessment_screen(assessment: Assessment) -> str:
    """Returns an ``assessment`` on one screen."""
    from mavdem.report.review import screen_of

    return screen_of(assessment)
