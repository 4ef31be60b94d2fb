"""Models of the JSON document of ``mavdem wind``: the wind in m/s, and the drag of the vehicle."""

from __future__ import annotations

import numpy as np
from pydantic import field_validator, model_validator

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.containers import JsonValues
from mavdem.documents.document import Document, Judged, ModelField, SentenceText
from mavdem.documents.vehicle import Identity
from mavdem.facts.model import ModelName
from mavdem.units import (
    Degrees,
    Metres,
    Number,
    ParameterValue,
    PerMetre,
    PerSecond,
    Seconds,
    Speed,
)
from mavdem.wind_velocity import vehicle_drag
from mavdem.wind_velocity.velocity import WindVelocity as WindEstimate

COURSE_DECIMALS = 4
"""Decimals of times (s) and velocities (m/s) in a document: the wind is known to about a decimetre a second."""


class WindMinute(Document):
    """Mean wind of a part of the flight of about a minute."""

    start: Seconds
    """on the boot clock"""
    end: Seconds
    """on the boot clock"""
    speed: Speed
    """mean speed"""
    low: Speed
    """lower end of its 90 % interval"""
    high: Speed
    """upper end of its 90 % interval"""
    direction: Degrees
    """where the wind comes from, clockwise from north"""


class WindLayer(Document):
    """Mean wind of a layer of about 10 m of height."""

    height: Metres
    """mean height of the vehicle in the layer"""
    speed: Speed
    """mean speed"""
    low: Speed
    """lower end of its 90 % interval"""
    high: Speed
    """upper end of its 90 % interval"""
    direction: Degrees
    """where the wind comes from, clockwise from north"""


class Drag(Document):
    """Drag of the vehicle, linear and quadratic in the airspeed."""

    linear: list[PerSecond]
    """linear drag along body x and y"""
    quadratic: list[PerMetre]
    """quadratic drag along body x and y"""
    mean: list[float]
    """mean of the six numbers (logarithms, and leans) that it is computed with"""
    covariance: list[list[float]]
    """covariance of these numbers"""
    linear_interval: list[list[PerSecond]]
    """ends of the 90 % intervals of linear"""
    quadratic_interval: list[list[PerMetre]]
    """ends of the 90 % intervals of quadratic"""
    source: str
    """what it is known from: flight, parameters, population or an earlier flight"""

    @model_validator(mode="before")
    @classmethod
    def _values_of_drag(cls, drag: vehicle_drag.Drag) -> JsonValues:
        """Takes the values from the drag of a wind estimate, which computes the intervals from its parameters."""
        return drag.as_dict()


class WindVelocity(Document):
    """The wind in m/s: its mean, its gusts and its course over time."""

    model: ModelField = ModelName.WIND
    """model that it was estimated by"""
    speed: Speed
    """speed of the mean wind"""
    speed_interval: list[Speed]
    """ends of the 90 % interval of speed"""
    mean_speed: Speed
    """mean of the speeds; where the wind turns, it is above speed"""
    mean_speed_interval: list[Speed]
    """ends of the 90 % interval of mean_speed"""
    direction: Degrees
    """where the wind comes from, clockwise from north"""
    direction_interval: Degrees
    """half width of the 90 % interval of direction"""
    gust: Speed
    """largest mean over gust_seconds"""
    gust_interval: list[Speed]
    """ends of the 90 % interval of gust"""
    gust_seconds: Seconds
    """time over which a gust is averaged"""
    turbulence_intensity: Number
    """standard deviation of the wind along its mean direction, over its speed"""
    time: list[Seconds]
    """stamps of velocity and band, on the boot clock"""
    velocity: list[list[Speed]]
    """north and east components of where the air moves to"""
    band: list[list[Speed]]
    """half widths of the 90 % band of velocity"""
    minutes: list[WindMinute]
    """mean wind of each of the equal parts of about a minute"""
    profile: list[WindLayer]
    """mean wind of layers of about 10 m"""
    drag: Drag
    """drag of the vehicle"""
    status: dict[str, str]
    """reported, biased or not identifiable, of speed, direction and drag"""
    reasons: dict[str, SentenceText]
    """why a figure is not reported, of speed, direction and drag"""
    advice: SentenceText | None
    """what to fly to know speed or direction better, and how well they would then be known"""
    boot: int
    """number of the vehicle's boot, from 0"""
    left_out: list[list[Seconds]]
    """start and end of each part left out since the attitude did not follow its setpoint, on the boot clock"""
    calm: bool
    """whether still air is likely as well"""

    @field_validator("time", "velocity", "band", mode="before")
    @classmethod
    def _rounded(cls, values: Array) -> Array:
        """Rounds the courses, (n,) s or (n, 2) m/s, to 0.1 ms and 0.1 mm/s, which makes the document much shorter."""
        return np.round(values, COURSE_DECIMALS)


class Wind(Judged, WindVelocity):
    """`--json` of wind."""

    identity: Identity
    """which vehicle it is"""
    parameters: dict[str, list[ParameterValue]]
    """drag parameters of the autopilot: value to set, and ends of its 90 % interval"""


def reported_wind(assessment: Assessment) -> WindEstimate | None:
    """Returns the wind of a flight without the figures that are not identifiable; None if there is no estimate."""
    return None if assessment.wind is None else assessment.wind.without_unidentified_speeds
