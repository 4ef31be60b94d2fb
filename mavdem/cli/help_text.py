"""The help of a command in a narrow terminal: examples and lists, which Click leaves as they are, fit its width."""

import re
from collections.abc import Iterator

import click

VERBATIM_MARK = "\b"
"""First line of a paragraph that Click does not wrap: examples, and lists in columns."""

COMMAND_PATTERN = re.compile(r"\s*(?:[A-Z_]+=\S.*|mavdem|curl|duckdb|mavproxy\.py) ")
"""How the line of an example begins that is a command of a shell."""

WORD_PATTERN = re.compile(r"""(?:'[^']*'|\"[^\"]*\"|[^\s'\"])+""")
"""A word of a command, with its quotes."""

HANGING_PATTERN = re.compile(r"\s*(?:\d+\. |\S+(?: \S+)* {2,})?")
"""What stands before the text of a line in a list: a number, or the first of two columns."""


class NarrowHelpFormatter(click.HelpFormatter):
    """Click's formatter, but that no line of an example is wider than the terminal."""

    def write_text(self, text: str) -> None:
        """Writes paragraphs; those that Click leaves as they are get shorter lines first."""
        width = self.width - self.current_indent
        paragraphs = []
        for paragraph in text.split("\n\n"):
            first_line, *lines = paragraph.splitlines() or [""]
            if first_line.strip() == VERBATIM_MARK:
                paragraph = "\n".join([first_line, *_narrow_lines(lines, width)])
            paragraphs.append(paragraph)
        super().write_text("\n\n".join(paragraphs))


class NarrowHelpContext(click.Context):
    """Click's context, whose help fits a narrow terminal."""

    formatter_class = NarrowHelpFormatter


def _narrow_lines(lines: list[str], width: int) -> Iterator[str]:
    """Yields the lines of an example or a list, with those that are too wide on several lines."""
    for line in lines:
        if len(line) <= width:
            yield line
        elif COMMAND_PATTERN.match(line):
            yield from _command_lines(line, width)
        else:
            hanging = HANGING_PATTERN.match(line)
            assert hanging is not None, "the pattern matches an empty text, too"
            indent = " " * (0 if hanging.end() == len(line) else hanging.end())
            yield from click.formatting.wrap_text(line, width, "", indent).splitlines()


def _command_lines(command: str, width: int) -> Iterator[str]:
    """Yields a command of a shell on several lines, each but the last with a backslash, as the shell reads it.

    An option stays with its value, and a word in quotes on one line, except where they alone are too wide.

    Args:
        command: the command.
        width: widest line, characters.
    """
    indent = command[: len(command) - len(command.lstrip())]
    max_length = width - len(f"{indent}     \\")
    words: list[str] = []
    for match in WORD_PATTERN.finditer(command):
        word = match[0]
        is_value = bool(words) and words[-1].startswith("--") and not word.startswith("--")
        if is_value and len(f"{words[-1]} {word}") <= max_length:
            words[-1] += f" {word}"
        elif len(word) <= max_length:
            words.append(word)
        else:
            words += word.split(" ")
    line = indent + words[0]
    for word in words[1:]:
        if len(line) + 1 + len(word) + 2 > width:
            yield f"{line} \\"
            line = f"{indent}    {word}"
        else:
            line += f" {word}"
    yield line
