"""Truth: physical parameters and wind torque of a simulated flight, beside what was learned of it."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from math import isnan
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.identifiability import Status
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts
from mavdem.flight import Flight

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
    status: Status = "reported"

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; ``None`` where there is none."""
        return (
            None
            if isnan(self.half_width)
            else bool(abs(self.estimate - self.truth) <= self.half_width)
        )

    def as_dict(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        half = None if isnan(self.half_width) else self.half_width
        return self._asdict() | {"half_width": half, "inside": self.inside}


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

    def as_dict(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        wind = (
            None if self.wind is None else self.wind._asdict() | {"mean": self.wind.mean.as_dict()}
        )
        return {
            "source": self.source,
            "parameters": [one.as_dict() for one in self.parameters],
            "wind": wind,
        }


def read_truth(path: str | PathLike[str], axis: str) -> dict[str, Any]:
    """Returns one ``axis`` of a truth file of ``mavdem fly``, and its name as ``source``; N rows, r motors.

    ``time`` (N,) on the boot clock; ``rate`` (N,) as the autopilot knew it; ``disturbance`` (N,), rad/s²;
    ``effect`` (r,), rad/s² per µs, and once something broke, ``weak`` (N,), ``weak_effect``; ``damping``, ``lag`` and
    ``delay``, 1/s, s, s.

    Raises:
        Unreadable: ``path`` is not one, or cannot be read.
    """
    name = Path(fspath(path)).name or fspath(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            parts = {
                **{name: file[name] for name in ("time", "weak", "delay")},
                **{name: file[f"{axis}_{name}"] for name in ("disturbance", "effect")},
                "rate": file["known_rates"][:, AXES.index(axis)],
                "weak_effect": file[
                    f"{axis}_effect{'_weak' if f'{axis}_effect_weak' in file else ''}"
                ],
                "damping": -file[f"{axis}_A"][-1, -1],
                "lag": file["lag"][0],
            }
            columns = {key: np.asarray(value, np.float64) for key, value in parts.items()}
    except OSError as error:
        why = error.strerror or str(error)
        raise Unreadable(Fact(Forecasts.NO_TRUTH_FILE, name=name, error=why)) from None
    except (
        KeyError,
        IndexError,
        TypeError,
        ValueError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
    ):
        raise Unreadable(Fact(Forecasts.NO_TRUTH_FILE, name=name, error="")) from None
    rows = len(np.atleast_1d(columns["time"]))
    motors = columns["effect"].size
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(
        ("time", "rate", "disturbance", "weak"), (rows,)
    )
    shapes |= dict.fromkeys(("effect", "weak_effect"), (motors,)) | dict.fromkeys(
        ("damping", "lag", "delay"), ()
    )
    sound = all(
        columns[key].shape == shape and np.isfinite(columns[key]).all()
        for key, shape in shapes.items()
    )
    if not (sound and rows > 1 and (np.diff(columns["time"]) > 0).all()):
        raise Unreadable(Fact(Forecasts.TRUTH_DAMAGED, name=name))
    return {"source": name, **columns}


def truth_of(flights: Sequence[Flight], path: str | PathLike[str]) -> dict[str, Any]:
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
        if (
            not _difference(segment.outputs[:, -1], truth, truth["rate"], segment.time)
            < MAX_DIFFERENCE
        ):
            raise Unreadable(
                Fact(
                    Forecasts.TRUTH_OF_ANOTHER_FLIGHT,
                    time=segment.time[0],
                    until=segment.time[-1],
                    subject=name,
                    name=truth["source"],
                )
            )
    return truth


def compare_with_truth(
    learned: Learned, flights: Sequence[Flight], truth: dict[str, Any]
) -> TruthComparison:
    """Returns the physical parameters and the wind torque of ``learned`` beside the ``truth`` of its ``flights``.

    Raises:
        ValueError: ``flights`` are not what ``learned`` was trained on.
    """
    if sum(map(len, flights)) != len(learned.record):
        raise ValueError("flights must be what the model was trained on")
    time = np.concatenate([segment.time for segment in flights])
    parameters = (
        () if learned.physical is None else _parameters(learned.physical, flights, truth, time)
    )
    wind = None if learned.wind_torque is None else _wind(learned.wind_torque, truth, time)
    return TruthComparison(truth["source"], parameters, wind)


def _difference(measured: Array, truth: dict[str, Any], column: Array, time: Array) -> float:
    """Root mean square difference over the measured standard deviation; infinite where no truth is known."""
    stamps = truth["time"]
    if time[0] < stamps[0] or time[-1] > stamps[-1]:
        return float("inf")
    difference = measured - np.interp(time, stamps, column)
    return float(np.sqrt(np.mean(difference**2)) / measured.std())


def _parameters(
    physical: Physical, segments: Sequence[Flight], truth: dict[str, Any], time: Array
) -> tuple[ComparedParameter, ...]:
    effect, *halves = physical.interval(LEVEL)
    status = physical.status
    parameters = list[ComparedParameter]()
    if segments[0].input_units == ("µs",) * truth["effect"].size:
        weak = np.interp(time, truth["time"], truth["weak"]) >= 0.5
        true = truth["weak_effect" if weak.mean() >= 0.5 else "effect"]
        unit = "rad/s² per µs"
        state = status["effect"]
        motors = zip(
            segments[0].input_names,
            physical.effect.tolist(),
            effect.tolist(),
            true.tolist(),
            strict=True,
        )
        parameters = [
            ComparedParameter(f"effect of {name.split(' (')[0]}", unit, value, half, known, state)
            for name, value, half, known in motors
        ]
        mean = float(np.abs(true).mean())
        parameters.append(
            ComparedParameter("mean effect", unit, *physical.mean_effect(LEVEL), mean, state)
        )
    others = (
        ("damping", "1/s", "damping"),
        ("lag of the motors", "s", "lag"),
        ("delay", "s", "delay"),
    )
    for (name, unit, key), half in zip(others, halves, strict=True):
        state = status.get(key, status["lag"])
        parameters.append(
            ComparedParameter(name, unit, getattr(physical, key), half, float(truth[key]), state)
        )
    return tuple(parameters)


def _wind(wind: WindTorque, truth: dict[str, Any], time: Array) -> ComparedWind:
    true = np.interp(time, truth["time"], truth["disturbance"])
    still = not (true.std() and wind.torque.std())
    return ComparedWind(
        correlation=float("nan") if still else float(np.corrcoef(wind.torque, true)[0, 1]),
        sd=wind.sd,
        true_sd=float(true.std()),
        inside=float(np.mean(np.abs(wind.torque - true) <= wind.band)),
        resolved=wind.resolved,
        mean=ComparedParameter(
            "steady part", "rad/s²", wind.mean, wind.mean_band, float(true.mean())
        ),
    )
