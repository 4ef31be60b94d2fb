"""``mavdem live``: attaches to a link, learns while the vehicle flies, and shows it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Group
from rich.live import Live as Place
from rich.text import Text

from mavdem.cli.exit_codes import EXIT_DONE, EXIT_ERROR, EXIT_UNSUPPORTED
from mavdem.cli.options import NumberRange, file_option, json_option, model_options, vehicle_option
from mavdem.cli.output import print_json
from mavdem.cli.output_files import check_output_file
from mavdem.cli.streams import STDERR, escape_unprintable, print_to_stderr
from mavdem.cli.termination import termination_requests
from mavdem.dataset.axes import TILT_AXES, output_names_and_units
from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess
from mavdem.documents.session import live_document
from mavdem.errors import Unreadable
from mavdem.export.conversion import STREAM_WRITERS
from mavdem.extras import missing_extra_fact, require_extra
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.session import Session
from mavdem.files import write_text_atomically
from mavdem.fleet.priors import earlier_drag, earlier_flight
from mavdem.live import LiveStream, RowFormat, SessionStatus
from mavdem.live.gain_advice import GainAdviser
from mavdem.live.history import horizon_steps
from mavdem.live.link import Link
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_loop import run_session
from mavdem.live.session_status import STATUS_PERIOD
from mavdem.report.live import watched_quantities
from mavdem.report.pages.flight_page import live_page
from mavdem.report.templates import as_clause, headline, render_section

STATUS_SECONDS = 5.0  # between two status lines that are not in one place

if TYPE_CHECKING:
    from mavdem.view.live_view import LiveView
    from mavdem.view.sinks import RecordingFile


class Dashboard:
    """Shows a live flight in a viewer, browsers and an .rrd file; without Rerun, or a screen and these, nowhere.

    ``advice``: how to open it, unless it opens by itself. ``file``: the recording, if there is one. Raises Unreadable:
    a port is taken; BadParameter: an invalid URL; MissingExtra: Rerun is asked for and not installed.
    """

    def __init__(
        self, link: str, axis: str, rrd: Path | None, serve: bool, connect: str | None
    ) -> None:
        self._link = link
        self._axis = axis
        self.view: LiveView | None = None
        self._said: set[str] = set()
        self.file: RecordingFile | None = None
        self.advice = str(missing_extra_fact("view", "The dashboard") or "")
        if self.advice:
            if rrd is not None or serve or connect is not None:
                require_extra("view", "The dashboard")
            return
        # Rerun takes a second to load.
        from mavdem.view.live_view import LiveView
        from mavdem.view.sinks import RecordingFile, WebServer, sinks_for

        try:
            sinks = sinks_for(rrd, serve, connect)
        except ValueError as error:
            raise click.BadParameter(f"{error}.", param_hint="--connect") from error
        except OSError as error:
            raise Unreadable(Session.DASHBOARD_NOT_OPENED, because=error) from None
        if not sinks:
            self.advice = "There is no screen here: use --rrd FILE to record, or --serve for browsers of this machine."
            return
        self.view = LiveView(sinks)
        for sink in sinks:
            if isinstance(sink, WebServer):
                self.advice = f"Open {sink.page} in a browser."
            elif isinstance(sink, RecordingFile):
                self.file = sink

    def open(self, row_format: RowFormat) -> LiveView | None:
        """Shows the rows of a format from now on; None where nothing can be shown."""
        if self.view is None:
            return None
        from mavdem.view.live_content import Channels

        (outputs, units) = zip(*output_names_and_units(self._axis), strict=True)
        motors = row_format.geometry.names, outputs, row_format.input_units, units
        self.view.change(Channels(self._link, row_format.dt, horizon_steps(row_format.dt), *motors))
        return self.view

    def report(self, status: SessionStatus) -> None:
        """Shows the status, and prints what is wrong with the view."""
        if self.view is not None:
            self.view.status(status)
            for trouble in set(self.view.troubles) - self._said:
                print_to_stderr(trouble)
                self._said.add(trouble)

    def close(self) -> None:
        """Ends the view."""
        if self.view is not None:
            self.view.close()


@click.command("live")
@click.argument("link")
@click.option(
    "--axis",
    type=click.Choice(TILT_AXES),
    default="roll",
    show_default=True,
    help="Axis to model.",
)
@vehicle_option
@json_option
@model_options
@file_option("--rrd", "Rerun recording to write; then no window opens.")
@click.option(
    "--serve",
    is_flag=True,
    help="Show it in a browser on this machine; Rerun's usage statistics are off.",
)
@click.option(
    "--connect",
    metavar="URL",
    help="Show it in the Rerun viewer at this address.",
)
@file_option("--record", "Raw stream to record: FILE.tlog or FILE.mcap.")
@file_option(
    "--model",
    "Where to write the model at the end. [default: beside --rrd or --record, .model.json]",
)
@file_option(
    "--html",
    "Page of what happened, to write at the end. [default: beside --rrd, --record or --model, .html]",
)
@click.option(
    "--request-rate",
    type=NumberRange(1, 1000),
    metavar="HZ",
    help="Ask for attitude and motor outputs at this rate, for setpoints at half of it or 50 Hz, for what shows a "
    "landing at 4 Hz, and for the parameters of motors and gains; nothing becomes slower. Without it nothing is ever "
    "sent.",
)
@file_option(
    "--prior", "Earlier model of the vehicle, model.json: a calm hover then has a wind torque."
)
@click.option("--duration", type=NumberRange(0, min_open=True), help="Seconds until it ends.")
@click.option(
    "--plain",
    is_flag=True,
    help="Print the status as lines below each other, as where this is no terminal.",
)
def live_command(
    link: str,
    axis: str,
    vehicle: str | None,
    as_json: bool,
    settings: Settings,
    rrd: Path | None,
    serve: bool,
    connect: str | None,
    record: Path | None,
    model: Path | None,
    html: Path | None,
    request_rate: float | None,
    prior: Path | None,
    duration: float | None,
    plain: bool,
) -> None:
    """Attaches to a link and learns while the vehicle flies.

    LINK is a connection string of pymavlink: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a
    serial port such as /dev/ttyACM0,115200. A dashboard shows the measured and the predicted roll, the free energy, the
    model and the wind disturbance. The first model comes 4 to 10 s after take-off. Oscillation, motors, vibration,
    battery and the autopilot's warnings are watched from take-off on; alarms are in red.

    Nothing is sent without --request-rate; with it, the former message rates are restored at the end. Ctrl-C, SIGTERM
    and SIGHUP end it and write the model; a second one changes nothing.

    The exit code is 0 with a model, 1 without one, also if nothing took off, and 2 if a file could not be written
    completely. --json prints its document in each case.

    \b
    Examples:
      mavdem live udpin:127.0.0.1:14550
      mavdem live udpin:127.0.0.1:14550 --request-rate 100 --record flight.tlog
      mavdem live /dev/ttyUSB0,57600 --rrd flight.rrd

    \b
    Without a vehicle, in two terminals:
      mavdem live udpin:127.0.0.1:14550 --rrd flight.rrd
      mavdem fly iris_multisine --udp 127.0.0.1:14550
    """
    model, html = _at_end(rrd, record, model, html)
    earlier = None if prior is None else earlier_flight(prior, axis)
    stream = LiveStream(axis, vehicle, rates_requested=request_rate is not None)
    with suppress(Unreadable):  # a model without its report knows no drag
        stream.wind.earlier_drag = None if prior is None else earlier_drag(prior)
    with ExitStack() as signals, ExitStack() as ends:
        opened = Link(link)
        ends.callback(opened.close)
        if opened.awaits_greeting and request_rate is None:
            silent = f"{link} sends only after it has received something, and nothing is sent without --request-rate"
            raise click.BadParameter(
                f"{silent}: add that, or listen with udpin:HOST:PORT.", param_hint="LINK"
            )
        dashboard = ends.enter_context(closing(Dashboard(link, axis, rrd, serve, connect)))
        recording = None if record is None else RawRecording(record)
        executor = ends.enter_context(LearningProcess())
        shown = dashboard.open, dashboard.report, _say
        session = LiveSession(
            opened,
            stream,
            settings,
            *shown,
            executor,
            recording,
            request_rate,
            earlier,
            recording_name=None if record is None else str(record),
        )
        if request_rate is not None and record is not None:
            session.gain_adviser = ends.enter_context(closing(GainAdviser(record, LearningProcess)))
        elif request_rate is not None:
            print_to_stderr("No gains will be advised: record the stream with --record FILE.tlog.")
        restored = ends.enter_context(ExitStack())
        restored.callback(session.end)
        if dashboard.advice:
            print_to_stderr(dashboard.advice)
        print_to_stderr(f"Listening on {link}; Ctrl-C ends it.")
        place = None
        if STDERR.is_terminal and not plain:
            place = Place(console=STDERR, auto_refresh=False, transient=True)
        if model is None:
            print_to_stderr(
                "The model will not be written: name a file with --model, --rrd or --record."
            )
        asked = signals.enter_context(termination_requests())
        with place or nullcontext():
            every = STATUS_SECONDS if place is None else STATUS_PERIOD
            run_session(session, asked, duration, every, StatusLines(place).show)
        account = session.time_account()
        status = session.status
        print_to_stderr("Ending takes some seconds: model, message rates and files are completed.")
        # The model first, since what follows may fail or take its time; the vehicle's rates are restored meanwhile.
        with ThreadPoolExecutor(1) as fitter:
            fitting = fitter.submit(session.final_model)
            restored.close()
        learned = None
        code = EXIT_UNSUPPORTED
        try:
            learned = fitting.result()
        except ValueError as error:
            print_to_stderr(f"There is no model: {as_clause(error)}.")
        else:
            text = learned.to_json() + "\n"
            code = EXIT_DONE if _written(model, text, "model") else EXIT_ERROR
        executor.shutdown()
        learned = session.judge_final_model(learned)
        session.report_gain_advice(is_at_end=True)
        status = replace(
            status,
            findings=session.judging.findings,
            model_judgement=session.judging.judgement,
        )
        dashboard.report(status)
        print_to_stderr(headline(status.overall_judgement.headline))
        ends.close()
        file = dashboard.file
        if file is not None and not file.complete_bytes and not file.broken:
            print_to_stderr(f"There was nothing to show, so {rrd} was not written.")
        has_page = html is None
        if html is not None:
            shown_of_flight = session.link.name, axis, session.history, status, account, learned
            has_page = _written(html, live_page(*shown_of_flight), "page")
        if as_json:
            written = {
                "rrd": str(rrd) if file is not None and file.complete_bytes else None,
                "record": recording and {"file": str(record), "frames": recording.frame_count},
                "model": str(model) if code == EXIT_DONE and model is not None else None,
                "html": str(html) if html and has_page else None,
            }
            print_json(live_document(session, status, account, written))
    lost = (
        session.intake.recording is not recording
        or not has_page
        or (file is not None and file.broken)
    )
    click.get_current_context().exit(EXIT_ERROR if lost else code)


def _at_end(
    rrd: Path | None, record: Path | None, model: Path | None, page: Path | None
) -> tuple[Path | None, Path | None]:
    """Returns where model and page are to be written, and refuses before the flight what could not be after it."""
    check_output_file(rrd, "--rrd", (".rrd",))
    check_output_file(record, "--record", tuple(STREAM_WRITERS))
    beside = rrd or record or model
    page = page or (beside and beside.with_suffix(".html"))
    model = model or (beside and beside.with_suffix(".model.json"))
    check_output_file(model, "--model", (".json",))
    check_output_file(page, "--html", (".html",))
    return model, page


def _written(path: Path | None, text: str, document: str) -> bool:
    """Writes the model or the page; returns whether nothing was lost."""
    if path is None:
        print_to_stderr(f"The {document} was not written.")
        return True
    try:
        write_text_atomically(path, text)
    except Unreadable as error:
        print_to_stderr(f"The {document} is lost: {error}")
        return False
    print_to_stderr(f"Wrote the {document} to {path}.")
    return True


def _style(*facts: Fact) -> str:
    """Red where any is bad."""
    return "bold red" if any(fact.is_bad for fact in facts) else ""


def _say(fact: Fact) -> None:
    """Prints a fact; where it is no terminal, as a line."""
    said = Text(escape_unprintable(fact.advised), _style(fact))
    with suppress(OSError):
        STDERR.print(said, soft_wrap=not STDERR.is_terminal)


class StatusLines:
    """Shows the status: in its ``place`` on a terminal, or else, in lines below each other, what is new of it.

    What is watched, or no longer is, is printed once.
    """

    def __init__(self, place: Place | None) -> None:
        self._place = place
        self._said: list[str] = []
        self._watched: NamedFacts = {}

    def show(self, session: LiveSession) -> None:
        """Shows the status of a ``session``."""
        status = session.status
        before = self._watched
        self._watched = {watched_quantities([fact]): fact for fact in status.watch_facts}
        changed = [fact for said, fact in self._watched.items() if said not in before]
        if changed:
            print_to_stderr(watched_quantities(changed))
        sentences = [
            escape_unprintable(said.text) for said in render_section("live_status", status=status)
        ]
        if self._place is None:
            new = [said for said in sentences if said not in self._said]
            self._said = sentences
            if new:
                print_to_stderr(" ".join(new))
            return
        line, *wrong = sentences
        rest = Text(
            " ".join([*wrong, watched_quantities(status.watch_facts)]),
            _style(*status.active_alarms),
        )
        rest.truncate(STDERR.width, overflow="ellipsis")
        self._place.update(Group(line, rest), refresh=True)
