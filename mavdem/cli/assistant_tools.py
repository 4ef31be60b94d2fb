"""The tools that ``mavdem mcp`` offers to an assistant: the commands' JSON documents, and any field of a log.

They only read: results are written to temporary folders that go again, and nothing is sent to a vehicle or elsewhere.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcp.server.mcpserver import Context, MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.types import CallToolResult, InputRequiredResult, ToolAnnotations
from pydantic import ValidationError

from mavdem import __version__
from mavdem.cli.exit_codes import EXIT_DONE, EXIT_UNSUPPORTED
from mavdem.containers import JsonValues
from mavdem.dataset.flights import choose_vehicle
from mavdem.errors import NotLearnable, Unreadable, error_message
from mavdem.export.fields import FieldSamples, field_samples, message_names, numeric_messages
from mavdem.ingest import Telemetry, read_log
from mavdem.ingest.all_messages import with_all_messages
from mavdem.report.numbers import listed

INSTRUCTIONS = """\
mavdem says what a multirotor's flight log shows: what happened, which of eight lights is bad, stability margins and \
gains to set, the wind, and what changed between two flights. Begin with `review`. Levels are good, watch, bad and \
unknown; a figure without an interval is not known well. Say "unknown" where mavdem does. Never say that gains were \
sent: nothing is ever sent to a vehicle."""
"""The instructions that an assistant reads about the server as a whole."""

LARGE_PARTS = ("model", "spectra")
"""Keys of a review that hold columns of numbers, a hundred thousand characters each; left out unless requested."""

MAX_SAMPLES = 500
"""Most samples of a field in one answer: some ten thousand characters, since an assistant reads numbers as text."""

MAX_LISTED_FIELDS = 2000
"""Most fields in one list of messages, some forty thousand characters: the largest logs at hand have 1600. A hostile
one of a few hundred kilobytes can define half a million."""

MAX_ERROR_CHARACTERS = 2000
"""Most characters of an error that lists what a log has instead of what was requested."""

READ_ONLY = ToolAnnotations(read_only_hint=True, open_world_hint=False)
"""What every tool is: it changes nothing, and reaches nothing but the files it is given."""


class AssistantServer(MCPServer):  # type: ignore[misc]
    """A server of tools that says in sentences which arguments a call lacks, or which do not fit."""

    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> CallToolResult | InputRequiredResult:
        """Calls a tool.

        Args:
            name: Name of the tool.
            arguments: Its arguments by name.
            context: Context of the request, as the server gives it.

        Returns:
            The tool's result.

        Raises:
            ToolError: The tool is not known or refuses, or its arguments do not fit.
        """
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            if isinstance(error.__cause__, ValidationError):
                raise ToolError(_argument_error(name, error.__cause__)) from error
            raise


def _argument_error(tool: str, error: ValidationError) -> str:
    """Returns sentences on the arguments of a tool that are missing or do not fit.

    Args:
        tool: Name of the tool that the assistant has called.
        error: Error of pydantic, which has checked the arguments.
    """
    missing_arguments = []
    sentences = []
    for problem in error.errors():
        # The path to a value within the argument, such as "parts.0".
        argument = ".".join(str(key) for key in problem["loc"])
        if problem["type"] == "missing":
            missing_arguments.append(argument)
        else:
            message = problem["msg"].removeprefix("Input ")
            sentences.append(f"{argument} {message}.")
    if missing_arguments:
        sentences.insert(0, f"{tool} needs {listed(missing_arguments)}.")
    return " ".join(sentences)


def make_server() -> MCPServer:
    """Returns a server with all tools, which serves standard input and output by its ``run()``."""
    server = AssistantServer(
        "mavdem", instructions=INSTRUCTIONS, version=__version__, log_level="ERROR"
    )
    for tool in (review, tune, wind, diff, messages, samples):
        server.tool(annotations=READ_ONLY, structured_output=False)(tool)
    return server


def review(log: str, parts: list[str] | None = None) -> JsonValues:
    """Says what happened in a flight, its headline, eight lights, what can be trusted, and the next step.

    A light is the level of one part of the vehicle or the flight, such as motors or power: good, watch, bad or unknown.

    Args:
        log: Path of a flight log: .tlog, .bin, .log, .ulg, .mcap.
        parts: Keys of the document to return, such as ["model"]; by default all but the large "model" and "spectra".

    Returns:
        The document of `mavdem review --json`, or the chosen parts of it. By default "left_out" lists the parts that
        are not returned.

    Raises:
        ToolError: The log cannot be read or judged, or the document has no such part.
    """
    document = _command_document("review", [log])
    if parts is None:
        kept_parts = {key: values for key, values in document.items() if key not in LARGE_PARTS}
        kept_parts["left_out"] = list(LARGE_PARTS)
        return kept_parts
    unknown_parts = sorted(set(parts) - set(document))
    if unknown_parts:
        names = ", ".join(unknown_parts)[:MAX_ERROR_CHARACTERS]
        raise ToolError(f"There is no {names}: choose of {', '.join(document)}.")
    return {key: document[key] for key in parts}


def tune(log: str, axis: str = "all", more: bool = False) -> JsonValues:
    """Says which stability margins the rate and attitude loops have, and which gains to set, or why none are advised.

    Args:
        log: Path of a flight log with the autopilot's parameters.
        axis: roll, pitch, yaw or all.
        more: Also raise gains of loops that have more margin than they need.

    Returns:
        The document of `mavdem tune --json`.

    Raises:
        ToolError: The log cannot be read, or no loop of it can be judged.
    """
    options = ["--axis", axis]
    if more:
        options.append("--more")
    return _command_document("tune", [log], options, has_folder=False)


def wind(log: str) -> JsonValues:
    """Estimates wind speed and direction, gusts, and the vehicle's drag.

    Args:
        log: Path of a flight log with attitude and velocity.

    Returns:
        The document of `mavdem wind --json`.

    Raises:
        ToolError: The log cannot be read, or does not show the wind.
    """
    return _command_document("wind", [log], has_folder=False)


def diff(before: str, after: str) -> JsonValues:
    """Says which figures of a vehicle differ significantly between two flights.

    Args:
        before: Path of the log of the earlier flight.
        after: Path of the log of the later flight.

    Returns:
        The document of `mavdem diff --json`.

    Raises:
        ToolError: One of the logs cannot be read, or the two cannot be compared.
    """
    return _command_document("diff", [before, after])


def messages(log: str, name: str = "", vehicle: str | None = None) -> JsonValues:
    """Lists every message of a log, as the log calls it, with its count, rate, times, numeric fields and instances.

    A list of more than 2000 fields ends there, and says how many messages of the log are not looked at.

    Args:
        log: Path of a flight log.
        name: Only messages whose name contains this text, such as "gps".
        vehicle: SYSTEM:COMPONENT, where the log has several vehicles.

    Returns:
        The "messages", and as "messages_left_out" how many were not looked at.

    Raises:
        ToolError: The log cannot be read, or has several vehicles and none was chosen.
    """
    telemetry = with_all_messages(_vehicle_messages(log, vehicle), log)
    message_list: list[JsonValues] = []
    field_count = 0
    # A hostile log may have very many messages; they are described one by one, and only until the list is full.
    for message in numeric_messages(telemetry, name):
        field_count += len(message.fields)
        if field_count > MAX_LISTED_FIELDS:
            # This message and all that follow are left out.
            all_names = message_names(telemetry, name)
            left_out_count = len(all_names) - all_names.index(message.message)
            return {"messages": message_list, "messages_left_out": left_out_count}
        message_list.append(message._asdict())
    return {"messages": message_list, "messages_left_out": 0}


def samples(
    log: str,
    message: str,
    field: str,
    instance: int | None = None,
    start: float | None = None,
    end: float | None = None,
    boot: int = 0,
    vehicle: str | None = None,
) -> JsonValues:
    """Returns one field of a log over time, with its smallest, largest and mean value.

    More samples than 500 are thinned evenly; the smallest, the largest and the mean value are of all samples.

    Args:
        log: Path of a flight log.
        message: Name of the message, as `messages` lists it, or of the MAVLink message with the same meaning.
        field: Name of the field.
        instance: Which of several equal sensors.
        start: First time, s on the autopilot's boot clock; without it the beginning.
        end: Last time, s; without it the end.
        boot: After which boot of the autopilot, from 0.
        vehicle: SYSTEM:COMPONENT, where the log has several vehicles.

    Returns:
        The values with their times, s: of all samples, every n-th one, n being "every". "count" is the number of all.

    Raises:
        ToolError: The log cannot be read, or has no such field, or no values of it in that time.
    """
    telemetry = _vehicle_messages(log, vehicle)
    time, values = _samples_of_field(telemetry, log, message, field, instance, boot)
    is_wanted = np.isfinite(values)
    if start is not None:
        is_wanted &= time >= start
    if end is not None:
        is_wanted &= time <= end
    time = time[is_wanted]
    values = values[is_wanted]
    if not values.size:
        raise ToolError(f"{message}.{field} has no values then: `messages` says from when to when.")
    # The smallest stride with which at most MAX_SAMPLES remain.
    stride = ceil(len(time) / MAX_SAMPLES)
    return {
        "message": message,
        "field": field,
        "count": len(values),
        "minimum": float(values.min()),
        "maximum": float(values.max()),
        "mean": float(values.mean(dtype=np.float64)),
        "every": stride,
        "time_s": time[::stride].round(4).tolist(),
        "values": values[::stride].tolist(),
    }


def _vehicle_messages(log: str, vehicle: str | None) -> Telemetry:
    """Returns the messages of one vehicle in a log.

    Args:
        log: Path of the log.
        vehicle: "system" or "system:component", if the log has several vehicles; None for the only one.

    Raises:
        ToolError: The log cannot be read, or has several vehicles and none was chosen.
    """
    try:
        return choose_vehicle(read_log(log).vehicles, vehicle)
    except (Unreadable, NotLearnable) as error:
        raise ToolError(str(error)) from error


def _samples_of_field(
    telemetry: Telemetry, log: str, message: str, field: str, instance: int | None, boot: int
) -> FieldSamples:
    """Returns all samples of one field of a message, by its name in the log or otherwise by its MAVLink name.

    Args:
        telemetry: The messages that mavdem translated to MAVLink.
        log: Path of the log, which has all messages under its own names.
        message: Name of the message.
        field: Name of the field.
        instance: Number of one of several equal sensors; None for all.
        boot: Number of the boot of the autopilot, from 0.

    Returns:
        Times, s since boot, and values.

    Raises:
        ToolError: There is no such message, field or instance; the error lists the fields of the log.
    """
    whole_log = with_all_messages(telemetry, log)
    source = whole_log if message in whole_log.messages else telemetry
    if message not in source.messages:
        names = ", ".join(sorted(whole_log.messages))
        raise ToolError(f"The log has no {message}: it has {names}"[:MAX_ERROR_CHARACTERS])
    try:
        return field_samples(source, message, field, instance, boot)
    except ValueError as error:
        raise ToolError(f"{error}."[:MAX_ERROR_CHARACTERS]) from error


def _command_document(
    command: str, logs: Sequence[str], options: Sequence[str] = (), *, has_folder: bool = True
) -> JsonValues:
    """Runs a command of mavdem in a new process, and parses the JSON document that it prints.

    In a new process the output of the command cannot mix with the messages to the assistant, which also use standard
    output, and the memory of the command is freed at its end.

    Args:
        command: Name of the command.
        logs: Paths of the logs.
        options: Further options of the command.
        has_folder: Whether the command writes results to a folder; they go to a temporary one.

    Returns:
        The document.

    Raises:
        ToolError: The command failed; the message is the last line of its standard error.
    """
    with TemporaryDirectory(prefix="mavdem-") as folder:
        arguments = [sys.executable, "-m", "mavdem", command, "--json"]
        if has_folder:
            arguments += ["--out", str(Path(folder, "results"))]
        # After "--" the name of a log may begin with a hyphen.
        arguments += [*options, "--", *logs]
        try:
            process = subprocess.run(
                arguments,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                check=False,
            )
        except (OSError, ValueError) as error:
            # No program can be given a name with a null character, or one of a hundred thousand characters.
            raise ToolError(f"{command} cannot be run: {error_message(error)}.") from None
    # A log from which no model can be learned has a document too.
    if process.returncode not in (EXIT_DONE, EXIT_UNSUPPORTED) or not process.stdout:
        lines = process.stderr.strip().splitlines()
        raise ToolError(lines[-1] if lines else f"mavdem {command} ended without a word.")
    document: JsonValues = json.loads(process.stdout)
    return document
