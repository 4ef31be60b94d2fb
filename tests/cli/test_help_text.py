"""The help of commands in a narrow terminal."""

import shlex

import click
from pytest import mark

from mavdem.cli.commands import COMMAND_SUMMARIES, load_command, mavdem
from mavdem.cli.help_text import NarrowHelpContext, NarrowHelpFormatter
from mavdem.report.numbers import listed


@mark.parametrize("width", [50, 60])
def test_no_line_of_the_help_is_wider_than_the_terminal(width):
    wide_lines = []
    root = NarrowHelpContext(mavdem, info_name="mavdem", terminal_width=width)
    helps = [mavdem.get_help(root)]
    for name in COMMAND_SUMMARIES:
        command = load_command(name)
        context = command.context_class(command, root, name, terminal_width=width)
        helps.append(command.get_help(context))
    for line in "\n".join(helps).splitlines():
        if click.formatting.term_len(line) > width:
            wide_lines.append(line)
    assert not wide_lines, listed(wide_lines)


def test_an_example_on_several_lines_is_the_same_command():
    command = """mavdem track logs/ --name 'px4-1a2b3c=Red quad' --axis roll --methods "DEM plant,hold last" """
    formatter = NarrowHelpFormatter(width=44)
    formatter.write_text(f"\b\nExample:\n  {command.strip()}")
    _, *lines = formatter.getvalue().splitlines()
    assert len(lines) > 2 and all(line.endswith(" \\") for line in lines[:-1])
    assert shlex.split("\n".join(lines).replace("\\\n", "")) == shlex.split(command)
    assert "--name 'px4-1a2b3c=Red quad'" in formatter.getvalue()
