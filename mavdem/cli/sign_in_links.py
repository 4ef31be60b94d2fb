"""The link with which a telephone opens the pages of a server, as the terminal shows it."""

from contextlib import suppress
from io import StringIO

from mavdem.cli.streams import print_to_stderr, stderr_is_terminal

QUIET_ZONE = 2
"""Margin around the QR code, modules: a choice, since the four of ISO/IEC 18004 take rows that a terminal lacks."""

CODE_STYLE = "color(231) on color(16)"
"""White modules on black ones, of the colours that no theme of a terminal changes (xterm's 256).

With the terminal's own colours, a light one would show the code inverted, which not every reader of codes can read.
"""


def print_sign_in_link(link: str) -> None:
    """Prints the link that signs a browser in, also as a QR code, if there is one and standard error is a terminal.

    Whoever has the link may read all that the server shows, so that it is not written to logs. The code has 19 rows: on
    a terminal of 24 rows it stays in sight only if it is printed last.

    Args:
        link: the link; empty for none.
    """
    if not link or not stderr_is_terminal():
        return
    print_to_stderr(f"On a telephone, to read without typing the token: {link}")
    # Imported here: a link comes from a server, whose extra contains the package.
    import segno

    from mavdem.cli.console import STDERR

    code = StringIO()
    segno.make(link, micro=False).terminal(code, border=QUIET_ZONE, compact=True)
    # A terminal whose encoding has no blocks, or that was closed, does without the code.
    with suppress(UnicodeEncodeError, OSError):
        for line in code.getvalue().splitlines():
            STDERR.print(line, style=CODE_STYLE, soft_wrap=True)
