"""``mavdem mcp``: review, tune, wind, diff and any field of a log as tools for an assistant."""

import sys

import click

from mavdem.extras import require_extra


@click.command("mcp")
def mcp_command() -> None:
    """Offers logs to an assistant (Model Context Protocol).

    An assistant that speaks the protocol starts this command, and talks to it by standard input and output. It can then
    review a log, ask for margins and gains, for the wind, for what changed between two flights, and for any field. The
    answers are the documents that the commands print with --json.

    Logs are only read, those that the assistant names, with your rights. mavdem sends nothing anywhere; what your
    assistant does with the answers is up to the assistant.

    \b
    Example, in the configuration of an assistant:
      {"mcpServers": {"mavdem": {"command": "mavdem", "args": ["mcp"]}}}
    """
    require_extra("mcp", "mavdem mcp")
    from mavdem.cli.assistant_input import character_input
    from mavdem.cli.assistant_tools import make_server

    # The server takes its standard input from here.
    sys.stdin = character_input(sys.stdin)
    make_server().run()
