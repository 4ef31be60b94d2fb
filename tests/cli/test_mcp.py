"""The tools of ``mavdem mcp``, asked by a client of the protocol over standard input and output."""

import asyncio
import json
import sys
from subprocess import CompletedProcess
from unittest.mock import Mock

import dataflash_logs
import numpy as np
from pytest import fixture, mark, raises
from recorded_flights import SLOW

from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.ingest import Telemetry

pytestmark = mark.slow


@fixture(scope="module")
def answers(tmp_path_factory):
    """What one session with the server gave: the tools by name, and the results of some calls."""
    # At the top of the file the import would take every worker of the tests half a second.
    from mcp import Client, StdioServerParameters

    # This is how an assistant starts the server.
    server = StdioServerParameters(command=sys.executable, args=["-m", "mavdem", "mcp"])
    log = str(SLOW)
    dataflash = tmp_path_factory.mktemp("logs") / "flight.bin"
    times = 20 + 0.1 * np.arange(50)
    # DSF, the logger's own figures, has no message of MAVLink with its meaning.
    logger = dataflash_logs.message("DSF", 26_000_000, 7)
    dataflash.write_bytes(dataflash_logs.log(*dataflash_logs.flight(times), logger))
    dataflash = str(dataflash)
    calls = {
        "messages": ("messages", {"log": log}),
        "roll": ("samples", {"log": log, "message": "ATTITUDE", "field": "roll"}),
        "no field": ("samples", {"log": log, "message": "ATTITUDE", "field": "lift"}),
        "dataflash messages": ("messages", {"log": dataflash, "name": "ds"}),
        "dropped blocks": ("samples", {"log": dataflash, "message": "DSF", "field": "Dp"}),
        "translated": ("samples", {"log": dataflash, "message": "ATTITUDE", "field": "roll"}),
        "no message": ("samples", {"log": dataflash, "message": "LIFT", "field": "roll"}),
        "no arguments": ("samples", {}),
        "no number": ("samples", {"log": log, "message": "A", "field": "b", "start": "soon"}),
        "lights": ("review", {"log": log, "parts": ["lights"]}),
    }

    async def session():
        async with Client(server) as client:
            tools = {tool.name: tool for tool in (await client.list_tools()).tools}
            results = {name: await client.call_tool(*call) for name, call in calls.items()}
            return tools, results

    return asyncio.run(session())


def test_tools_only_read_and_say_what_they_do(answers):
    tools, _ = answers
    assert set(tools) == {"review", "tune", "wind", "diff", "messages", "samples"}
    assert all(tool.annotations.read_only_hint for tool in tools.values())
    assert all(tool.description for tool in tools.values())


def test_a_field_is_found_and_summarised(answers):
    _, results = answers
    (attitude,) = [
        listed
        for listed in json.loads(results["messages"].content[0].text)["messages"]
        if listed["message"] == "ATTITUDE"
    ]
    roll = json.loads(results["roll"].content[0].text)
    assert roll["count"] == attitude["messages"]
    assert roll["minimum"] <= roll["mean"] <= roll["maximum"]
    assert len(roll["values"]) == len(roll["time_s"]) <= 500


def test_fields_that_mavdem_does_not_translate_are_offered_too(answers):
    _, results = answers
    (logger,) = json.loads(results["dataflash messages"].content[0].text)["messages"]
    assert (logger["message"], "Dp" in logger["fields"]) == ("DSF", True)
    assert json.loads(results["dropped blocks"].content[0].text)["values"] == [7.0]
    assert json.loads(results["translated"].content[0].text)["count"] == 50
    assert "The log has no LIFT: it has ATT, DSF" in results["no message"].content[0].text


def test_a_command_answers_with_its_document(answers):
    _, results = answers
    assert len(json.loads(results["lights"].content[0].text)["lights"]) == 8


def test_a_command_that_judges_nothing_has_a_document_and_one_that_fails_its_last_line(monkeypatch):
    """The process of a command ends with a document of the reason, or with lines on standard error."""
    # At the top of the file the import would take every worker of the tests half a second.
    from mcp.server.mcpserver.exceptions import ToolError

    from mavdem.cli import assistant_tools

    ended = CompletedProcess([], EXIT_UNSUPPORTED, '{"error": {"reason": "No velocity."}}', "")
    run = Mock(return_value=ended)
    monkeypatch.setattr(assistant_tools.subprocess, "run", run)
    assert assistant_tools.wind("-a.tlog") == {"error": {"reason": "No velocity."}}
    assert assistant_tools.diff("a.tlog", "b.tlog") == {"error": {"reason": "No velocity."}}
    _, _, _, wind, *wind_options = run.call_args_list[0].args[0]
    assert (wind, wind_options) == ("wind", ["--json", "--", "-a.tlog"])
    run.return_value = CompletedProcess([], 2, "", "Reading …\nmavdem: a.tlog does not exist.\n")
    with raises(ToolError, match=r"^mavdem: a\.tlog does not exist\.$"):
        assistant_tools.tune("a.tlog", more=True)
    _, _, _, tune, *tune_options = run.call_args.args[0]
    assert (tune, tune_options) == ("tune", ["--json", "--axis", "all", "--more", "--", "a.tlog"])


def test_errors_are_sentences(answers):
    _, results = answers
    assert results["no field"].is_error
    assert "ATTITUDE has no field lift" in results["no field"].content[0].text
    assert results["no arguments"].content[0].text == "samples needs log, message and field."
    error_text = results["no number"].content[0].text
    assert error_text.startswith("start should be a valid number") and "pydantic" not in error_text


def test_a_log_of_many_messages_is_described_as_far_as_it_is_listed(monkeypatch):
    """Of nine messages with three fields each, an answer of five fields at most lists two."""
    # At the top of the file the import would take every worker of the tests half a second.
    from mavdem.cli import assistant_tools

    columns = {"time": np.arange(3.0), "boot": np.zeros(3), "a": np.ones(3), "b": np.ones(3)}
    messages = {f"M{number}": columns for number in range(9)}
    vehicle = Telemetry(1, 1, "QUADROTOR", "PX4", messages)
    monkeypatch.setattr(assistant_tools, "MAX_LISTED_FIELDS", 5)
    monkeypatch.setattr(assistant_tools, "_vehicle_messages", lambda *_: vehicle)
    monkeypatch.setattr(assistant_tools, "with_all_messages", lambda telemetry, _: telemetry)
    describe = Mock(return_value=1.0)
    monkeypatch.setattr("mavdem.export.fields.rate_without_gaps", describe)
    answer = assistant_tools.messages("flight.bin", name="m")
    assert [message["message"] for message in answer["messages"]] == ["M0", "M1"]
    assert answer["messages_left_out"] == 7 and describe.call_count == 3


@mark.parametrize("name", ["a\0b.bin", "x" * 200_000])
def test_a_name_that_no_program_can_be_given_is_refused_with_the_reason(name):
    from mcp.server.mcpserver.exceptions import ToolError

    from mavdem.cli import assistant_tools

    with raises(ToolError, match=r"review cannot be run: .+\."):
        assistant_tools.review(name)


def test_an_error_does_not_repeat_very_long_arguments(monkeypatch):
    from mcp.server.mcpserver.exceptions import ToolError

    from mavdem.cli import assistant_tools

    monkeypatch.setattr(assistant_tools, "_command_document", lambda *_: {"lights": {}})
    with raises(ToolError, match="choose of lights") as refused:
        assistant_tools.review("flight.bin", parts=["x" * 100_000])
    assert len(str(refused.value)) < 3000
