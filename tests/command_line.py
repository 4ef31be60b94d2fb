"""What tests of the command line share."""

import json
import socket
import sys
from contextlib import suppress

from mavdem.cli.commands import load_command, main
from mavdem.cli.commands import mavdem as mavdem_command

MAVDEM = [sys.executable, "-c", "import sys; from mavdem.__main__ import run; sys.exit(run())"]


def strict_json(text):
    """Parses a JSON document, and asserts that it has no NaN or infinity, and a fact beside each sentence."""

    def unknown(name):
        raise AssertionError(f"{name} is not JSON")

    def with_facts(values):
        for name, fact in values.items():
            sentence, is_fact, _ = name.partition("_fact")
            if is_fact and values[sentence]:
                assert fact, f"{name} is missing"
        return values

    return json.loads(text, parse_constant=unknown, object_hook=with_facts)


def run(*words):
    """The exit code of a command."""
    return main([*map(str, words)])


def unwrapped(text):
    """Text of a screen in one line, as if no line were too long for it."""
    return " ".join(text.split())


def unknown_options(words):
    """The options among the words behind ``mavdem`` that their command does not have."""
    name = words[0] if words[0] in mavdem_command.commands else "review"
    known = {option for parameter in load_command(name).params for option in parameter.opts}
    return {word for word in words if word.startswith("--")} - known


def document_of(capsys, *words, code=0):
    """What a command prints as JSON that ends with this code."""
    assert run(*words, "--json") == code
    return strict_json(capsys.readouterr().out)


def refused(capsys, code, *words):
    """The one sentence with which a command ends with this code."""
    assert run(*words) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1 and said.err.startswith("mavdem: ")
    assert "should not have happened" not in said.err
    return said.err


def free_port():
    """A port that nobody has, neither of UDP nor of TCP: connections of other tests use the same range of ports."""
    while True:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp_probe,
            socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tcp_probe,
        ):
            udp_probe.bind(("127.0.0.1", 0))
            port = int(udp_probe.getsockname()[1])
            with suppress(OSError):
                tcp_probe.bind(("127.0.0.1", port))
                return port
