"""Recording: one learnt flight as a Rerun file, with the blueprint that shows it."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.dem.priors import hyperparameter_groups
from mavdem.flight import Flight
from mavdem.naming import entries, left_free, named, short, state_names, state_rate_units
from mavdem.view import lines
from mavdem.view.blueprint import blueprint
from mavdem.view.lines import Line
from mavdem.view.outlook import Outlook, outlooks
from mavdem.view.parameters import by_group, estimate_band, prior_outweighs_data
from mavdem.view.summary import summary

Array = NDArray[np.float64]


def write_recording(path: str | os.PathLike[str], train: Flight, test: Flight, learned: Learned) -> None:
    """Writes what was learnt from ``train`` and how it forecasts ``test``, the samples right after, as an .rrd file.

    The file appears whole or not at all, replaces one that is there, and opens with its own blueprint. Angles are in
    degrees where they are measured or forecast, in rad in the model.

    Args:
        path: the file, in a folder that is there.
        train, test: two pieces of one flight.
        learned: the model of ``train``.

    Raises:
        OSError: it cannot be written there.
    """
    path = Path(path)
    # Rerun does not tell when a file it writes fails, as on a full disk; Python does.
    contents = _recorded(Path(str(train.provenance.get("source", path))).name, train, test, learned)
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        unfinished = Path(folder) / path.name
        unfinished.write_bytes(contents)
        os.replace(unfinished, path)


def _recorded(name: str, train: Flight, test: Flight, learned: Learned) -> bytes:
    """The contents of an .rrd file."""
    seen = outlooks(train, test, learned)
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_blueprint(blueprint(train, test, learned, seen), make_active=False)
    recording.send_recording_name(_unicode(name))
    document = rr.TextDocument(_unicode(summary(train, test, learned)), media_type=rr.MediaType.MARKDOWN)
    recording.log("result", document, static=True)
    for outlook in seen:
        _output(recording, outlook)
    _inputs(recording, train, test)
    _process_noise(recording, train, learned)
    _free_energy_of_samples(recording, train, learned)
    _parameters(recording, train, learned)
    _free_energy(recording, learned)
    _noise_precisions(recording, train, learned)
    return memory.drain_as_bytes()


def _unicode(text: str) -> str:
    """A file's name need not be UTF-8, and what Rerun is given must be."""
    return text.encode(errors="replace").decode()


def _output(recording: rr.RecordingStream, outlook: Outlook) -> None:
    root = rr.new_entity_path(["outputs", outlook.name])
    before, after = np.split(outlook.time, [len(outlook.one_step)])
    for name, label, colour, width, time, values in (
        ("band", "90 % band", lines.BAND, 1.5, after, outlook.band),
        ("constant_mean", "constant mean", lines.TRIVIAL, 1.5, after, outlook.constant_mean),
        ("dem_forecast", "DEM: forecast", lines.FORECAST, 2.5, after, outlook.forecast),
        ("dem_one_step", "DEM: one step ahead", lines.PREDICTED, 5.0, before, outlook.one_step),
        ("held_out", "held out from here", lines.BOUNDARY, 1.5, [outlook.boundary] * 2, outlook.range),
        # Drawn in the order of their paths: this one last, thin on the thick prediction that it may hide.
        ("measured", "measured", lines.MEASURED, 1.5, outlook.time, outlook.measured),
    ):
        Line(f"{root}/{name}", label, colour, width).over_time(recording, time, values)


def _inputs(recording: rr.RecordingStream, train: Flight, test: Flight) -> None:
    time = np.append(train.time, test.time) - train.time[0]
    for i, (name, values) in enumerate(zip(train.input_names, np.vstack([train.inputs, test.inputs]).T, strict=True)):
        Line(rr.new_entity_path(["inputs", name]), name, lines.distinct(i)).over_time(recording, time, values)


def _process_noise(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    places, noise = learned.process_noise()
    time = train.time[places] - train.time[0]
    units = state_rate_units(train, learned)
    for i, (name, unit) in enumerate(zip(state_names(train, learned), units, strict=True)):
        line = Line(rr.new_entity_path(["process_noise", name]), named(name, unit), lines.distinct(i))
        line.over_time(recording, time, noise[:, i])


def _free_energy_of_samples(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    time = train.time[learned.places] - train.time[0]
    Line("free_energy_of_samples", "F(t)", lines.MEASURED, 1.5).over_time(
        recording, time, learned.free_energy_of_samples
    )


def _parameters(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    learning = learned.learning
    first = 0
    for matrix, free in left_free(learned).items():
        # Colours are for those that are shown, which are those left free.
        colours = np.cumsum(free) - 1
        for i, (row, column) in enumerate(entries(train, learned)[matrix]):
            root = ["parameters", "free" if free[i] else "known_beforehand", matrix, f"{row} from {column}"]
            mean, sd = learning.theta[:, first + i], learning.theta_sd[:, first + i]
            _estimate(recording, root, f"{row} ← {short(column)}", lines.distinct(int(colours[i])), mean, sd)
        first += len(free)


def _free_energy(recording: rr.RecordingStream, learned: Learned) -> None:
    energy = learned.free_energy
    Line("free_energy/total", "F̄", lines.MEASURED, 2.5).over_iterations(recording, energy.total)
    for i, (name, term) in enumerate(energy.terms.items()):
        # Their sizes differ ten-thousandfold: less their last value, all can be seen to move, in one picture.
        label = f"{name.removeprefix('prediction ')}: {round(float(term[-1])):,}"
        line = Line(rr.new_entity_path(["free_energy", "terms", name]), label, lines.distinct(i))
        line.over_iterations(recording, term - term[-1])


def _noise_precisions(recording: rr.RecordingStream, train: Flight, learned: Learned) -> None:
    learning, states = learned.learning, state_names(train, learned)
    of_outputs, of_states = hyperparameter_groups(learned.settings, len(states), len(train.output_names))
    # Each process noise in the colour of its own picture, those of the measurements after them.
    process = by_group("w", states, of_states)
    measurement = by_group("z", train.output_names, of_outputs)
    named_colours = [(name, len(process) + i) for i, name in enumerate(measurement)]
    named_colours += [(name, i) for i, name in enumerate(process)]
    fixed = prior_outweighs_data(learned)
    for i, (name, colour) in enumerate(named_colours):
        root, label = ["noise_precisions", name], f"{name} (fixed)" if fixed[i] else name
        _estimate(recording, root, label, lines.distinct(colour), learning.lambda_[:, i], learning.lambda_sd[:, i])


def _estimate(
    recording: rr.RecordingStream, root: list[str], name: str, colour: lines.Colour, mean: Array, sd: Array
) -> None:
    """A posterior mean and its band by iteration; the legend counts them as one, since they share name and colour."""
    band = np.stack(estimate_band(mean, sd), axis=-1)
    Line(rr.new_entity_path([*root, "band"]), name, colour, 0.6).over_iterations(recording, band)
    Line(rr.new_entity_path([*root, "mean"]), name, colour, 2.5).over_iterations(recording, mean)
