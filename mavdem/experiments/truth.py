"""Truth: physical parameters and wind torque of a simulated flight, beside what was learned of it."""

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES
from mavdem.dem import Learned
from mavdem.errors import Unreadable, error_message
from mavdem.facts.forecasts import ComparedWithTruth, Forecasts
from mavdem.facts.identifiability import Status
from mavdem.files import PathName
from mavdem.flight import Flight
from mavdem.plant import Physical, WindTorque

MAX_DIFFERENCE = 0.3
"""Root mean square over standard deviation, of the rate from that of the truth file: 0.01 in simulated flights of
100 Hz, and 1.4 for another flight's."""


class ComparedParameter(NamedTuple):
    """An estimate beside its truth, both in ``unit``; ``half_width`` is NaN where it is not identifiable."""

    name: str
    unit: str
    estimate: float
    half_width: float
    truth: float
    status: Status = Status.REPORTED

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; ``None`` where there is none."""
        if isnan(self.half_width):
            return None
        return bool(abs(self.estimate - self.truth) <= self.half_width)


class ComparedWind(NamedTuple):
    """The wind torque beside its truth, rad/s²: ``inside`` is the share of samples whose truth is in the 90 % band.

    ``resolved``: whether the estimate is larger than its expected errors. ``mean`` is the steady part.
    """

    correlation: float
    sd: float
    true_sd: float
    inside: float
    resolved: bool
    mean: ComparedParameter


class TruthComparison(NamedTuple):
    """Physical parameters and wind beside their truth, each empty or ``None`` where there is no estimate."""

    source: str
    parameters: tuple[ComparedParameter, ...]
    wind: ComparedWind | None


class Truth(NamedTuple):
    """One axis of a truth file of ``mavdem fly``: N rows, r motors."""

    source: str  # the file's name
    time: Array  # (N,) s on the boot clock
    rate: Array  # (N,) rad/s, as the autopilot knew it
    disturbance: Array  # (N,) rad/s²
    weak: Array  # (N,) 1 once something broke
    effect: Array  # (r,) rad/s² per µs
    weak_effect: Array  # (r,) once something broke
    damping: float  # 1/s
    lag: float  # s
    delay: float  # s


def read_truth(path: PathName, axis: str) -> Truth:
    """Returns one ``axis`` of a truth file of ``mavdem fly``.

    Raises:
        Unreadable: ``path`` is not one, or cannot be read.
    """
    name = Path(path).name or str(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            effect = file[f"{axis}_effect"]
            truth = Truth(
                name,
                time=file["time"],
                rate=file["known_rates"][:, AXES.index(axis)],
                disturbance=file[f"{axis}_disturbance"],
                weak=file["weak"],
                effect=effect,
                weak_effect=file.get(f"{axis}_effect_weak", effect),
                damping=-float(file[f"{axis}_A"][-1, -1]),
                lag=float(file["lag"][0]),
                delay=float(file["delay"]),
            )
        for column in (truth.rate, truth.disturbance, truth.weak):
            np.interp(0.0, truth.time, column)  # which takes as many as there are times
        np.stack([truth.effect, truth.weak_effect])
        return truth
    except OSError as error:
        why = error_message(error)
    except (LookupError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        why = ""
    raise Unreadable(Forecasts.NO_TRUTH_FILE, name=name, error=why)


def truth_of(flights: Sequence[Flight], path: PathName) -> Truth:
    """Returns what the truth file at ``path`` says of the axis of ``flights``, the segments of one.

    Raises:
        Unreadable: the file is no truth file, or that of another flight.
        ValueError: no output is the rate of an axis.
    """
    name = flights[0].output_names[-1]
    axis = name.split(" ")[0]
    if axis not in AXES:
        raise ValueError(f"the last output must be the rate of roll, pitch or yaw, not {name}")
    truth = read_truth(path, axis)
    for segment in flights:
        time = segment.time
        rate = segment.outputs[:, -1]
        rates = np.interp(time, truth.time, truth.rate, np.nan, np.nan)
        difference = np.sqrt(np.mean((rate - rates) ** 2)) / rate.std()
        if not difference < MAX_DIFFERENCE:
            raise Unreadable(
                Forecasts.TRUTH_OF_ANOTHER_FLIGHT,
                time=time[0],
                until=time[-1],
                subject=name,
                name=truth.source,
            )
    return truth


def compare_with_truth(
    learned: Learned, flights: Sequence[Flight], truth: Truth
) -> TruthComparison:
    """Returns the physical parameters and the wind torque of ``learned`` beside the ``truth`` of its ``flights``.

    Raises:
        ValueError: ``flights`` are not what ``learned`` was trained on.
    """
    if sum(map(len, flights)) != len(learned.record):
        raise ValueError("flights must be what the model was trained on")
    time = np.concatenate([segment.time for segment in flights])
    parameters = (
        ()
        if learned.physical is None
        else tuple(_parameters(learned.physical, flights[0], truth, time))
    )
    wind = None if learned.wind_torque is None else _wind(learned.wind_torque, truth, time)
    return TruthComparison(truth.source, parameters, wind)


def _parameters(
    physical: Physical, flight: Flight, truth: Truth, time: Array
) -> Iterator[ComparedParameter]:
    effect, *halves = physical.interval()
    status = physical.status
    if flight.input_units == ("µs",) * truth.effect.size:
        weak = np.interp(time, truth.time, truth.weak) >= 0.5
        true = truth.weak_effect if weak.mean() >= 0.5 else truth.effect
        names = [
            f"{ComparedWithTruth.EFFECT_OF} {name.split(' (')[0]}" for name in flight.input_names
        ]
        rows = [*zip(names, physical.effect.tolist(), effect.tolist(), true.tolist(), strict=True)]
        rows.append(
            (ComparedWithTruth.MEAN_EFFECT, *physical.mean_effect(), float(abs(true).mean()))
        )
        for name, estimate, half, true_value in rows:
            yield ComparedParameter(
                name, "rad/s² per µs", estimate, half, true_value, status["effect"]
            )
    for (name, unit, key), half in zip(PLANT, halves, strict=True):
        state = status.get(key, status["lag"])
        yield ComparedParameter(
            name, unit, getattr(physical, key), half, getattr(truth, key), state
        )


PLANT = (
    (ComparedWithTruth.DAMPING, "1/s", "damping"),
    (ComparedWithTruth.LAG_OF_THE_MOTORS, "s", "lag"),
    (ComparedWithTruth.DELAY, "s", "delay"),
)
"""Names, units and attributes of what the rotation is made of."""


def _wind(wind: WindTorque, truth: Truth, time: Array) -> ComparedWind:
    true = np.interp(time, truth.time, truth.disturbance)
    mean = float(true.mean())
    moves = true.std() and wind.torque.std()
    return ComparedWind(
        correlation=float(np.corrcoef(wind.torque, true)[0, 1]) if moves else nan,
        sd=wind.sd,
        true_sd=float(true.std()),
        inside=float(np.mean(abs(wind.torque - true) <= wind.band)),
        resolved=wind.resolved,
        mean=ComparedParameter(
            ComparedWithTruth.STEADY_PART, "rad/s²", wind.mean, wind.mean_band, mean
        ),
    )
