"""The link with which a telephone opens the pages of a server, as the terminal shows it."""

import sys
from contextlib import suppress

from mavdem.cli.streams import print_to_stderr, stderr_is_terminal

QUIET_ZONE = 2
"""Margin around the QR code, modules: a choice, since the four of ISO/IEC 18004 take rows that a terminal lacks."""


def print_sign_in_link(link: str) -> None:
    """Prints the link that signs a browser in, also as a QR code, if there is one and standard error is a terminal.

    Whoever has the link may read all that the server shows, so that it is not written to logs.

    Args:
        link: the link; empty for none.
    """
    if not link or not stderr_is_terminal():
        return
    print_to_stderr(f"On a telephone, to read without typing the token: {link}")
    # Imported here: a link comes from a server, whose extra contains the package.
    import segno

    # A terminal whose encoding has no blocks, or that was closed, does without the code.
    with suppress(UnicodeEncodeError, OSError):
        segno.make(link, micro=False).terminal(sys.stderr, border=QUIET_ZONE, compact=True)
