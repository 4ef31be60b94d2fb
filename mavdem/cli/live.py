"""``mavdem live``: attaches to a MAVLink link, learns while the vehicle flies, and writes model and page at the end."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

import click
from click.core import ParameterSource

from mavdem.cli.console import STDERR, STDOUT
from mavdem.cli.exit_codes import EXIT_DONE, EXIT_ERROR, EXIT_UNSUPPORTED
from mavdem.cli.live_dashboard import PAGE_PORT, Dashboard, PageAddress
from mavdem.cli.live_files import (
    OutputPaths,
    gains_line,
    numbered_paths,
    output_paths,
    unused_number,
    write_text,
    written_file_lines,
    written_files,
)
from mavdem.cli.live_lines import FILE_MARKER
from mavdem.cli.live_status import StatusLines
from mavdem.cli.options import (
    NumberRange,
    WholeNumberRange,
    file_option,
    host_option,
    json_option,
    model_options,
    token_option,
    vehicle_option,
)
from mavdem.cli.output import print_json
from mavdem.cli.sign_in_links import print_sign_in_link
from mavdem.cli.streams import escape_unprintable, print_to_stderr
from mavdem.cli.termination import termination_requests
from mavdem.dataset.axes import TILT_AXES
from mavdem.dem import Learned, Settings
from mavdem.dem.parallel import LearningProcess
from mavdem.documents.session import Live as LiveDocument
from mavdem.documents.session import live_document
from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.facts.session import LinkFact
from mavdem.fleet.priors import earlier_drag, earlier_flight
from mavdem.live import LiveStream
from mavdem.live.gain_advice import GainAdviser
from mavdem.live.link import Link, ReceivedPiece
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_loop import run_session
from mavdem.live.session_status import STATUS_PERIOD, SessionStatus
from mavdem.live.vehicle_selection import Component
from mavdem.machine import LOOPBACK
from mavdem.report.live import closing_lines
from mavdem.report.pages.flight_page import live_page
from mavdem.report.templates import as_clause

PRINTED_STATUS_PERIOD = 5.0
"""Time between two looks at the status where lines are printed below each other, s; a choice."""


@dataclass(frozen=True)
class LiveOptions:
    """Options of the command that are the same for each vehicle that is followed."""

    link: str
    """Connection string of the link."""

    axis: str
    """Axis to model."""

    settings: Settings
    """Settings of the learner."""

    earlier_model: Learned | None
    """Model of an earlier flight; None for none."""

    prior: Path | None
    """The file or folder that holds it."""

    address: PageAddress | None
    """Where browsers find the page of the session; None if none are served."""

    connect: str | None
    """URL of a Rerun viewer; None for none."""

    request_rate: float | None
    """Message rate to ask for, Hz; None to send nothing."""

    keeps_vehicle: bool
    """Whether the user has chosen the vehicle, so that no other one is followed."""

    as_json: bool
    """Whether a document of all flights is printed."""

    plain: bool
    """Whether the status is printed as lines below each other."""


@dataclass(frozen=True)
class FollowedFlight:
    """How the session of one vehicle ended."""

    code: int
    """Exit code of the command if no other session follows."""

    document: LiveDocument | None
    """Its JSON document, whose number of recorded frames is that at the end of the session; None without --json."""

    recording: RawRecording | None
    """Recording of the raw stream; None for none, and after it has failed."""

    vehicle: Component | None
    """The vehicle that was followed; None for none."""

    next_vehicle: str | None
    """Name of the vehicle to follow next; None if the command is to end."""

    def move_frames_of_next_vehicle(self, recording: RawRecording) -> list[ReceivedPiece]:
        """Moves the frames of the next vehicle from the end of this session's recording to that of the next session.

        A session waits some time after its vehicle has fallen silent. If another vehicle sends on the same link
        meanwhile, its frames are recorded too, but belong to the session of that vehicle.

        Args:
            recording: Recording of the next session, which begins with these frames.

        Returns:
            The moved frames with their times of arrival; none if this session has no complete recording.

        Raises:
            OSError: One of the files cannot be read or written; nothing is lost then.
        """
        if self.recording is None or self.vehicle is None:
            return []
        return self.recording.move_after(self.vehicle.system, self.vehicle.component, recording)


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
    help="Show it in browsers on this machine, which load nothing from elsewhere.",
)
@host_option
@click.option(
    "--port",
    type=WholeNumberRange(0, 65535),
    help=f"Port of --serve. [default: {PAGE_PORT}, or a free one while another session has that]",
)
@token_option("Secret that browsers of --serve need")
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
    help="Print lines below each other on standard output, as without a terminal: events, and a short status.",
)
def live_command(
    link: str,
    axis: str,
    vehicle: str | None,
    as_json: bool,
    settings: Settings,
    rrd: Path | None,
    serve: bool,
    host: str,
    port: int | None,
    token: str,
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
    serial port such as /dev/ttyACM0,115200. A dashboard shows the measured and the predicted roll, the motors, the
    model, the wind and the free energy. The first model comes 3 to 10 s after take-off. Oscillation, motors, vibration,
    battery and the autopilot's warnings are watched from take-off on; alarms are in red.

    Nothing is sent without --request-rate; with it, the former message rates are restored at the end. Ctrl-C, SIGTERM
    and SIGHUP end it and write the model; a second one changes nothing.

    If the vehicle is silent for 10 s while another one sends, its files are written and the other one is followed, with
    files of its own: flight-2.tlog. With --vehicle none but that one is followed.

    The exit code is 0 with a model, 1 without one, also if nothing took off, and 2 if a file could not be written
    completely. --json prints one document in each case: of the last vehicle, with those before under "earlier".

    \b
    Examples:
      mavdem live udpin:127.0.0.1:14550
      mavdem live udpin:127.0.0.1:14550 --request-rate 100 --record flight.tlog
      MAVDEM_TOKEN=$(openssl rand -hex 16) mavdem live udpin:127.0.0.1:14550 --serve --host 0.0.0.0
      mavdem live /dev/ttyUSB0,57600 --rrd flight.rrd

    \b
    Without a vehicle, in two terminals:
      mavdem live udpin:127.0.0.1:14550 --rrd flight.rrd
      mavdem fly iris_multisine --udp 127.0.0.1:14550
    """
    # A token in the environment may be there for other commands.
    token_source = click.get_current_context().get_parameter_source("token")
    names_token = token_source is ParameterSource.COMMANDLINE
    names_address = port is not None or host != LOOPBACK
    if (names_address or names_token) and not serve:
        raise click.UsageError("--host, --port and --token are those of --serve: add that.")
    options = LiveOptions(
        link=link,
        axis=axis,
        settings=settings,
        earlier_model=None if prior is None else earlier_flight(prior, axis),
        prior=prior,
        address=PageAddress(host, port, token) if serve else None,
        connect=connect,
        request_rate=request_rate,
        keeps_vehicle=vehicle is not None,
        as_json=as_json,
        plain=plain,
    )
    named_paths = (rrd, record, model, html)
    paths = output_paths(*named_paths)
    start_time = monotonic()
    number = 1
    is_next_refused = False
    # The process that learns starts first: it may be a fork, which keeps open what was open before.
    with LearningProcess() as executor, closing(Link(link)) as opened_link:
        if request_rate is None:
            _refuse_silent_link(opened_link, link)
        flight = _follow_vehicle(options, paths, opened_link, executor, vehicle, None, duration)
        flights = [flight]
        while flight.next_vehicle is not None:
            remaining_seconds = None if duration is None else duration - (monotonic() - start_time)
            if remaining_seconds is not None and remaining_seconds <= 0:
                break
            # The earlier model is of the first vehicle.
            options = replace(options, earlier_model=None, prior=None)
            number = unused_number(named_paths, number + 1)
            try:
                flight = _follow_vehicle(
                    options,
                    numbered_paths(named_paths, number),
                    opened_link,
                    executor,
                    flight.next_vehicle,
                    flight,
                    remaining_seconds,
                )
            except Unreadable as error:
                print_to_stderr(f"The next vehicle cannot be followed: {as_clause(error)}.")
                is_next_refused = True
                break
            flights.append(flight)
    if as_json:
        print_json(_document_of_flights(flights))
    codes = [flight.code for flight in flights]
    if is_next_refused:
        codes.append(EXIT_ERROR)
    worst_first = (EXIT_ERROR, EXIT_DONE, EXIT_UNSUPPORTED)
    click.get_current_context().exit(next(code for code in worst_first if code in codes))


def _follow_vehicle(
    options: LiveOptions,
    paths: OutputPaths,
    link: Link,
    executor: LearningProcess,
    vehicle: str | None,
    former_flight: FollowedFlight | None,
    duration: float | None,
) -> FollowedFlight:
    """Runs the session of one vehicle, until the user ends it or another vehicle is to be followed; writes its files.

    Args:
        options: Options of ``mavdem live``.
        paths: Files that the session writes.
        link: Link that is open.
        executor: Process that learns; it is shut down unless another vehicle is to be followed.
        vehicle: Name of the vehicle to follow; None for the only one on the link.
        former_flight: Flight of the vehicle before, in whose recording this one's first messages are; None for none.
        duration: Seconds until the end; None for no limit.

    Returns:
        The exit code and the document of this session, and what the next one is to follow.

    Raises:
        Unreadable: A file cannot be created, or the first messages cannot be moved to the recording of this session.
    """
    stream = _stream_with_prior(options, vehicle)
    # The handlers of signals outlast the resources, so that Ctrl-C cannot prevent the files from being completed.
    with ExitStack() as signal_handlers, ExitStack() as resources:
        dashboard = resources.enter_context(
            closing(
                Dashboard(
                    options.link,
                    options.axis,
                    paths.rrd,
                    address=options.address,
                    connect=options.connect,
                    is_plain=options.plain,
                )
            )
        )
        record = paths.record
        recording = None if record is None else RawRecording(record)
        first_pieces: list[ReceivedPiece] = []
        if former_flight is not None and recording is not None and record is not None:
            first_pieces = _moved_first_frames(former_flight, recording, record)
        # With --json, standard output has the document and nothing else.
        console = STDERR if options.as_json else STDOUT
        status_lines = StatusLines(console=console)

        def report_status(status: SessionStatus) -> None:
            dashboard.report(session, status)
            status_lines.show_if_new(status)

        session = LiveSession(
            link=link,
            stream=stream,
            settings=options.settings,
            open_display=dashboard.open,
            report_status=report_status,
            report_event=status_lines.print_event,
            executor=executor,
            recording=recording,
            requested_rate=options.request_rate,
            prior=options.earlier_model,
            recording_name=None if record is None else str(record),
            keeps_vehicle=options.keeps_vehicle,
            first_pieces=first_pieces,
        )
        if record is not None:
            session.gain_adviser = resources.enter_context(
                closing(GainAdviser(record, LearningProcess))
            )
        elif options.request_rate is not None:
            print_to_stderr("No gains will be advised: record the stream with --record FILE.tlog.")
        # The end of the session restores the vehicle's message rates, and must come even if something fails before.
        session_end = resources.enter_context(ExitStack())
        session_end.callback(session.end)
        if dashboard.advice:
            print_to_stderr(dashboard.advice)
        if paths.model is None:
            print_to_stderr(
                "The model will not be written: name a file with --model, --rrd or --record."
            )
        is_end_requested = signal_handlers.enter_context(termination_requests())
        # Ctrl-C ends the session in order from here on.
        print_to_stderr(f"Listening on {options.link}; Ctrl-C ends it.")
        print_sign_in_link(dashboard.sign_in_link)
        _run_and_show_status(
            session,
            status_lines,
            lambda: is_end_requested() or session.successor is not None,
            duration,
            plain=options.plain,
        )
        # Where the user ends it, no other session follows.
        successor = None if is_end_requested() else session.successor
        if successor is None:
            session.intake.record_rest()
        account = session.time_account()
        status = session.status
        dropped_datagrams = link.dropped_datagrams
        if dropped_datagrams:
            print_to_stderr(Fact(LinkFact.DATAGRAMS_LOST, count=dropped_datagrams))
        print_to_stderr("Ending takes some seconds: model, message rates and files are completed.")
        learned = _final_model(session, session_end)
        # The model is written first, since what follows may fail or take its time.
        code = EXIT_UNSUPPORTED
        if learned is not None:
            is_model_kept = write_text(paths.model, learned.to_json() + "\n", "model")
            code = EXIT_DONE if is_model_kept else EXIT_ERROR
        if successor is None:
            executor.shutdown()
        judged_model = session.judge_final_model(learned)
        # What is known is reported before the gains, which may take a minute. The judgement comes last, since it is
        # that of the recording where gains were advised.
        status = _with_final_judgement(status, session)
        session.report_end(status, judged_model)
        if successor is None:
            # Another vehicle may be in the air: nobody waits for advice on the gains of the one before.
            session.report_gain_advice(is_at_end=True)
        status = _with_final_judgement(status, session)
        for line in closing_lines(status):
            status_lines.print_closing_line(escape_unprintable(line))
        dashboard.report(session, status)
        resources.close()
        if dashboard.is_recording_empty:
            print_to_stderr(f"There was nothing to show, so {paths.rrd} was not written.")
        if recording is not None and recording.remove_if_empty():
            print_to_stderr(f"Nothing was received, so {record} was not written.")
            record = None
        is_page_lost = False
        if paths.page is not None:
            page = live_page(
                link.name, options.axis, session.history, status, account, judged_model
            )
            is_page_lost = not write_text(paths.page, page, "page")
        written_paths = OutputPaths(
            rrd=paths.rrd if dashboard.has_recording else None,
            record=record,
            model=paths.model if code == EXIT_DONE else None,
            page=None if is_page_lost else paths.page,
        )
        frame_count = 0 if recording is None else recording.frame_count
        for line in written_file_lines(written_paths, frame_count):
            status_lines.print_conclusion(escape_unprintable(line), FILE_MARKER)
        advice = None if session.gain_adviser is None else session.gain_adviser.facts
        has_gain_files = any(fact.code is GainFact.GAINS_WRITTEN for fact in advice or ())
        is_flight_forbidden = any(
            verdict.judgement.headline.forbids_flight for verdict in status.verdicts
        )
        line_on_gains = gains_line(advice, account, is_flight_forbidden=is_flight_forbidden)
        status_lines.print_conclusion(
            escape_unprintable(line_on_gains), FILE_MARKER if has_gain_files else ""
        )
        files = written_files(written_paths, recording)
        document = live_document(session, status, account, files) if options.as_json else None
        is_ended_by_user = is_end_requested()
    # The session gives up a recording of the stream that it cannot write.
    is_stream_lost = session.intake.recording is not recording
    if is_stream_lost or is_page_lost or dashboard.is_recording_broken:
        code = EXIT_ERROR
    return FollowedFlight(
        code,
        document,
        recording=None if is_stream_lost else recording,
        vehicle=session.stream.followed_vehicle,
        next_vehicle=None if successor is None or is_ended_by_user else successor.name,
    )


def _moved_first_frames(
    former_flight: FollowedFlight, recording: RawRecording, path: Path
) -> list[ReceivedPiece]:
    """Moves the first frames of a vehicle from the recording of the vehicle before to its own.

    Args:
        former_flight: Flight of the vehicle before, at the end of whose recording these frames are.
        recording: The new, empty recording of the vehicle.
        path: Its file, which is deleted if the frames cannot be moved.

    Returns:
        The frames with their times of arrival.

    Raises:
        Unreadable: One of the files cannot be read or written.
    """
    try:
        return former_flight.move_frames_of_next_vehicle(recording)
    except OSError as error:
        recording.close()
        path.unlink()
        raise Unreadable(
            LinkFact.STREAM_FILE_FAILED, path=path, error=error_message(error)
        ) from None


def _document_of_flights(flights: Sequence[FollowedFlight]) -> LiveDocument:
    """Returns the JSON document of the last flight, with those before it as earlier ones.

    Args:
        flights: Flights of one vehicle after the other, at least one, each with its document.
    """
    documents = []
    for flight in flights:
        # Each flight has a document if --json was given.
        document = flight.document
        assert document is not None
        if flight.recording is not None:
            # The frames of the next vehicle were moved out of the recording after the document was made.
            document = document.with_frames(flight.recording.frame_count)
        documents.append(document)
    last_document = documents.pop()
    if not documents:
        return last_document
    return last_document.model_copy(update={"earlier": documents})


def _stream_with_prior(options: LiveOptions, vehicle: str | None) -> LiveStream:
    """Returns the stream of a vehicle's messages, with the drag of an earlier flight if that is known.

    Args:
        options: Options of ``mavdem live``.
        vehicle: Name of the vehicle; None for the first that is found.
    """
    stream = LiveStream(options.axis, vehicle, rates_requested=options.request_rate is not None)
    if options.prior is not None:
        # The drag is in the report, in the folder of the model; there may be none.
        with suppress(Unreadable):
            stream.wind.earlier_drag = earlier_drag(options.prior).drag
    return stream


def _refuse_silent_link(link: Link, name: str) -> None:
    """Checks that data will arrive on a link to which nothing is sent.

    Args:
        link: Connection to the vehicle: UDP, TCP or serial.
        name: Its connection string.

    Raises:
        click.BadParameter: The other end sends only after it has received something.
    """
    if link.awaits_greeting:
        raise click.BadParameter(
            f"{name} sends only after it has received something, and nothing is sent without --request-rate: "
            "add that, or listen with udpin:HOST:PORT.",
            param_hint="LINK",
        )


def _run_and_show_status(
    session: LiveSession,
    status_lines: StatusLines,
    is_end_requested: Callable[[], bool],
    duration: float | None,
    *,
    plain: bool,
) -> None:
    """Runs a session until its end, and shows its status.

    On a terminal the status is updated in place on standard error, every ``STATUS_PERIOD``. Elsewhere, for example in a
    file, each status adds lines, so that it is looked at only every ``PRINTED_STATUS_PERIOD``.

    Args:
        session: The live session: its link, the vehicle and the model that it learns.
        status_lines: Shows the status.
        is_end_requested: Function that returns whether the user has requested the end.
        duration: Seconds until the end; None for no limit.
        plain: Whether the status is printed as lines below each other even on a terminal.
    """
    period = PRINTED_STATUS_PERIOD
    if STDERR.is_terminal and not plain:
        status_lines.start_in_place()
        period = STATUS_PERIOD
    try:
        run_session(session, is_end_requested, duration, period, status_lines.show)
    finally:
        status_lines.stop_in_place()


def _final_model(session: LiveSession, session_end: ExitStack) -> Learned | None:
    """Learns the model of the whole session while the vehicle's message rates are restored.

    Both take seconds, and are done at the same time: the rates are restored over the link by this thread, and the model
    is learned by another one.

    Args:
        session: The session, whose flight is over.
        session_end: Restores the rates, and ends the recording of the stream, when it is closed.

    Returns:
        The model; None if there is none, which is reported on standard error.
    """
    with ThreadPoolExecutor(max_workers=1) as learning_thread:
        learning = learning_thread.submit(session.final_model)
        session_end.close()
    try:
        return learning.result()
    except ValueError as error:
        print_to_stderr(f"There is no model: {as_clause(error)}.")
        return None


def _with_final_judgement(status: SessionStatus, session: LiveSession) -> SessionStatus:
    """Returns the status at the end of a session, with the judgement of the model of the whole flight.

    While the vehicle flies, models of the flight so far are learned and judged. At the end a last one is learned from
    the whole flight, whose judgement replaces theirs.

    Args:
        status: The status when the vehicle had landed.
        session: The session, whose last model is judged.
    """
    return replace(
        status,
        is_over=True,
        findings=session.flight.judging.findings,
        model_judgement=session.flight.judging.judgement,
        is_recording_judged=session.flight.judging.is_of_recording,
        recording_verdict=session.recording_failure,
    )
