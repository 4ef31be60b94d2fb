"""Models of the JSON documents of ``mavdem compare`` and ``mavdem order``: methods and model orders compared."""

from __future__ import annotations

from pydantic import Field

from mavdem.documents.document import Document, SentenceAndFact, SentenceText
from mavdem.units import Nats, Number, Seconds, SquaredOutput


class Paired(Document):
    """Paired test of the first method with another one, by the errors of the same windows."""

    ratio: Number
    """median over pairs of the first method's error over the other's: not the quotient of two `relative`"""
    less: int
    """number of pairs, windows or flights, in which the first method's error is lower"""
    windows: int
    """number of all pairs"""
    tested: int
    """number of pairs that do not overlap, which the test uses"""
    tested_less: int
    """number of these in which the first method's error is lower"""
    p_value: Number
    """two-sided p-value of Wilcoxon's paired signed-rank test on the logarithms of the error ratios"""
    verdict: SentenceText = Field(validation_alias="result")
    """lower, higher or not distinguishable"""


class OverFlights(Document):
    """One method over all flights."""

    method: str
    """name of the method"""
    flights: int
    """number of flights"""
    relative: Number
    """geometric mean of the flights' error ratios"""
    horizon_seconds: list[Seconds]
    """horizons that all flights have; the last is the whole test part"""
    horizons: list[Number]
    """the same by horizon"""
    horizons_mspe: list[list[SquaredOutput]]
    """mean squared error of each output by horizon, mean over flights"""
    horizons_worse: list[int]
    """number of windows worse than the constant mean, by horizon"""
    inside: list[Number]
    """share inside the 90 % band, by horizon"""
    windows: int
    """number of windows"""
    failed: int
    """number of windows without a forecast"""
    diverged: int
    """number of windows whose forecast is infinite or NaN"""
    unstable: int
    """number of models with a growing mode"""
    worse_than_constant: int
    """number of windows worse than the constant mean"""
    mspe_total: Number
    """mean squared error, summed over flights and outputs"""
    reference: Paired
    """paired test of the first method with this one, a pair a flight"""


class Horizon(Document):
    """One method over all windows of a flight, up to one horizon of its forecasts."""

    steps: int
    """horizon in steps"""
    seconds: Seconds
    """horizon"""
    relative: Number
    """median error ratio"""
    mspe: list[SquaredOutput]
    """mean squared error of each output, mean over windows"""
    worse_than_constant: int
    """number of windows worse than the constant mean"""
    reference: Paired
    """paired test of the first method with this one"""
    inside: Number
    """mean share inside the 90 % band"""


class Standing(Document):
    """One method over all windows of a flight."""

    method: str
    """name of the method"""
    windows: int
    """number of windows"""
    failed: int
    """number of windows without a forecast"""
    failure: SentenceText
    """reason of the first of these"""
    diverged: int
    """number of windows whose forecast is infinite or NaN"""
    unstable: int
    """number of models with a growing mode"""
    mspe: list[SquaredOutput]
    """mean squared error of each output, mean over windows"""
    mspe_total: Number
    """sum over the outputs"""
    relative: Number
    """median error ratio"""
    worst: Number
    """largest error ratio"""
    worse_than_constant: int
    """number of windows worse than the constant mean"""
    horizons: list[Horizon]
    """each horizon; the last is the whole test part"""
    seconds: Seconds
    """processor time for a window"""


class Mspe(Document):
    """Mean squared errors over the whole test part of a window."""

    per_output: list[SquaredOutput]
    """mean squared error of each output"""
    total: Number
    """sum over the outputs"""


class Outcome(Document):
    """One method in one window."""

    failure: SentenceAndFact
    """why there is no forecast; empty where there is one"""
    stable: bool | None
    """whether the model has no growing mode"""
    cautions: list[SentenceText]
    """limits of the model"""
    mspe: Mspe
    """errors over the whole test part"""
    relative: list[Number]
    """error ratio (NMSE), by horizon"""
    inside_90_percent_band: list[Number]
    """share inside the 90 % band, by horizon"""
    seconds: Seconds
    """processor time"""


class ComparedWindow(Document):
    """One window of a flight, with the outcome of each method."""

    start: int
    """first sample of the window"""
    time: Seconds
    """time of the first sample"""
    methods: dict[str, Outcome]
    """each method, by name"""


class ComparedFlight(Document):
    """One flight, with the outcomes of all methods."""

    flight: str
    """name of the flight"""
    dt: Seconds
    """sampling step"""
    outputs: list[str]
    """names of the outputs"""
    output_units: list[str]
    """units of the outputs"""
    training_samples: int
    """training samples of a window"""
    forecast_samples: int
    """test samples of a window"""
    standings: list[Standing]
    """each method, the lowest error first"""
    windows: list[ComparedWindow]
    """each window"""


class Comparison(Document):
    """Methods compared by their forecasts of held-out windows."""

    reference: str
    """the first method, with which the others are compared"""
    methods: list[str]
    """names of all methods"""
    start: str
    """where forecasts start: data or zero"""
    verdicts: dict[str, Paired]
    """paired test of the first method with each other one, over the whole test part"""
    over_flights: list[OverFlights]
    """each method over all flights, the lowest error first"""
    flights: list[ComparedFlight]
    """each flight"""
    predictions: Comparison | None
    """the same without the inputs of the time ahead"""


class CompareReport(Comparison):
    """`--json` of compare."""

    axis: str
    """roll or pitch"""
    sources: dict[str, str]
    """logs by the flight's name"""
    seconds: Seconds
    """time that it took"""
    planned_windows: int
    """number of windows to compare; a run that was stopped has fewer"""
    left_out: dict[str, SentenceText]
    """why a log is not compared, by its path"""


class Order(Document):
    """`--json` of order."""

    orders: list[int]
    """numbers of states that were tried"""
    free_energy: list[list[Nats]]
    """F̄ by flight and order"""
    mean: list[Nats]
    """mean of F̄ over the flights"""
    spread: list[Nats]
    """standard deviation of F̄ over the flights"""
    chosen: int
    """the order that F̄ chooses"""
    saturated: bool
    """whether a higher order was tried"""
    reason: SentenceText
    """why this order"""
    remarks: list[SentenceText]
    """why orders are missing"""
    width: list[Seconds]
    """width of the kernel that filters each flight"""
    samples: list[float]
    """effective sample size of each flight"""
    flights: list[str]
    """names of the flights"""
    axis: str
    """roll or pitch"""
    known_inputs: bool
    """false with --unknown-inputs"""
    seconds: Seconds
    """time that it took"""
    advice: SentenceText
    """what to do with the order"""
