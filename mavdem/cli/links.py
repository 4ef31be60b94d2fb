"""MAVLink links in the place of a log: a command that reads logs refuses them, and names the command for them."""

import os
import re
import shlex

from mavdem.errors import Unreadable
from mavdem.facts.command import NamedSource

LINK_PATTERN = re.compile(r"(udp|tcp|mcast|ws)\w*:|/dev/(tty|cu|serial)|COM\d", re.IGNORECASE)
"""The beginning of pymavlink's connection strings (``mavutil.mavlink_connection``)."""


def refuse_link(source: str) -> None:
    """Checks that a SOURCE may be a log; raises ``Unreadable`` for a MAVLink link and for standard input."""
    if source == "-":
        raise Unreadable(NamedSource.STANDARD_INPUT_IS_NO_LOG)
    if LINK_PATTERN.match(source) and not os.path.isfile(source):
        live_command = shlex.join(["mavdem", "live", source])
        raise Unreadable(NamedSource.LINK_IS_NO_LOG, path=source, name=live_command)
