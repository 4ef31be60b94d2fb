"""Conversion of streams, of flights to tables, MCAP channels and objects of other libraries, and of models."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from warnings import warn

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.segments import longest_recorded_segment
from mavdem.dataset.signals import Signals
from mavdem.dem import Learned
from mavdem.errors import NotLearnable
from mavdem.experiments.held_out import HeldOut
from mavdem.extras import require_extra
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPlant
from mavdem.files import PathName, atomic_write, reporting_write_errors, writable_target
from mavdem.flight import Flight, Flights, boot_number
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mcap.records import MAX_STAMP, write_mcap, write_series
from mavdem.ingest.tlog import write_tlog
from mavdem.loops.loop_construction import POSTERIOR_DRAWS
from mavdem.plant import Physical
from mavdem.report.labels import Labels, state_names, states_are_outputs
from mavdem.report.numbers import short
from mavdem.report.series import series_of
from mavdem.wind_velocity.estimation import WindVelocity
from mavdem.wind_velocity.from_log import wind_evidence

if TYPE_CHECKING:
    import control
    import pandas
    import xarray

# columns (T,) by name, with units, such as "roll_rate_rad_s"; the first is "time_s"
Table = Mapping[str, Array]
TIME = "time_s"
IN_TEXT = {TIME: ".6f"}  # stamps of autopilots are microseconds at best
FLOAT32 = ".7g"  # other numbers in text: autopilots send and log them as float32


def column_name(name: str, unit: str) -> str:
    """Returns a name that needs no quotes: "motor_1_us" of "motor 1 (front left)" and "µs"."""
    plain = f"{short(name)} {unit}".replace("µ", "u")
    return "_".join(re.findall(r"[^\W_]+", plain.lower()))


def _channels(flight: Flight) -> Iterator[tuple[str, Names, Names, Array]]:
    """Kind, names, units and values (T, k) of what a flight has."""
    for kind, values in (
        ("input", flight.inputs),
        ("output", flight.outputs),
        ("setpoint", flight.setpoints),
    ):
        if values is not None:
            yield kind, getattr(flight, f"{kind}_names"), getattr(flight, f"{kind}_units"), values


def columns(flight: Flight) -> dict[str, Array]:
    """Returns time, inputs, outputs and setpoints (T,) by :func:`column_name`.

    Raises ``ValueError`` if two names are equal.
    """
    table = {TIME: flight.time}
    for _, names, units, values in _channels(flight):
        for head, column in zip(map(column_name, names, units), values.T, strict=True):
            if head in table:
                raise ValueError(f"two columns of the flight are called {head}: name them apart")
            table[head] = column
    return table


def wind_columns(signals: Signals, boot: int, time: Array) -> dict[str, Array]:
    """Returns the wind at ``time`` (T,), s of a ``boot``: north and east of where the air moves to, and half widths.

    NaN outside the flight whose wind it is; empty where a log has no wind in this boot.
    """
    wind, _, _ = wind_evidence(signals)
    if wind is None or not wind.speed_identifiable or wind.boot != boot:
        return {}
    names = ("wind north", "wind east", "wind north band", "wind east band")
    parts = zip(map(column_name, names, 4 * ["m/s"]), (*wind.velocity.T, *wind.band.T), strict=True)
    return {name: np.interp(time, wind.time, part, np.nan, np.nan) for name, part in parts}


def write_csv(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes a head and one line a sample, as ``IN_TEXT`` and ``FLOAT32`` say, without the provenance."""
    texts = [
        [format(value, IN_TEXT.get(name, FLOAT32)) for value in column.tolist()]
        for name, column in table.items()
    ]
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    csv.writer(text, lineterminator="\n").writerows([list(table), *zip(*texts, strict=True)])
    text.detach()


def write_parquet(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes the columns as Parquet, as float64, the provenance as JSON in the metadata; needs pyarrow."""
    import pyarrow
    from pyarrow import parquet

    metadata = {"provenance": json.dumps(dict(provenance))}
    parquet.write_table(pyarrow.table(dict(table)).replace_schema_metadata(metadata), file)


def to_pandas(flight: Flight) -> pandas.DataFrame:
    """Returns a row a sample, by time in s on the boot clock; columns are those of :func:`columns`."""
    import pandas

    frame = pandas.DataFrame(columns(flight)).set_index(TIME)
    frame.attrs = {"dt": flight.dt, "provenance": dict(flight.provenance)}
    return frame


def to_xarray(flight: Flight) -> xarray.Dataset:
    """Returns variables ``inputs (time, input)``, ``outputs (time, output)`` and what else the flight has, by name.

    ``time`` is in s on the autopilot's boot clock. Units stand beside the names, as ``input_unit (input)`` and so on;
    the sampling step and the source are in ``attrs``.
    """
    import xarray

    variables: JsonValues = {}
    coordinates: JsonValues = {
        "time": ("time", flight.time, {"units": "s", "long_name": "time since boot"})
    }
    for kind, names, units, values in _channels(flight):
        variables[f"{kind}s"] = (("time", kind), values)
        coordinates |= {kind: (kind, list(names)), f"{kind}_unit": (kind, list(units))}
    if flight.effect_directions is not None:
        variables["effect_directions"] = ("input", flight.effect_directions)
    return xarray.Dataset(
        variables,
        coordinates,
        {"dt": flight.dt, "source": str(flight.provenance.get("source", ""))},
    )


PADE_ORDER = 2  # of the delay, exact to 1° up to 0.3/delay Hz


def to_control(learned: Learned, model: str = "physical") -> control.StateSpace:
    """Returns the axis in continuous time, in the units of the data, radians and s, about its trim.

    The ``model`` "physical" is the plant: from the motors to angle and rate by their effect, lag and delay, which is
    approximated to second order (Padé), and the damping. ``.delay`` is that delay, s; ``.draws`` are plants from the
    posterior, for what is to hold under uncertainty. It needs no controller, and has no bias of the closed loop.

    The ``model`` "dem" is DEM's own ẋ = A x + B u, y = C x of the flight in closed loop, without noise and offset.

    The ``name`` says which it is. Signals are named as columns of ``flight.csv`` are: "motor_1_us", "roll_rad".

    Raises:
        NotLearnable: the physical parameters are not identifiable. A ``UserWarning`` says that they are biased.
        ValueError: another ``model``.
    """
    import control

    if model not in ("physical", "dem"):
        raise ValueError(f"model must be 'physical' or 'dem', not {model!r}")
    labels = Labels.of(learned)
    inputs = list(map(column_name, labels.input_names, labels.input_units))
    outputs = list(map(column_name, labels.output_names, labels.output_units))
    names = {"inputs": inputs, "outputs": outputs, "name": f"mavdem {model} model"}
    if model == "physical":
        draws = _identified(learned).draws(POSTERIOR_DRAWS).tolist()
        plant, *plants = (_plant(draw, names) for draw in draws)
        plant.delay = draws[0][-1]
        plant.draws = plants
        return plant
    states = [column_name(name, "") for name in state_names(labels.output_names, learned)]
    if states_are_outputs(learned):
        states = [*outputs, *states[len(outputs) :]][: len(states)]
    A, B, C = learned.model.A, learned.model.B, learned.model.C
    return control.StateSpace(A, B, C, np.zeros((len(C), len(inputs))), states=states, **names)


def _identified(learned: Learned) -> Physical:
    """The physical parameters of a model of angle and rate; warns of what is not well known."""
    physical = learned.physical
    count = len(learned.record.output_names)
    if physical is None or physical.caution is not None:
        reason = learned.physical_reason if physical is None else physical.caution
        raise NotLearnable(NoPlant.NO_PLANT, because=reason)
    if count > 2:
        raise NotLearnable(NoPlant.TOO_MANY_OUTPUTS, count=count)
    if doubtful := [
        f"{name} {status}"
        for name, status in physical.status.items()
        if status is not Status.REPORTED
    ]:
        given = dict.fromkeys(fact.advised for fact in physical.reasons.values() if fact)
        reasons = " ".join(given)
        warn(f"Poorly known of this plant: {', '.join(doubtful)}. {reasons}", stacklevel=5)
    return physical


def _plant(draw: Sequence[float], names: JsonValues) -> control.StateSpace:
    """The physical plant of effect, damping, lag and delay."""
    import control

    *effect, damping, lag, delay = draw
    outputs = names["outputs"]
    count = len(outputs)
    order = PADE_ORDER if delay else 0
    late = control.tf2ss(*control.pade(delay, order))
    A = np.array([[0, 1, 0], [0, -damping, 1], [0, 0, -1 / lag]])[2 - count :, 2 - count :]
    B = np.zeros((count + 1, 1))
    B[-1] = 1 / lag
    motion = control.StateSpace(A, B, np.eye(count, count + 1), np.zeros((count, 1)))
    states = [*(f"delay_{i + 1}" for i in range(order)), *outputs, "motors_torque"]
    return control.StateSpace(motion * late * np.array([effect]), states=states, **names)


STREAMS = {".tlog": write_tlog, ".mcap": write_mcap}
# what writes a file, by the end of its name
TABLES = {".csv": write_csv, ".parquet": write_parquet}


def convert(
    source: PathName,
    out: PathName,
    axis: str,
    vehicle: str | None = None,
    inputs: str | None = None,
) -> JsonValues:
    """Converts ``source`` to the format of ``out``'s ending, and reports what was written.

    A .tlog or .mcap receives every frame with its receive stamp, those that cannot be read included, but no bytes
    between frames; messages that an MCAP recording has as JSON only become MAVLink 2 frames. A .csv or .parquet
    receives the longest usable segment of one vehicle, or where no model can be learned the longest that attitude and
    inputs have in common; if they come at rates far apart, or only one is there, each at its own stamps, NaN elsewhere.

    ``out`` appears whole or not at all; ``axis``, ``vehicle`` and ``inputs`` of a table are as for
    :func:`mavdem.read_flight`. The report, plain JSON values, holds of a stream the frames written, messages left
    out, frames unread, stamps that had to be taken from the frame before, bytes skipped, and repairs; of a table
    its samples, columns, step (None at a stream's own stamps), how attitude and motors were resampled, whether a
    model can be learned from it, and cautions.

    Raises:
        Unreadable: ``source`` cannot be read, or ``out`` not written.
        MissingExtra: ``out`` is a .parquet, and pyarrow is not installed.
        NotLearnable: there is no vehicle, or several and none was chosen, or attitude or inputs are missing.
        ValueError: ``out`` is the source, or has no known ending or that of the source.
    """
    source = Path(source)
    out = Path(out)
    if out.suffix.lower() not in {*STREAMS, *TABLES}:
        raise ValueError(
            f"{out} must end in {', '.join([*STREAMS, *TABLES])}: the ending chooses the format"
        )
    if out.suffix.lower() == ".parquet":
        require_extra("parquet", f"{out}")
    with reporting_write_errors(out):
        writable_target(out)  # before the work
        if out.exists() and source.exists() and out.samefile(source):
            raise ValueError(f"{out} is the input: name another file")
        if out.suffix.lower() in TABLES:
            written = _convert_to_table(source, out, axis, vehicle, inputs)
        else:
            written = _convert_stream(source, out)
    return {"source": str(source), "out": str(out), **written}


def _convert_stream(source: Path, out: Path) -> JsonValues:
    kind = out.suffix.lower()
    stream = read_stream(source)
    if stream.file_ending == kind:
        raise ValueError(f"{source} is a {kind} already: choose another format")
    with atomic_write(out) as file:
        written = STREAMS[kind](file, stream)
    # Stamps that the form cannot hold, like those that are missing, are taken from the frame before.
    beyond = stream.stamps > MAX_STAMP if kind == ".mcap" else np.False_
    return {
        "frames": written,
        "left_out": len(stream.frames) - written,
        "unread": int(np.count_nonzero(stream.frames.checksum != CHECKSUM_MATCHES)),
        "stamps_filled": int(np.count_nonzero((stream.stamps == 0) | beyond)),
        "bytes_skipped": stream.bytes_skipped,
        "repairs": list(map(str, stream.repairs)),
    }


def _convert_to_table(
    source: Path, out: Path, axis: str, vehicle: str | None, inputs: str | None
) -> JsonValues:
    log = read_log(source)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    learnability = learnability_of(signals, log.components)
    segment = None if learnability.flight else longest_recorded_segment(signals)
    flight = aligned_flight(signals, segment) if segment else learnability.flight
    cautions = list(map(str, learnability.cautions))
    if not learnability.learnable:
        cautions.append(str(learnability.reason))
    if flight is None:
        raise NotLearnable(learnability.reason)
    provenance = {**flight.provenance, "cautions": cautions}
    table = columns(flight)
    table |= wind_columns(signals, boot_number(flight), flight.time)
    with atomic_write(out) as file:
        TABLES[out.suffix.lower()](file, table, provenance)
    return {
        "samples": len(table[TIME]),
        "columns": list(table),
        "dt": flight.dt,
        "resampling": provenance["resampling"],
        "start": float(table[TIME][0]),
        "end": float(table[TIME][-1]),
        "learnable": learnability.learnable,
        "cautions": cautions,
    }


def write_channels(
    path: PathName,
    flights: Flights,
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
    wind: WindVelocity | None = None,
) -> None:
    """Writes flights of one boot as JSON channels of an .mcap file, on the boot clock, in the units of the flight.

    ``flight/outputs`` and ``flight/inputs`` are what was measured; with ``learned``, the model of these ``flights``,
    also ``learned/one_step``, ``learned/process_noise`` (per second), ``learned/free_energy`` (F(t)),
    ``learned/command``, the motors' difference, and, if it is known, ``learned/wind_torque`` with the half width of its
    band (rad/s²); and with ``held_out`` windows ``held_out/measured``, ``held_out/forecast``, ``held_out/residual`` and
    ``held_out/band``, the half width of the forecast's 90 % band. ``docs/layouts`` shows them in either viewer. The
    ``wind`` is in ``wind/velocity``, m/s north and east that the air moves to, and its half widths ``wind/band``.

    ``OSError`` if ``path`` cannot be written, ``ValueError`` for a time before 0, which MCAP cannot hold, or a model of
    other flights.
    """
    if flights[0].time[0] < 0:
        raise ValueError("time must not be negative: MCAP counts from 0")
    series = {
        name: (series.time, dict(zip(_keys(series.names), series.values.T, strict=True)))
        for name, series in series_of(flights, learned, held_out, wind).items()
    }
    with atomic_write(path) as file:
        write_series(file, series)


def _keys(names: Sequence[str]) -> list[str]:
    """The names as a viewer's paths can have them: "motor_1" for "motor 1 (front right)"; apart in any case."""
    keys = [re.sub(r"\W+", "_", short(name)).strip("_") for name in names]
    if len(set(keys)) < len(keys):
        keys = [f"{key}_{i + 1}" for i, key in enumerate(keys)]
    return keys
