"""Truth beside estimates: what a simulated flight's own file says of the vehicle and the wind.

The file is that of ``mavdem fly`` (``sitl_scenarios/truth.py``). It belongs to a flight if both have the same rate at
the same stamps: the file holds what the autopilot knew, noise and delay included.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from math import isnan
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.drive import AXES
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.identifiability import Status
from mavdem.errors import Unreadable
from mavdem.flight import Flight

MAX_DIFFERENCE = 0.3
"""Of the rate from that of the truth file, root mean square over the rate's standard deviation: 0.01 in simulated
flights of 100 Hz, and 1.4 for another flight's."""

MAX_COMMAND_DIFFERENCE = 0.5  # likewise of each motor's output, which steps between two samples: 0.02 to 0.05


class ComparedParameter(NamedTuple):
    """A physical parameter beside its truth.

    Attributes:
        name: such as "effect of motor 1".
        unit: of estimate, half width and truth.
        estimate: of the gray-box model.
        half_width: of its 90 % interval; NaN where it is not identifiable.
        truth: in the same unit.
        status: "reported", "biased" or "not identifiable".
    """

    name: str
    unit: str
    estimate: float
    half_width: float
    truth: float
    status: Status = "reported"

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; ``None`` where there is none."""
        return None if isnan(self.half_width) else bool(abs(self.estimate - self.truth) <= self.half_width)


class ComparedWind(NamedTuple):
    """The wind's torque beside its truth, rad/s²; T samples.

    Attributes:
        truth: (T,) its course.
        correlation: of the two courses.
        sd, true_sd: standard deviations.
        mean: the steady part, with its half width and its truth.
        inside: share of samples whose truth is in the 90 % band.
        resolved: whether the estimate is larger than its expected errors.
    """

    truth: Array
    correlation: float
    sd: float
    true_sd: float
    mean: ComparedParameter
    inside: float
    resolved: bool


class TruthComparison(NamedTuple):
    """Physical parameters and wind beside their truth, each empty or ``None`` where there is no estimate."""

    source: str
    parameters: tuple[ComparedParameter, ...]
    wind: ComparedWind | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values, without the wind's course."""
        found: dict[str, Any] = {"source": self.source, "parameters": [_values(one) for one in self.parameters]}
        if self.wind is None:
            return found | {"wind": None}
        kept = {name: value for name, value in self.wind._asdict().items() if name not in ("truth", "mean")}
        return found | {"wind": kept | {"mean": _values(self.wind.mean)}}


def _values(one: ComparedParameter) -> dict[str, Any]:
    half = None if isnan(one.half_width) else one.half_width
    return one._asdict() | {"half_width": half, "inside": one.inside}


class FlightTruth(NamedTuple):
    """What a truth file says of one axis; N rows of the simulation, r motors.

    Attributes:
        source: the file's name.
        axis: "roll", "pitch" or "yaw".
        time: (N,) s on the boot clock.
        rate: (N,) as the autopilot knew it, rad/s.
        outputs: (N, r) of the motors, µs.
        disturbance: (N,) rad/s².
        effect: (r,) rad/s² per µs; ``weak_effect`` (r,) likewise once something broke, ``weak`` (N,) says when.
        damping, lag, delay: 1/s, s, s.
    """

    source: str
    axis: str
    time: Array
    rate: Array
    outputs: Array
    disturbance: Array
    effect: Array
    weak_effect: Array
    weak: NDArray[np.bool_]
    damping: float
    lag: float
    delay: float


def read_truth(path: str | PathLike[str], axis: str) -> FlightTruth:
    """One axis of a truth file of ``mavdem fly``.

    Raises:
        Unreadable: it is not one, or cannot be read.
    """
    name = Path(fspath(path)).name or fspath(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            parts: dict[str, Any] = {
                "time": file["time"],
                "rate": file["known_rates"][:, AXES.index(axis)],
                "outputs": file["outputs"],
                "disturbance": file[f"{axis}_disturbance"],
                "effect": file[f"{axis}_effect"],
                "weak_effect": file[f"{axis}_effect{'_weak' if f'{axis}_effect_weak' in file else ''}"],
                "weak": file["weak"],
                "damping": -file[f"{axis}_A"][-1, -1],
                "lag": file["lag"][0],
                "delay": file["delay"],
            }
            arrays = {key: np.asarray(value, np.float64) for key, value in parts.items()}
    except OSError as error:
        raise Unreadable(f"{name} cannot be read ({error.strerror or error}).") from None
    except (KeyError, IndexError, TypeError, ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error):
        raise Unreadable(f"{name} is no truth file that this version of `mavdem fly` writes beside a log.") from None
    rows, motors = len(np.atleast_1d(arrays["time"])), arrays["effect"].size
    shapes = {"time": (rows,), "rate": (rows,), "disturbance": (rows,), "weak": (rows,), "outputs": (rows, motors)}
    shapes |= {"effect": (motors,), "weak_effect": (motors,), "damping": (), "lag": (), "delay": ()}
    sound = all(arrays[key].shape == shape and np.isfinite(arrays[key]).all() for key, shape in shapes.items())
    if not (sound and rows > 1 and (np.diff(arrays["time"]) > 0).all()):
        raise Unreadable(f"{name} is damaged: its arrays do not fit each other.")
    return FlightTruth(
        source=name,
        axis=axis,
        time=arrays["time"],
        rate=arrays["rate"],
        outputs=arrays["outputs"],
        disturbance=arrays["disturbance"],
        effect=arrays["effect"],
        weak_effect=arrays["weak_effect"],
        weak=arrays["weak"].astype(bool),
        damping=float(arrays["damping"]),
        lag=float(arrays["lag"]),
        delay=float(arrays["delay"]),
    )


def truth_of(flights: Sequence[Flight], path: str | PathLike[str]) -> FlightTruth:
    """What the truth file says of the axis of ``flights``, the segments of one.

    Args:
        flights: with the names of their outputs.
        path: the truth file, ``flight.truth.npz`` beside ``flight.tlog``.

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
        if not _differs(segment.outputs[:, -1], truth.time, truth.rate, segment.time) < MAX_DIFFERENCE:
            raise Unreadable(
                f"{truth.source} is the truth of another flight: from {segment.time[0]:.1f} s to "
                f"{segment.time[-1]:.1f} s its {name} is not the log's. Name the .truth.npz that `mavdem fly` wrote "
                "beside this log."
            )
    return truth


def compare_with_truth(learned: Learned, flights: Sequence[Flight], truth: FlightTruth) -> TruthComparison:
    """The physical parameters and the wind's torque of a learnt flight beside their ``truth``.

    Args:
        learned: its ``physical`` and ``wind`` are compared.
        flights: the segments that it was learnt from, in their order.
        truth: of these.

    Raises:
        ValueError: ``flights`` are not what ``learned`` was learnt from.
    """
    if sum(map(len, flights)) != len(learned.record):
        raise ValueError("flights must be what the model was learnt from")
    time = np.concatenate([segment.time for segment in flights])
    parameters = () if learned.physical is None else _parameters(learned.physical, flights, truth, time)
    return TruthComparison(truth.source, parameters, None if learned.wind is None else _wind(learned.wind, truth, time))


def _differs(measured: Array, stamps: Array, known: Array, time: Array) -> float:
    """Root mean square difference over the measured standard deviation; infinite where no truth is known."""
    if time[0] < stamps[0] or time[-1] > stamps[-1]:
        return float("inf")
    difference = measured - np.interp(time, stamps, known)
    return float(np.sqrt(np.mean(difference**2)) / measured.std())


def _parameters(
    read: Physical, segments: Sequence[Flight], truth: FlightTruth, time: Array
) -> tuple[ComparedParameter, ...]:
    effect, damping, lag, delay = read.interval(LEVEL)
    status, found = read.status, []
    if _are_the_motors(segments, truth):
        weak = np.interp(time, truth.time, truth.weak) >= 0.5
        true = truth.weak_effect if weak.mean() >= 0.5 else truth.effect
        unit = "rad/s² per µs"
        found = [
            ComparedParameter(f"effect of {name.split(' (')[0]}", unit, value, half, known, status["effect"])
            for name, value, half, known in zip(
                segments[0].input_names, read.effect.tolist(), effect.tolist(), true.tolist(), strict=True
            )
        ]
        mean = float(np.abs(true).mean())
        found.append(ComparedParameter("mean effect", unit, *read.mean_effect(LEVEL), mean, status["effect"]))
    return (
        *found,
        ComparedParameter("damping", "1/s", read.damping, damping, truth.damping, status["damping"]),
        ComparedParameter("lag of the motors", "s", read.lag, lag, truth.lag, status["lag"]),
        ComparedParameter("delay", "s", read.delay, delay, truth.delay, status["lag"]),
    )


def _are_the_motors(segments: Sequence[Flight], truth: FlightTruth) -> bool:
    """Whether the inputs are the motors' outputs, in their order and in µs."""
    if segments[0].inputs.shape[1] != truth.outputs.shape[1]:
        return False
    return all(
        _differs(measured, truth.time, known, segment.time) < MAX_COMMAND_DIFFERENCE
        for segment in segments
        for measured, known in zip(segment.inputs.T, truth.outputs.T, strict=True)
    )


def _wind(found: WindTorque, truth: FlightTruth, time: Array) -> ComparedWind:
    true = np.interp(time, truth.time, truth.disturbance)
    still = not (true.std() and found.torque.std())
    mean = ComparedParameter("steady part", "rad/s²", found.mean, found.mean_band, float(true.mean()))
    return ComparedWind(
        truth=true,
        correlation=float("nan") if still else float(np.corrcoef(found.torque, true)[0, 1]),
        sd=found.sd,
        true_sd=float(true.std()),
        mean=mean,
        inside=float(np.mean(np.abs(found.torque - true) <= found.band)),
        resolved=found.resolved,
    )
