"""Files that a command is to write: what is in their way is told in a sentence, and before the work where it can be."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from mavdem.errors import Unreadable
from mavdem.whole_file import replaceable


def check_file(path: Path | None, option: str, endings: tuple[str, ...]) -> None:
    """Refuses, before the flight, what could not be written after it.

    Args:
        path: of the file; ``None`` for none.
        option: that named it.
        endings: that its name may have.

    Raises:
        Unreadable: something is there that cannot be replaced, or the folder is missing or not writable.
        click.BadParameter: its name has another ending.
    """
    if path is None:
        return
    if path.suffix.lower() not in endings:
        raise click.BadParameter(f"{path} must end in {' or '.join(endings)}.", param_hint=option)
    with writing(path):
        replaceable(path)


@contextmanager
def writing(*files: Path) -> Iterator[None]:
    """Tells what is in the way of files that are written.

    Raises:
        Unreadable: what was an ``OSError``.
    """
    try:
        yield
    except OSError as error:
        told = " or ".join(str(path) for path in files)
        raise Unreadable(f"{told} cannot be written ({error.strerror or error}): name another file.") from None
