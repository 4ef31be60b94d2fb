"""A made-up analysis of a log, with figures that no fit decides, as reports and findings read it."""

from types import SimpleNamespace

import numpy as np
from frames import geometry
from numpy.random import default_rng
from refusals import prose

from mavdem.assessment import Assessment
from mavdem.assessment.axis.figures import LogAnalysis
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.evaluate import HeldOut
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.ingest import Log
from mavdem.motors.hover import HoverFigures
from mavdem.plant import DetectedGust

MOTORS = geometry().names
NAN = float("nan")


class Parameters(SimpleNamespace):
    """Physical parameters as they are read by reports."""

    def interval(self, level=None):
        return self.half

    def mean_effect(self, level=None):
        return self.mean

    @property
    def identifiable(self):
        return self.status["effect"] != Status.NOT_IDENTIFIABLE


class Halves(SimpleNamespace):
    def __iter__(self):
        return iter((self.effect, self.damping, self.lag, self.delay))


def physical(share=None, **status):
    """Physical parameters of which these are not reported; half widths of intervals are a ``share``, if given."""
    effect = np.array([-0.0684, 0.0698, 0.0686, -0.0693])
    damping = 1.9
    lag = 0.0177
    half = Halves(effect=np.full(4, 0.0037), damping=0.54, lag=0.0018, delay=0.004)
    if share is not None:
        half = Halves(
            effect=share * abs(effect), damping=share * damping, lag=share * lag, delay=0.004
        )
    for name, value in status.items():
        if value == Status.NOT_IDENTIFIABLE:
            setattr(half, name, NAN * getattr(half, name))
    names = ("effect", "damping", "lag")
    return Parameters(
        effect=effect,
        damping=damping,
        lag=lag,
        delay=0.003,
        half=half,
        mean=(0.069, 0.003 if share is None else 0.069 * share),
        status={name: status.get(name, Status.REPORTED) for name in names},
        reasons={name: prose(f"Why {name}.") if name in status else None for name in names},
        wind_share=0.07,
    )


def model(parameters, **wind):
    """A learned model as reports read it, with other figures of the ``wind``."""
    rng = default_rng(0)
    record = SimpleNamespace(
        inputs=rng.normal(size=(900, 4)),
        outputs=rng.normal(size=(900, 2)),
        segment_starts=np.zeros(1, dtype=int),
        begins=(76.0,),
        lengths=(900,),
        dt=0.01,
        effect_directions=np.array([-1.0, 1.0, 1.0, -1.0]),
        input_names=MOTORS,
        output_names=("roll", "roll rate"),
        input_units=("µs",) * 4,
        output_units=("rad", "rad/s"),
    )
    known = {
        "sd": 0.977,
        "mean": -1.71,
        "mean_band": 0.07,
        "scale_error": 0.03,
        "reason": None,
        "resolved": True,
        "step": None,
        "gusts": (DetectedGust(120, 1.2, 0.4, -9.0),),
        "gust_threshold": 3.28,
        "false_gusts_per_minute": 0.1,
    }
    return SimpleNamespace(
        record=record,
        physical=parameters,
        physical_reason=None,
        stable=True,
        wind_torque=SimpleNamespace(**(known | wind)),
        one_step=lambda: np.zeros((900, 2)),
        dt=0.01,
    )


def held_out(
    forecast=0.1,
    last=0.5,
    band=1.0,
    expected=0.01,
    count=40,
):
    """Windows in which the forecast and the last sample err by so much, and the mean by 1."""
    measured = np.zeros((count, 10, 2))
    errors = {"forecast": forecast, "prediction": 0.9, "constant mean": 1.0, "hold last": last}
    forecasts = {name: measured + error for name, error in errors.items()}
    time = np.arange(10.0 * count).reshape(count, 10) / 10
    return HeldOut(time, measured, forecasts, measured + band, measured + expected, np.ones(2))


HOVER = HoverFigures(
    MOTORS,
    "µs",
    55.0,
    trim=(1699.0, 1710.0, 1711.0, 1698.0),
    trim_of_range=(0.699, 0.71, 0.711, 0.698),
    trim_share=(0.992, 1.008, 1.01, 0.99),
    headroom=(0.14, 0.13, 0.13, 0.12),
    at_upper_limit=(0.0, 0.0, 0.001, 0.0),
    at_lower_limit=(0.0,) * 4,
    roll=8.0,
    pitch=0.6,
)


def analysis(parameters):
    learned = model(parameters)
    windows = held_out()
    learnability = SimpleNamespace(figures=SimpleNamespace(consistency=0.99), learnable=True)
    condition = SimpleNamespace(hover=HOVER, oscillation=None)
    return LogAnalysis(
        learnability,
        SimpleNamespace(tier="a"),
        condition,
        None,
        learned=learned,
        held_out=windows,
        motors_are_watched=True,
    )


def assessment(parameters, **lights):
    """An assessment of the :func:`analysis` whose lights are good, but for these."""
    known = {str(light): prose(f"The {light}.").but(Level.GOOD) for light in Light} | lights
    headline = Fact(Headline.NOTHING_WRONG, Level.GOOD, names=VEHICLE_LIGHTS, missing=())
    judgement = Judgement(headline, Fact(NextStep.KEEP_MODEL), known)
    log = Log("flight.tlog", (), (), (), 0, 0, (NAN, NAN))
    return Assessment(log, judgement, analyses={"roll": analysis(parameters)})
