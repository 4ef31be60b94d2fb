"""The tools of ``mavdem mcp``, asked by a client of the protocol over standard input and output."""

import asyncio
import json
import sys

from pytest import fixture, mark
from recorded_flights import SLOW

pytestmark = mark.slow


@fixture(scope="module")
def answers():
    """What one session with the server gave: the tools by name, and the results of some calls."""
    # At the top of the file the import would take every worker of the tests half a second.
    from mcp import Client, StdioServerParameters

    # This is how an assistant starts the server.
    server = StdioServerParameters(command=sys.executable, args=["-m", "mavdem", "mcp"])
    log = str(SLOW)
    calls = {
        "messages": ("messages", {"log": log}),
        "roll": ("samples", {"log": log, "message": "ATTITUDE", "field": "roll"}),
        "no field": ("samples", {"log": log, "message": "ATTITUDE", "field": "lift"}),
        "wind": ("wind", {"log": log}),
        "no log": ("tune", {"log": "nothing.tlog"}),
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


def test_commands_answer_with_their_documents_and_reasons(answers):
    _, results = answers
    assert json.loads(results["wind"].content[0].text)["error"]["fact"]["code"] == "no_velocity"
    assert len(json.loads(results["lights"].content[0].text)["lights"]) == 8


def test_errors_are_sentences(answers):
    _, results = answers
    assert results["no field"].is_error and results["no log"].is_error
    assert "ATTITUDE has no field lift" in results["no field"].content[0].text
    assert "nothing.tlog does not exist." in results["no log"].content[0].text
