"""``mavdem live``: attaches to a link, learns while the vehicle flies, and shows it."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import Any

import click

from mavdem.attached import Attached, Standing
from mavdem.cli.dashboard import Dashboard
from mavdem.cli.main import DONE, UNSUPPORTED, UNUSABLE
from mavdem.cli.model_options import chosen_settings, model_options
from mavdem.cli.new_file import check_file, writing
from mavdem.cli.output import print_json, printable, say_aside
from mavdem.cli.signals import asked_to_end
from mavdem.cli.source import motion_options, no_option
from mavdem.convert import STREAMS
from mavdem.errors import Unreadable
from mavdem.ingest.link import Link
from mavdem.ingest.raw_recording import RawRecording
from mavdem.learning_process import LearningProcess
from mavdem.live import LiveStream
from mavdem.whole_file import whole_file

TELL_EVERY = 5.0
"""Seconds from one line on standard error that says how things stand to the next."""


def _number(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Refuses what is no number: it lies in every range, since it is not outside."""
    if value is not None and math.isnan(value):
        raise click.BadParameter("it must be a number.", context, parameter)
    return value


@click.command()
@click.argument("link")
@motion_options
@model_options
@click.option("--rrd", type=click.Path(path_type=Path), callback=no_option, help="Rerun recording to write.")
@click.option("--serve", is_flag=True, help="Show it to browsers of this machine.")
@click.option("--connect", metavar="URL", callback=no_option, help="Show it in a Rerun viewer that listens there.")
@click.option(
    "--record", type=click.Path(path_type=Path), callback=no_option, help="Keep the raw stream: FILE.tlog or FILE.mcap."
)
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    callback=no_option,
    help="Where the model is kept at the end. [default: beside --rrd or --record, .model.json]",
)
@click.option(
    "--request-rate",
    type=click.FloatRange(1, 1000),
    metavar="HZ",
    callback=_number,
    help="Ask the vehicle for attitude and motor outputs at this rate. Without it nothing is ever sent.",
)
@click.option(
    "--duration", type=click.FloatRange(0, min_open=True), callback=_number, help="Seconds after which to end."
)
def live(
    link: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    preset: str,
    order: int | None,
    rrd: Path | None,
    serve: bool,
    connect: str | None,
    record: Path | None,
    model: Path | None,
    request_rate: float | None,
    duration: float | None,
) -> None:
    """Attaches to a link and learns while the vehicle flies.

    LINK is a connection string of pymavlink's: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a
    serial port as /dev/ttyACM0,115200. Within seconds of take-off a dashboard shows roll as it is measured, expected
    and predicted, the free energy, the model and the disturbance of the wind. Nothing is sent unless --request-rate is
    given, and what was there before is then restored at the end. Ctrl-C, SIGTERM and SIGHUP end it and keep the model;
    pressed again they change nothing.

    It ends with 0 when there is a model, with 1 when there is none, also when nothing took off, and with 2 when a file
    could not be written to its end; --json prints its document either way.

    \b
    Examples:
      mavdem live udpin:127.0.0.1:14550
      mavdem live udpin:127.0.0.1:14550 --request-rate 100 --record flight.tlog
      mavdem live /dev/ttyUSB0,57600 --rrd flight.rrd
    \b
    Without a vehicle, in two terminals:
      mavdem live udpin:127.0.0.1:14550 --rrd flight.rrd
      mavdem fly iris_gusts --udp 127.0.0.1:14550
    """
    settings = chosen_settings(preset, order)
    place = _checked(rrd, record, model)
    stream = LiveStream(axis, vehicle, inputs, asked=request_rate is not None)
    with ExitStack() as signals, ExitStack() as ends:
        opened = Link(link)
        ends.callback(opened.close)
        if opened.speaks_first and request_rate is None:
            raise click.BadParameter(
                f"{link} answers only who speaks to it, and nothing is sent without --request-rate: give that, or "
                "listen with udpin:HOST:PORT.",
                param_hint="LINK",
            )
        dashboard = ends.enter_context(Dashboard(link, axis, rrd, serve, connect))
        recording = None if record is None else RawRecording(record)
        executor = ends.enter_context(LearningProcess())
        show, tell = dashboard.open, dashboard.tell
        attached = Attached(opened, stream, settings, show, tell, say_aside, executor, recording, request_rate)
        ends.callback(attached.end)
        dashboard.say_where()
        say_aside(f"Listening on {link}; Ctrl-C ends it.")
        if place is None:
            say_aside("The model is not kept: name a file with --model, --rrd or --record.")
        asked = signals.enter_context(asked_to_end())
        took = _run(attached, asked, duration)
        told = _told(attached.standing, link, took)
        # What was learnt is dearest: it is kept before anything that may fail, or takes its time, ends.
        kept, code = _keep_model(attached, place)
        ends.close()
        told["events"] = list(attached.said)
        told["rrd"] = str(rrd) if dashboard.recorded else None
        told["record"] = None if recording is None else {"file": str(record), "frames": recording.frames}
        told["model"] = None if kept is None else str(kept)
        if rrd is not None and not dashboard.opened:
            say_aside(f"Nothing came that could be shown, so there is no {rrd}.")
        if as_json:
            print_json(told)
    if attached.recording is not recording or dashboard.broken:
        code = UNUSABLE
    click.get_current_context().exit(code)


def _checked(rrd: Path | None, record: Path | None, model: Path | None) -> Path | None:
    """Refuses, before the flight, what could not be written after it; answers where the model goes."""
    check_file(rrd, "--rrd", (".rrd",))
    check_file(record, "--record", tuple(STREAMS))
    beside = rrd or record
    kept = model or (None if beside is None else beside.with_suffix(".model.json"))
    check_file(kept, "--model", (".json",))
    return kept


def _keep_model(attached: Attached, place: Path | None) -> tuple[Path | None, int]:
    """Writes the model of the last samples; answers where, and the exit code that goes with it."""
    if attached.learner is None:
        say_aside("There is no model: no settled flight was heard.")
        return None, UNSUPPORTED
    try:
        text = attached.learner.learn_now().to_json()
    except ValueError as error:
        say_aside(f"There is no model: {error}.")
        return None, UNSUPPORTED
    if place is None:
        say_aside("The model was not kept.")
        return None, DONE
    try:
        with writing(place), whole_file(place) as file:
            file.write(text.encode() + b"\n")
    except Unreadable as error:
        say_aside(f"The model is lost: {error}")
        return None, UNUSABLE
    say_aside(f"Kept the model in {printable(place)}.")
    return place, DONE


def _told(standing: Standing, link: str, took: float) -> dict[str, Any]:
    learnt, shown = standing.samples
    median, late = standing.latency
    return {
        "link": link,
        "vehicle": standing.vehicle,
        "seconds": round(took, 3),
        "samples": {"learnt": learnt, "shown": shown},
        "rates": standing.rates,
        "lost": standing.lost,
        "latency": {"median": median, "p99": late},
        "obstacle": standing.obstacle,
    }


def _run(attached: Attached, asked: Callable[[], bool], duration: float | None) -> float:
    """Until the time is over or it is asked to end; answers how many seconds that was."""
    # What is there by now stays: looking at it again and again would hold samples up for tens of milliseconds.
    gc.collect()
    gc.freeze()
    began = told = monotonic()
    while not asked() and (duration is None or monotonic() - began < duration):
        attached.step()
        if monotonic() - told >= TELL_EVERY:
            told = monotonic()
            say_aside(_in_words(attached.standing))
    return monotonic() - began


def _in_words(standing: Standing) -> str:
    rates = ", ".join(f"{name} {rate:.3g} Hz" for name, rate in sorted(standing.rates.items()) if rate) or "no attitude"
    learnt, shown = standing.samples
    state = standing.obstacle or "learning"
    late = f", 99 % within {1e3 * standing.latency[1]:.1f} ms of their datagram" if learnt + shown else ""
    return f"{standing.vehicle or 'no vehicle'}: {rates}; {learnt} samples learnt{late}; {state.rstrip('.')}."
