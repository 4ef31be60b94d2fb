"""The link with which a telephone opens the pages of a server, as the terminal shows it."""

from mavdem.cli.streams import print_to_stderr, stderr_is_terminal


def print_sign_in_link(link: str) -> None:
    """Prints the link that signs a browser in, if there is one and standard error is a terminal.

    Whoever has the link may read all that the server shows, so that it is not written to logs.

    Args:
        link: the link; empty for none.
    """
    if link and stderr_is_terminal():
        print_to_stderr(f"On a telephone, to read without typing the token: {link}")
