"""``mavdem live``: attaches to a MAVLink link, learns while the vehicle flies, and writes model and page at the end."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import click
from click.core import ParameterSource

from mavdem.cli.console import STDERR, STDOUT
from mavdem.cli.exit_codes import EXIT_DONE, EXIT_ERROR, EXIT_UNSUPPORTED
from mavdem.cli.live_dashboard import PAGE_PORT, Dashboard, PageAddress
from mavdem.cli.live_files import (
    OutputPaths,
    gain_file_line,
    line_without_gains,
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
from mavdem.facts.session import LinkFact, SessionFact, TimeUse
from mavdem.fleet.priors import EarlierDrag, earlier_drag, earlier_flight
from mavdem.live import LiveStream
from mavdem.live.gain_advice import GainAdviser
from mavdem.live.link import Link, ReceivedPiece
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_loop import run_session
from mavdem.live.session_status import STATUS_PERIOD, SessionStatus
from mavdem.live.vehicle_selection import Component
from mavdem.live.vehicle_state import VehicleState
from mavdem.machine import LOOPBACK
from mavdem.report.fleet import kind_of_vehicle
from mavdem.report.live import closing_lines
from mavdem.report.pages.live_page import live_page
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


@dataclass(frozen=True)
class SessionPlan:
    """What the session of one vehicle is to do: whom it follows on which link, how long, and which files it writes."""

    options: LiveOptions
    """Options of ``mavdem live``."""

    link: Link
    """The link, which is open."""

    executor: LearningProcess
    """Process that learns; it is shut down unless another vehicle is to be followed."""

    paths: OutputPaths
    """Files that the session writes."""

    vehicle: str | None
    """Name of the vehicle to follow; None for the only one on the link."""

    duration: float | None
    """Seconds until the end; None for no limit."""

    former_flight: FollowedFlight | None = None
    """Flight of the vehicle before, in whose recording this one's first messages are; None for none."""


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
    model, the wind and the free energy. The first model comes 3 to 20 s after take-off. Oscillation, motors, vibration,
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
    end_time = inf if duration is None else monotonic() + duration
    further_codes = []
    # The process that learns starts first: it may be a fork, which keeps open what was open before.
    with LearningProcess() as executor, closing(Link(link)) as opened_link:
        if request_rate is None:
            _refuse_silent_link(opened_link, link)
        first_plan = SessionPlan(options, opened_link, executor, paths, vehicle, duration)
        first_flight = _follow_vehicle(first_plan)
        flights = [first_flight]
        try:
            for flight in _further_flights(first_plan, named_paths, first_flight, end_time):
                flights.append(flight)
        except Unreadable as error:
            print_to_stderr(f"The next vehicle cannot be followed: {as_clause(error)}.")
            further_codes.append(EXIT_ERROR)
    if as_json:
        print_json(_json_document(flights))
    codes = [*(flight.code for flight in flights), *further_codes]
    click.get_current_context().exit(_exit_code(codes))


def _exit_code(codes: Sequence[int]) -> int:
    """Returns the exit code of the command: a file that could not be written decides, then a flight with a model.

    Args:
        codes: ``EXIT_ERROR``, ``EXIT_DONE`` or ``EXIT_UNSUPPORTED`` of each followed vehicle.
    """
    for code in (EXIT_ERROR, EXIT_DONE):
        if code in codes:
            return code
    return EXIT_UNSUPPORTED


def _further_flights(
    first_plan: SessionPlan,
    named_paths: Sequence[Path | None],
    first_flight: FollowedFlight,
    end_time: float,
) -> Iterator[FollowedFlight]:
    """Follows further vehicles, one after the other, as long as each session names the vehicle to follow next.

    Args:
        first_plan: What was done in the session of the first vehicle.
        named_paths: Paths that the user named for the files of the first vehicle; None for a file that is not named.
        first_flight: How the session of the first vehicle ended.
        end_time: When the command is to end, s of the monotonic clock; infinite for no limit.

    Yields:
        How the session of each further vehicle ended.

    Raises:
        Unreadable: The files of a vehicle cannot be created.
    """
    # The earlier model is of the first vehicle.
    options = replace(first_plan.options, earlier_model=None, prior=None)
    flight = first_flight
    number = 1
    while flight.next_vehicle is not None:
        remaining_seconds = end_time - monotonic()
        if remaining_seconds <= 0:
            return
        number = unused_number(named_paths, number + 1)
        plan = replace(
            first_plan,
            options=options,
            paths=numbered_paths(named_paths, number),
            vehicle=flight.next_vehicle,
            duration=None if remaining_seconds == inf else remaining_seconds,
            former_flight=flight,
        )
        flight = _follow_vehicle(plan)
        yield flight


def _follow_vehicle(plan: SessionPlan) -> FollowedFlight:
    """Runs the session of one vehicle, until the user ends it or another vehicle is to be followed; writes its files.

    The session is prepared and run; then its model is learned and judged, and the results are reported. Last come the
    files, when the dashboard is closed.

    Args:
        plan: The vehicle, the link, the files, and the options of ``mavdem live``.

    Returns:
        The exit code and the document of this session, and what the next one is to follow.

    Raises:
        Unreadable: A file cannot be created, or the first messages cannot be moved to the recording of this session.
    """
    options = plan.options
    paths = plan.paths
    # The handlers of signals outlast the resources, so that Ctrl-C cannot prevent the files from being completed.
    with ExitStack() as signal_handlers, ExitStack() as resources:
        dashboard = resources.enter_context(closing(_open_dashboard(options, paths.rrd)))
        # With --json, standard output has the document and nothing else.
        status_lines = StatusLines(console=STDERR if options.as_json else STDOUT)
        session = _new_session(plan, dashboard, status_lines)
        recording = session.intake.recording
        if paths.record is not None:
            session.gain_adviser = resources.enter_context(
                closing(GainAdviser(paths.record, LearningProcess))
            )
        # The end of the session restores the vehicle's message rates, and must come even if something fails before.
        session_end = resources.enter_context(ExitStack())
        session_end.callback(session.end)
        is_end_requested = signal_handlers.enter_context(termination_requests())
        # Ctrl-C ends the session in order from here on.
        _print_introduction(options, paths, dashboard)
        _run_and_show_status(
            session,
            status_lines,
            lambda: is_end_requested() or session.successor is not None,
            plan.duration,
            plain=options.plain,
        )
        # Where the user ends it, no other session follows.
        successor = None if is_end_requested() else session.successor
        shown_session = _ShownSession(session, dashboard, status_lines)
        if successor is None:
            session.analyse_rest()
            session.intake.record_rest()
        results = _results_at_end(
            shown_session, session_end, plan.executor, paths.model, is_last=successor is None
        )
        # The page is the last one of the server, which ends before the files are complete.
        file_lines = _file_lines(
            _expected_paths(paths, results, recording), results, recording, is_for_browser=True
        )
        dashboard.report(session, results.status, file_lines)
        resources.close()
        written_paths = _paths_without_page(paths, dashboard, results, recording)
        page_lines = _file_lines(written_paths, results, recording)
        if _write_page(paths.page, options.axis, session, results, page_lines):
            written_paths = replace(written_paths, page=paths.page)
        _print_conclusions(shown_session, results, written_paths, recording)
        document = None
        if options.as_json:
            files = written_files(written_paths, recording)
            document = live_document(session, results.status, results.seconds_by_use, files)
        is_ended_by_user = is_end_requested()
    # The session gives up a recording of the stream that it cannot write.
    is_stream_lost = session.intake.recording is not recording
    is_page_lost = written_paths.page != paths.page
    is_file_lost = is_stream_lost or is_page_lost or dashboard.is_recording_broken
    return FollowedFlight(
        EXIT_ERROR if is_file_lost else results.model_code,
        document,
        recording=None if is_stream_lost else recording,
        vehicle=session.stream.followed_vehicle,
        next_vehicle=None if successor is None or is_ended_by_user else successor.name,
    )


class _ShownSession(NamedTuple):
    """A live session, and what shows it."""

    session: LiveSession
    """The session of one vehicle."""

    dashboard: Dashboard
    """Shows it on a display or in browsers."""

    status_lines: StatusLines
    """Shows it as lines on the terminal."""


class _SessionResults(NamedTuple):
    """What a session has found, once it is over."""

    status: SessionStatus
    """The status with the final judgement."""

    judged_model: Learned | None
    """The model of the whole flight; None without one, or if it was not judged."""

    model_code: int
    """Exit code of the command as far as the model decides it."""

    model_path: Path | None
    """File of the model; None if it was not written."""

    seconds_by_use: Mapping[TimeUse, float]
    """How many seconds of the session each use of time took, such as learning."""


def _open_dashboard(options: LiveOptions, rrd: Path | None) -> Dashboard:
    """Opens the dashboard, which shows a session on a display, in browsers and in a recording.

    Args:
        options: Options of ``mavdem live``.
        rrd: Recording for Rerun; None for none.

    Raises:
        Unreadable: A port is taken, or a file cannot be written.
    """
    return Dashboard(
        options.link,
        options.axis,
        rrd,
        address=options.address,
        connect=options.connect,
        is_plain=options.plain,
    )


def _results_at_end(
    shown_session: _ShownSession,
    session_end: ExitStack,
    executor: LearningProcess,
    model_path: Path | None,
    *,
    is_last: bool,
) -> _SessionResults:
    """Learns and judges the model of the whole flight, writes it, and reports what the session has found.

    Args:
        shown_session: The session, which receives nothing any more.
        session_end: Restores the vehicle's message rates, and ends the recording of the stream, when it is closed.
        executor: Process that learns; the last session shuts it down.
        model_path: File of the model; None to write none.
        is_last: Whether no other vehicle is to be followed. Otherwise that one may be in the air: nobody waits for
            advice on the gains of this one.
    """
    session, dashboard, status_lines = shown_session
    seconds_by_use = session.time_account()
    status = session.status
    _announce_end(session, dashboard)
    learned, no_model_reason = _final_model(session, session_end)
    # The model is written first, since what follows may fail or take its time.
    model_code = _write_model(learned, model_path)
    if is_last:
        executor.shutdown()
    judged_model = session.judge_final_model(learned)
    status = _report_results(session, status, judged_model, status_lines, advises_gains=is_last)
    if no_model_reason:
        # A pilot reads the verdicts first.
        print_to_stderr(no_model_reason)
    written_model_path = model_path if model_code == EXIT_DONE else None
    return _SessionResults(status, judged_model, model_code, written_model_path, seconds_by_use)


def _expected_paths(
    paths: OutputPaths, results: _SessionResults, recording: RawRecording | None
) -> OutputPaths:
    """Returns the files of a session that will be complete when it has ended, for its last page in a browser.

    Args:
        paths: Files that the session was to write.
        results: What it has found; without a model there is no file of the model.
        recording: Recording of the raw stream; None for none. An empty one will be deleted.
    """
    return replace(
        paths,
        rrd=None,
        record=paths.record if _frame_count(recording) else None,
        model=results.model_path,
    )


def _paths_without_page(
    paths: OutputPaths,
    dashboard: Dashboard,
    results: _SessionResults,
    recording: RawRecording | None,
) -> OutputPaths:
    """Returns which recordings and model a session has written, before its page is.

    Args:
        paths: Files that the session was to write.
        dashboard: Has written the recording for Rerun, and is closed.
        results: What the session has found; without a model there is no file of the model.
        recording: Recording of the raw stream, which is closed; None for none.
    """
    return OutputPaths(
        rrd=_written_rerun_recording(paths.rrd, dashboard),
        record=_written_raw_recording(paths.record, recording),
        model=results.model_path,
        page=None,
    )


def _write_page(
    path: Path | None,
    axis: str,
    session: LiveSession,
    results: _SessionResults,
    file_lines: Sequence[str],
) -> bool:
    """Writes the page on a session, and returns whether it was written.

    Args:
        path: File of the page; None to write none.
        axis: Axis that is modelled.
        session: The session, which has ended.
        results: What it has found.
        file_lines: A sentence on each other file that it has written.
    """
    if path is None:
        return False
    page = live_page(
        session.link.name,
        axis,
        session.history,
        results.status,
        results.seconds_by_use,
        results.judged_model,
        files=file_lines,
    )
    return write_text(path, page, "page")


def _file_lines(
    paths: OutputPaths,
    results: _SessionResults,
    recording: RawRecording | None,
    *,
    is_for_browser: bool = False,
) -> list[str]:
    """Returns a sentence on each file that a session has written, with what it is for.

    Args:
        paths: The files.
        results: What the session has found, which may forbid to fly.
        recording: Recording of the raw stream; None for none.
        is_for_browser: Whether the sentences are for the page of the session, and not for a terminal.
    """
    return written_file_lines(
        paths,
        _frame_count(recording),
        is_for_browser=is_for_browser,
        is_flight_forbidden=_is_flight_forbidden(results.status),
    )


def _frame_count(recording: RawRecording | None) -> int:
    """Returns the number of MAVLink frames in a recording; 0 without one."""
    return 0 if recording is None else recording.frame_count


def _announce_end(session: LiveSession, dashboard: Dashboard) -> None:
    """Tells the user that a session ends: on the terminal that it takes some seconds, in browsers that it is over.

    Until the files are complete, browsers must not show a flight as watched that is not watched any more.

    Args:
        session: The session, which receives nothing any more.
        dashboard: Shows the session on a display or in browsers.
    """
    lost_datagrams = session.link.dropped_datagrams
    if lost_datagrams:
        print_to_stderr(Fact(LinkFact.DATAGRAMS_LOST, count=lost_datagrams))
    print_to_stderr("Ending takes some seconds: model, message rates and files are completed.")
    dashboard.report(session, session.ending_status, is_ending=True)


def _written_rerun_recording(path: Path | None, dashboard: Dashboard) -> Path | None:
    """Returns the recording for Rerun that a session has written; None without one. An empty one is reported.

    Args:
        path: File that was to be written; None for none.
        dashboard: Has written the recording, and is closed.
    """
    if dashboard.is_recording_empty:
        print_to_stderr(f"There was nothing to show, so {path} was not written.")
    return path if dashboard.has_recording else None


def _written_raw_recording(path: Path | None, recording: RawRecording | None) -> Path | None:
    """Returns the recording of the raw stream that a session has written; an empty one is deleted, and reported.

    Args:
        path: File that was to be written; None for none.
        recording: The recording, which is closed; None for none.

    Returns:
        The path; None if nothing was to be written, or nothing was received.
    """
    is_empty = recording is not None and recording.remove_if_empty()
    if is_empty:
        print_to_stderr(f"Nothing was received, so {path} was not written.")
        return None
    return path


def _new_session(plan: SessionPlan, dashboard: Dashboard, status_lines: StatusLines) -> LiveSession:
    """Makes the session of one vehicle, and connects it with the dashboard and the terminal, which show its status.

    Args:
        plan: The vehicle, the link, the files, and the options of ``mavdem live``.
        dashboard: Shows the session on a display or in browsers.
        status_lines: Shows the status and the events as lines on the terminal.

    Raises:
        Unreadable: The first messages cannot be moved to the recording of this session.
    """
    options = plan.options
    record = plan.paths.record
    recording = None
    first_pieces: list[ReceivedPiece] = []
    if record is not None:
        recording = RawRecording(record)
        if plan.former_flight is not None:
            first_pieces = _take_over_first_frames(plan.former_flight, recording, record)
    prior_drag = None if options.prior is None else _drag_of_prior(options.prior)

    def report_status(status: SessionStatus) -> None:
        """Shows the status of the session, which calls this function about once a second while it runs."""
        if prior_drag is not None:
            _refuse_prior_of_another_vehicle(session, prior_drag, status.state)
        dashboard.report(session, status)
        status_lines.show_if_new(status)

    session = LiveSession(
        link=plan.link,
        stream=_stream_with_drag(options, plan.vehicle, prior_drag),
        settings=options.settings,
        open_display=dashboard.open,
        report_status=report_status,
        report_event=status_lines.print_event,
        executor=plan.executor,
        recording=recording,
        requested_rate=options.request_rate,
        prior=options.earlier_model,
        recording_name=None if record is None else str(record),
        keeps_vehicle=options.keeps_vehicle,
        first_pieces=first_pieces,
    )
    return session


def _print_introduction(options: LiveOptions, paths: OutputPaths, dashboard: Dashboard) -> None:
    """Prints before a session what it will not do without further options, where it is shown, and how to end it.

    Args:
        options: Options of ``mavdem live``.
        paths: Files that the session writes.
        dashboard: Shows the session on a display or in browsers.
    """
    if paths.record is None and options.request_rate is not None:
        print_to_stderr("No gains will be advised: record the stream with --record FILE.tlog.")
    if dashboard.advice:
        print_to_stderr(dashboard.advice)
    if paths.model is None:
        print_to_stderr(
            "The model will not be written: name a file with --model, --rrd or --record."
        )
    print_to_stderr(f"Listening on {options.link}; Ctrl-C ends it.")
    print_sign_in_link(dashboard.sign_in_link)


def _take_over_first_frames(
    former_flight: FollowedFlight, recording: RawRecording, path: Path
) -> list[ReceivedPiece]:
    """Moves the first frames of a vehicle from the recording of the vehicle before it to its own recording.

    They came while the session before still waited for its silent vehicle, and recorded all that the link received.

    Args:
        former_flight: Flight of the vehicle before, whose recording ends with these frames.
        recording: The vehicle's own recording, which is empty.
        path: File of that recording, which is deleted if the frames cannot be moved.

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


def _json_document(flights: Sequence[FollowedFlight]) -> LiveDocument:
    """Returns the one JSON document that --json prints for all flights of a run.

    It is the document of the last flight, with a list of those of the flights before under the key "earlier".

    Args:
        flights: The flights in their order, each of another vehicle than the one before; at least one. Each has its
            document, since --json was given.
    """
    documents = []
    for flight in flights:
        document = flight.document
        assert document is not None
        if flight.recording is not None:
            # The count changed when the frames of the next vehicle were moved out of the recording.
            document = document.with_frames(flight.recording.frame_count)
        documents.append(document)
    last_document = documents[-1]
    earlier_documents = documents[:-1]
    if not earlier_documents:
        return last_document
    return last_document.model_copy(update={"earlier": earlier_documents})


def _drag_of_prior(prior: Path) -> EarlierDrag | None:
    """Returns the drag of the vehicle in an earlier flight, by which wind is estimated; None if it was not stored.

    Args:
        prior: File or folder of the model of that flight, beside which a report has the drag.
    """
    with suppress(Unreadable):
        return earlier_drag(prior)
    return None


def _stream_with_drag(
    options: LiveOptions, vehicle: str | None, prior_drag: EarlierDrag | None
) -> LiveStream:
    """Returns the stream of a vehicle's messages, with the drag of an earlier flight if that is known.

    Args:
        options: Options of ``mavdem live``.
        vehicle: Name of the vehicle; None for the first that is found.
        prior_drag: Drag of the earlier flight; None where it is not known.
    """
    stream = LiveStream(options.axis, vehicle, rates_requested=options.request_rate is not None)
    if prior_drag is not None:
        stream.wind.earlier_drag = prior_drag.drag
    return stream


def _refuse_prior_of_another_vehicle(
    session: LiveSession, prior_drag: EarlierDrag, state: VehicleState | None
) -> None:
    """Refuses the earlier flight of --prior if its vehicle has another autopilot or frame than the followed one.

    Names do not decide: while parameters are still coming, a vehicle has another name than in its logs.

    Args:
        session: The session, whose user gave the flight.
        prior_drag: Drag of the earlier flight, with its vehicle.
        state: State of the followed vehicle, with its autopilot and frame; None until it has sent them.
    """
    is_refused_already = session.stream.wind.earlier_drag is None
    if state is None or is_refused_already:
        return
    unknown_name = ""
    if prior_drag.is_of_another_vehicle(unknown_name, state.autopilot, state.frame):
        kinds = (
            kind_of_vehicle(prior_drag.autopilot, prior_drag.frame),
            kind_of_vehicle(state.autopilot, state.frame),
        )
        session.refuse_prior(Fact(SessionFact.PRIOR_OF_OTHER_VEHICLE, names=kinds))


def _refuse_silent_link(link: Link, name: str) -> None:
    """Refuses a link whose other end sends only after it has received something, for a session that sends nothing.

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
        # Otherwise the terminal would be empty while libraries are loaded, which takes seconds.
        status_lines.show(session)
        period = STATUS_PERIOD
    try:
        run_session(session, is_end_requested, duration, period, status_lines.show)
    finally:
        status_lines.stop_in_place()


def _final_model(session: LiveSession, session_end: ExitStack) -> tuple[Learned | None, str]:
    """Learns the model of the whole session while the vehicle's message rates are restored.

    Both take seconds, and are done at the same time: the rates are restored over the link by this thread, and the model
    is learned by another one.

    Args:
        session: The session, whose flight is over.
        session_end: Restores the rates, and ends the recording of the stream, when it is closed.

    Returns:
        The model and an empty text; or None and a sentence that says why there is no model.
    """
    with ThreadPoolExecutor(max_workers=1) as learning_thread:
        learning = learning_thread.submit(session.final_model)
        session_end.close()
    try:
        return learning.result(), ""
    except ValueError as error:
        no_model_reason = f"There is no model: {as_clause(error)}."
        return None, no_model_reason


def _write_model(learned: Learned | None, path: Path | None) -> int:
    """Writes the final model to its file, and returns the exit code of the command as far as the model decides it.

    Args:
        learned: The model; None if none was learned.
        path: The file; None to write none, which is no failure.
    """
    if learned is None:
        return EXIT_UNSUPPORTED
    is_written = write_text(path, learned.to_json() + "\n", "model")
    return EXIT_DONE if is_written else EXIT_ERROR


def _report_results(
    session: LiveSession,
    status: SessionStatus,
    judged_model: Learned | None,
    status_lines: StatusLines,
    *,
    advises_gains: bool,
) -> SessionStatus:
    """Reports what the flight has shown and, if wanted, which gains to set; then prints the closing lines.

    Args:
        session: The session, which has ended.
        status: The status at its end.
        judged_model: The model of the whole flight; None without one, or if it was not judged.
        status_lines: Shows the reports and the closing lines.
        advises_gains: Whether to wait for advice on gains.

    Returns:
        The status with the final judgement.
    """
    status = _with_final_judgement(status, session)
    # What is known is reported before the gains, which may take a minute.
    session.report_end(status, judged_model)
    if advises_gains:
        session.report_gain_advice(is_at_end=True)
    # For the advice on gains the recording of the flight is reviewed, whose judgement replaces the one from before.
    status = _with_final_judgement(status, session)
    for line in closing_lines(status):
        status_lines.print_closing_line(escape_unprintable(line))
    return status


def _is_flight_forbidden(status: SessionStatus) -> bool:
    """Returns whether the verdict on some flight of a session forbids to fly before a repair.

    Args:
        status: The status of the session at its end.
    """
    return any(verdict.judgement.headline.forbids_flight for verdict in status.verdicts)


def _print_conclusions(
    shown_session: _ShownSession,
    results: _SessionResults,
    written_paths: OutputPaths,
    recording: RawRecording | None,
) -> None:
    """Prints the last lines of a session: the files that it has written, and why there are no gains.

    Args:
        shown_session: The session, which has ended, and what shows it.
        results: What it has found, with the verdicts (judgements) on all flights.
        written_paths: The files that were written.
        recording: The recording of the raw stream; None for none.
    """
    status_lines = shown_session.status_lines
    for line in _file_lines(written_paths, results, recording):
        status_lines.print_conclusion(escape_unprintable(line), FILE_MARKER)
    session = shown_session.session
    advice = None if session.gain_adviser is None else session.gain_adviser.facts
    is_flight_forbidden = _is_flight_forbidden(results.status)
    file_line = gain_file_line(advice or (), is_flight_forbidden=is_flight_forbidden)
    if file_line:
        status_lines.print_conclusion(escape_unprintable(file_line), FILE_MARKER)
    gain_line = line_without_gains(
        advice, results.seconds_by_use, is_recording_cut=session.intake.is_recording_cut
    )
    if gain_line:
        status_lines.print_conclusion(escape_unprintable(gain_line))


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
