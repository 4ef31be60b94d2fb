"""A made-up analysis of a log, with figures that no fit decides, as reports and findings read it."""

import numpy as np
from frames import geometry
from numpy.random import default_rng
from partial_records import partial_record
from refusals import prose

from mavdem.assessment import Assessment
from mavdem.assessment.axis.figures import LogAnalysis
from mavdem.assessment.condition import Condition
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.assessment.tier import Tier
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.evaluate import HeldOut
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.model import ModelName
from mavdem.facts.vibration import VibrationLight
from mavdem.ingest import Log
from mavdem.motors.hover import HoverFigures
from mavdem.plant import DetectedGust, Physical, WindTorque
from mavdem.plant.parameters import PhysicalInterval

MOTORS = geometry().names
NAN = float("nan")


def physical(share=None, **status):
    """Physical parameters of which these are not reported; half widths of intervals are a ``share``, if given."""
    effect = np.array([-0.0684, 0.0698, 0.0686, -0.0693])
    damping = 1.9
    lag = 0.0177
    half_widths = PhysicalInterval(np.full(4, 0.0037), damping=0.54, lag=0.0018, delay=0.004)
    half_width_of_mean = 0.003
    if share is not None:
        half_widths = PhysicalInterval(share * abs(effect), share * damping, share * lag, 0.004)
        half_width_of_mean = 0.069 * share
    for name, value in status.items():
        if value == Status.NOT_IDENTIFIABLE:
            unknown = {name: NAN * getattr(half_widths, name)}
            half_widths = half_widths._replace(**unknown)
    names = ("effect", "damping", "lag")
    return partial_record(
        Physical,
        effect=effect,
        damping=damping,
        lag=lag,
        delay=0.003,
        status={name: status.get(name, Status.REPORTED) for name in names},
        reasons={name: prose(f"Why {name}.") if name in status else None for name in names},
        wind_share=0.07,
        model=ModelName.GRAY_BOX,
        interval=lambda self, level=None: half_widths,
        mean_effect=lambda self, level=None: (0.069, half_width_of_mean),
    )


def model(parameters, **wind):
    """A learned model as reports read it, with other figures of the ``wind``."""
    rng = default_rng(0)
    record = Record(
        inputs=rng.normal(size=(900, 4)),
        outputs=rng.normal(size=(900, 2)),
        begins=(76.0,),
        lengths=(900,),
        dt=0.01,
        effect_directions=np.array([-1.0, 1.0, 1.0, -1.0]),
        input_names=MOTORS,
        output_names=("roll", "roll rate"),
        input_units=("µs",) * 4,
        output_units=("rad", "rad/s"),
    )
    wind_figures = {
        "torque": np.zeros(900),
        "band": np.ones(900),
        "spectrum": None,
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
    return partial_record(
        Learned,
        record=record,
        physical=parameters,
        physical_reason=None,
        stable=True,
        wind_torque=WindTorque(**(wind_figures | wind)),
        one_step=lambda self: np.zeros((900, 2)),
        dt=0.01,
    )


def held_out(
    forecast=0.1,
    last=0.5,
    band=1.0,
    expected=0.01,
    count=40,
):
    """Returns held-out windows in which forecast, last sample and mean have constant errors; that of the mean is 1."""
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


def measured_vibration(level):
    """The light of an IMU that vibrates by 40 m/s², of which 30 are acceptable."""
    return Fact(
        VibrationLight.VIBRATION_MEASURED,
        level,
        subject="IMU 1",
        vibration=40.0,
        acceptable_vibration=30.0,
        axis="",
        clips=0,
        is_settled=True,
    )


def analysis(parameters):
    """Returns the analysis of a log with a learned model that has these physical parameters."""
    learned = model(parameters)
    windows = held_out()
    learnability = partial_record(
        Learnability, figures=QualityFigures(consistency=0.99), learnable=True
    )
    condition = Condition(60.0, hover=HOVER)
    return LogAnalysis(
        learnability,
        partial_record(Tier, tier="a"),
        condition,
        None,
        learned=learned,
        held_out=windows,
        motors_are_watched=True,
    )


def assessment(parameters, **lights):
    """Returns an assessment with the model of :func:`analysis` whose lights are good, except those that are given."""
    facts_by_light = {
        str(light): prose(f"The {light}.").replace(Level.GOOD) for light in Light
    } | lights
    headline = Fact(Headline.NOTHING_WRONG, Level.GOOD, names=VEHICLE_LIGHTS, missing=())
    judgement = Judgement(headline, Fact(NextStep.KEEP_MODEL), facts_by_light)
    log = Log("flight.tlog", (), (), (), 0, 0, (NAN, NAN))
    return Assessment(log, judgement, analyses={"roll": analysis(parameters)})
