"""Models of the JSON documents of a learned model and its assessment: report.json of ``mavdem learn``."""

from __future__ import annotations

import numpy as np
from pydantic import field_validator, model_validator

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.containers import JsonValues
from mavdem.dem.settings import CompleteSettings
from mavdem.documents.document import (
    AdviceText,
    Document,
    Error,
    FactList,
    ModelField,
    SentenceAndFact,
    SentenceText,
    fact_field,
)
from mavdem.documents.vehicle import (
    Condition,
    Findings,
    Hover,
    Identity,
    Mixer,
    MotorHealth,
    Scale,
    Segment,
    Tier,
    Verdict,
)
from mavdem.documents.wind import WindVelocity, reported_wind
from mavdem.experiments import held_out
from mavdem.experiments.held_out import CONSTANT_MEAN, HOLD_LAST
from mavdem.facts.model import ModelName
from mavdem.units import (
    AngularAcceleration,
    Effectiveness,
    Hertz,
    InputValue,
    Nats,
    Number,
    OutputValue,
    PerMinute,
    PerSecond,
    Seconds,
    SquaredAngleOrRate,
    TorqueDensity,
    ValueInStatedUnit,
)


class Provenance(Document):
    """Where the training data come from."""

    source: str
    """the log"""
    system: int
    """MAVLink id"""
    component: int
    """MAVLink id"""
    vehicle: str
    """MAV_TYPE"""
    autopilot: str
    """MAV_AUTOPILOT"""
    axis: str
    """roll, pitch or yaw"""
    segment: Segment
    """the longest segment of settled flight"""
    messages: dict[str, str]
    """names of the messages of attitude and of motors"""
    rates: dict[str, Hertz]
    """rates of these messages"""
    dt: Seconds
    """sampling step"""
    resampling: dict[str, str]
    """how attitude and motors came onto one clock"""
    motors: Mixer
    """channels and places of the motors"""
    scale: Scale
    """range of the inputs"""
    setpoints: dict[str, str]
    """messages of the setpoints, by name"""
    repairs: list[SentenceText]
    """what was put right, one sentence each"""
    parameters: dict[str, float]
    """the autopilot's parameters of control and motors"""
    earlier: dict[str, float]
    """parameters that changed, with the value before"""
    cautions: list[SentenceText]
    """what makes a model less reliable"""


class SegmentSamples(Document):
    """A segment of settled flight that the model is trained on."""

    start: Seconds
    """on the boot clock"""
    samples: int
    """number of samples"""


class Matrices(Document):
    """The model Ẋ = A x + B (u − u₀) + d, y = C x + y₀, in units of inputs and outputs, and s."""

    A: list[list[float]]
    """(n, n)"""
    B: list[list[float]]
    """(n, r)"""
    C: list[list[float]]
    """(m, n)"""
    offset: list[float]
    """d (n,)"""
    input_trim: list[InputValue]
    """u₀ (r,)"""
    output_trim: list[OutputValue]
    """y₀ (m,)"""


class ModelErrors(Document):
    """Half widths of the 90 % intervals of A, B and C, by the simulation-error fit."""

    A: list[list[Number]]
    """(n, n)"""
    B: list[list[Number]]
    """(n, r)"""
    C: list[list[Number]]
    """(m, n)"""


class FreeEnergy(Document):
    """Free energy action F̄ of A, B and C."""

    model: ModelField = ModelName.DEM
    """model whose free energy it is"""
    start: Nats
    """F̄ of the first iteration"""
    end: Nats
    """F̄ of the last iteration"""
    gained: Nats
    """increase over all iterations"""
    terms: dict[str, Nats]
    """terms of F̄ of the last iteration, by name"""


class HeldOut(Document):
    """Errors of forecasts in held-out windows, which no model was trained on."""

    @model_validator(mode="before")
    @classmethod
    def _figures_of_windows(cls, windows: held_out.HeldOut) -> JsonValues:
        """Computes the values of this document's fields, before pydantic checks them.

        The error ratio of a forecast is its squared error, summed over the outputs in units of their training
        variances, divided by that of a trivial forecast. The trivial forecast is the constant mean of the training data
        or, for ``share_worse_than_hold_last``, the last sample before the window. Above 1 the model is of no use.

        Args:
            windows: W windows of measured outputs, each with its forecasts by name: by the model with and without the
                recorded motors, and the two trivial ones. No model was trained on them.

        Returns:
            Values by the names of the fields below. Lists by window have W entries.
        """
        # One ratio for each window, (W,), of the forecast that knows the recorded motors.
        error_ratios = windows.error_ratios()
        worse_shares = windows.worse_shares
        return {
            "model": windows.model,
            "windows": len(windows),
            "seconds": windows.seconds,
            "start": windows.time[:, 0],
            "rmse": {name: windows.rmse(name).tolist() for name in windows.forecasts},
            "error_ratio": {name: windows.error_ratio(name) for name in windows.forecasts},
            "error_ratios": error_ratios,
            "median_error_ratio": np.median(error_ratios),
            "error_ratio_quartiles": np.percentile(error_ratios, [25, 75]),
            "share_worse_than_constant_mean": worse_shares[CONSTANT_MEAN],
            "share_worse_than_hold_last": worse_shares[HOLD_LAST],
            "inside_90_percent_band": windows.coverage,
            "over_expected_error": windows.ratio_to_expected_error,
            "failures": windows.failures,
        }

    model: ModelField
    """model of the forecast; the prediction is by the joint VAR always"""
    windows: int
    """number of windows"""
    seconds: Seconds
    """length of a window"""
    start: list[Seconds]
    """start of each window, on the boot clock"""
    rmse: dict[str, list[OutputValue]]
    """root mean squared error of each output, by forecast"""
    error_ratio: dict[str, Number]
    """error ratio (NMSE), by forecast"""
    error_ratios: list[Number]
    """error ratio of the forecast, by window"""
    median_error_ratio: Number
    """median of error_ratios"""
    error_ratio_quartiles: list[Number]
    """quartiles of error_ratios"""
    share_worse_than_constant_mean: float
    """share of the windows whose forecast is worse than the constant mean"""
    share_worse_than_hold_last: float
    """share of the windows whose forecast is worse than the last sample held"""
    inside_90_percent_band: float
    """share of the samples inside the 90 % band"""
    over_expected_error: Number
    """squared error over the one to expect"""
    failures: list[SentenceAndFact]
    """why models of parts of the flight could not be learned, one sentence each"""


class Errors(Document):
    """Errors of one method, in the held-out windows."""

    per_output: list[SquaredAngleOrRate]
    """mean squared error of each output"""
    total: Number
    """sum over the outputs"""
    relative: Number
    """error ratio (NMSE), outputs in units of their variance"""


class Prediction(Document):
    """How far ahead predictions without the motors are useful."""

    model: ModelField = ModelName.JOINT_VAR
    """model that predicts"""
    half_explained_seconds: list[Seconds]
    """horizon up to which half of the variance is predicted, of each output"""
    error_ratio: Number
    """error ratio of predictions in held-out windows"""


class SimulationFit(Document):
    """Simulation-error fit of A, B and C."""

    model: ModelField = ModelName.DEM
    """model whose A, B and C are fitted"""
    samples: int
    """length of a simulation segment"""
    converged: bool
    """whether the fit converged"""
    numbers: float
    """effective sample size"""
    parameters: int
    """number of free parameters"""
    turning: list[float]
    """combination of motors that turns the axis"""
    terms: dict[str, Nats]
    """terms of F̄, by name"""


class Joint(Document):
    """The joint model of outputs and motors, which forecasts."""

    model: ModelField = ModelName.JOINT_VAR
    """model that the figures are of"""
    lags: int
    """number of samples from which the next one is predicted"""
    prior_precision: float
    """precision of the prior of its coefficients"""
    combinations: list[list[float]]
    """combinations of motors that are its inputs"""
    spectral_radius: float
    """largest magnitude of its eigenvalues; above 1 it is unstable"""
    free_energy: dict[str, Nats]
    """terms of F̄, by name"""


class PhysicalInterval(Document):
    """Half widths of the 90 % intervals of the physical parameters."""

    @field_validator("effect", mode="before")
    @classmethod
    def _none_if_not_identifiable(cls, effect: Array) -> Array | None:
        """Returns half widths of the effectiveness, (r,), or None if one of them is NaN."""
        return None if np.isnan(effect).any() else effect

    effect: list[Effectiveness] | None
    """half width of each motor's control effectiveness"""
    damping: PerSecond
    """half width of the rate damping"""
    lag: Seconds
    """half width of the motor time constant"""
    delay: Seconds
    """half width of the delay"""


class Physical(Document):
    """Physical parameters of the axis."""

    model: ModelField
    """model that they were estimated by"""
    effect: list[Effectiveness]
    """control effectiveness of each motor"""
    damping: PerSecond
    """rate damping"""
    lag: Seconds
    """motor time constant"""
    delay: Seconds
    """dead time of the motors' commands"""
    status: dict[str, str]
    """reported, biased or not identifiable, of effect, damping and lag"""
    reasons: dict[str, AdviceText]
    """why a parameter is not reported, of effect, damping and lag"""
    bias: float
    """likely relative error of the effect"""
    wind: AngularAcceleration
    """standard deviation of the angular acceleration that the motors do not cause"""
    wind_share: float
    """share of the wind in the variance of all torque"""
    refinements: dict[str, float]
    """parameters that predict unseen windows better"""
    interval_90_percent: PhysicalInterval
    """half widths of 90 % intervals; null of what is not identifiable"""
    windows: int
    """number of windows of the flight that were fitted together"""


class Gust(Document):
    """A gust: where the torque of the wind is far from its running level."""

    sample: int
    """first sample of the gust"""
    start: Seconds
    """after the first sample"""
    length: Seconds
    """duration of the gust"""
    size: AngularAcceleration
    """largest torque of the gust, with its sign"""


class Spectrum(Document):
    """Spectrum of the estimated wind torque and of its model."""

    frequency: list[Hertz]
    """frequencies of both densities"""
    density: list[TorqueDensity]
    """power spectral density of the estimate"""
    model: list[TorqueDensity]
    """power spectral density of the model"""


class WindTorque(Document):
    """Torque of the wind about the axis."""

    model: ModelField = ModelName.GRAY_BOX
    """model that it was estimated by"""
    mean: AngularAcceleration
    """steady part, if motors are equal and the load is centred"""
    mean_band: AngularAcceleration
    """half width of the 90 % interval of mean"""
    sd: AngularAcceleration
    """standard deviation of the wind torque"""
    scale_error: Number
    """relative standard deviation of the error of sd"""
    resolved: bool
    """whether its course is larger than its errors"""
    reason: SentenceAndFact | None
    """why the wind torque is not reported"""
    gust_threshold: AngularAcceleration
    """distance from the running level beyond which it is a gust"""
    false_gusts_per_minute: PerMinute
    """gusts a minute that turbulence shows by chance"""
    gusts: list[Gust]
    """in order of time"""
    spectrum: Spectrum
    """spectrum of the estimate and of its model"""
    explained_by_mean_wind: Number = None
    """share of its variance that the wind in m/s explains"""


class AxisFigures(Document):
    """Physical parameters and wind torque of one axis."""

    physical: Physical | None
    """physical parameters of the axis"""
    wind: WindTorque | None
    """torque of the wind about the axis"""
    reason: SentenceAndFact
    """why there are no physical parameters"""


class TrueParameter(Document):
    """An estimated parameter beside its true value in the simulator."""

    name: str
    """name of the parameter; lag of the motors: motor time constant"""
    unit: str
    """unit of estimate, half_width and truth"""
    estimate: ValueInStatedUnit
    """estimate of the flight"""
    half_width: ValueInStatedUnit
    """half width of its 90 % interval"""
    truth: ValueInStatedUnit
    """value in the simulator"""
    status: SentenceText
    """reported, biased or not identifiable"""
    inside: bool | None
    """whether the interval holds the truth"""


class TrueWind(Document):
    """The wind torque beside its truth."""

    correlation: Number
    """correlation of the estimate with the truth"""
    sd: AngularAcceleration
    """standard deviation of the estimate"""
    true_sd: AngularAcceleration
    """standard deviation of the truth"""
    inside: float
    """share of the samples whose truth is in the 90 % band"""
    resolved: bool
    """whether the estimate is larger than its errors"""
    mean: TrueParameter
    """steady part beside its truth"""


class Truth(Document):
    """Estimates beside the truth of a simulated flight, with --truth."""

    source: str
    """name of the truth file"""
    parameters: list[TrueParameter]
    """parameters beside their truth"""
    wind: TrueWind | None
    """the wind torque beside its truth"""


class LearnedFigures(Document, is_partial=True):
    """Figures of a learned model; their keys are absent without one."""

    flight: Provenance
    """where the training data come from; keys in italics are there with a model only, but for error"""
    segments: list[SegmentSamples]
    """segments of settled flight that the model is trained on"""
    inputs: list[str]
    """names of the inputs"""
    outputs: list[str]
    """names of the outputs"""
    dt: Seconds = None
    """sampling step"""
    training_samples: int
    """number of training samples"""
    forecast_samples: int
    """samples of a held-out window"""
    order: int
    """number of states"""
    converged: bool
    """whether the last fit converged"""
    model: Matrices
    """ẋ = A x + B (u − u₀) + d, y = C x + y₀, in units of inputs and outputs, and s"""
    model_interval_90_percent: ModelErrors
    """half widths of 90 % intervals, by the simulation-error fit"""
    spectral_abscissa: PerSecond = None
    """largest real part of the poles of A"""
    free_energy: FreeEnergy
    """free energy action F̄ of A, B and C"""
    held_out: HeldOut
    """forecasts of windows that no model has seen"""
    forecast_mspe: dict[str, Errors]
    """errors in the held-out windows, by method, the lowest first"""
    forecast_over_constant_mean: Number = None
    """error ratio (NMSE) of the forecast in held-out windows"""
    expected_error: Number = None
    """squared error to expect of the forecast, over the variance of the training data"""
    inside_90_percent_band: float
    """share of the held-out samples inside the 90 % band"""
    prediction: Prediction
    """how far ahead predictions without the motors are useful"""
    simulation_fit: SimulationFit
    """simulation-error fit of A, B and C"""
    joint: Joint
    """the joint model of outputs and motors, which forecasts"""
    physical: Physical
    """physical parameters of the axis"""
    wind: WindTorque
    """torque of the wind about the axis"""
    cautions: list[AdviceText]
    """limits of the model, one sentence each"""
    cautions_facts: FactList = fact_field("cautions", "cautions as facts")


class Report(LearnedFigures, Tier, MotorHealth, Findings):
    """All results of one vehicle and axis."""

    axes: dict[str, AxisFigures]
    """with --axis all: roll, pitch and yaw"""
    hover: Hover | None
    """what each motor does in settled flight"""
    reason: SentenceAndFact
    """why there is no full model; empty where there is one"""
    remedy: SentenceText
    """what to change to get a full model"""
    condition: Condition
    """figures of the vehicle that any rate shows"""
    identity: Identity
    """which vehicle it is"""
    truth: Truth | None
    """estimates beside the truth of a simulated flight, with --truth"""
    settings: CompleteSettings | None
    """all settings of the fit; docs/engine.md"""
    verdict: Verdict
    """whether a full model can be learned"""
    wind_velocity: WindVelocity | None
    """wind in m/s"""
    seconds: Seconds
    """time that the analysis took"""
    files: dict[str, str]
    """the files written, by name"""
    error: Error | None = None
    """why there is no model"""


class LearnReport(Report):
    """The document report.json of learn, and `--json` of learn and open."""

    source: str
    """the log"""


def report_document(assessment: Assessment) -> JsonValues:
    """Returns the values of the document ``Report``: the model of the first analysed axis, and the flight's judgement.

    The wind torque is the angular acceleration that the motors do not explain. If the wind in m/s is known too, its
    gusts explain a share of the torque, which is then among the values of the wind torque (key "wind").

    Args:
        assessment: assessment of one vehicle, with an analysis.

    Returns:
        Values by key. The caller replaces two of them: ``seconds``, the time that the analysis took, is None, and
        ``files``, the names of the written files, is empty.
    """
    assert assessment.analysis is not None
    report = assessment.analysis.report_values
    explained_share = assessment.wind_share_of_torque
    if explained_share is not None:
        report["wind"] = WindTorque.from_results(
            report["wind"], explained_by_mean_wind=explained_share.figures["share"]
        )
    return {
        **report,
        **assessment.judgement_values,
        "wind_velocity": reported_wind(assessment),
        "seconds": None,
        "files": {},
    }
