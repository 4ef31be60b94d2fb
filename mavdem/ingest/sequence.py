"""Messages that are missing, by the sequence numbers of those around them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = TypeVar("Numbers", int, NDArray[np.integer])

LATEST = 32
"""Numbers that a message may step back and be late; one that steps back further comes of a sender that began anew."""


def missing_between(before: Numbers, after: Numbers) -> Numbers:
    """How many more of one sender's messages are missing with one than with the one that came before it, −33 to 127.

    The numbers run from 0 to 255 and begin anew. A late message was missed when it was overtaken, and the next one will
    step over what has come by then: it takes both back, so that the sum over a stream is what was sent less what came,
    as RTP counts it (RFC 3550, section 6.4.1). Messages that come twice make the sum too small, even negative.
    """
    step = (after - before) & 0xFF
    late = step >= 256 - LATEST
    ahead = (step > 0) & (step <= 128)
    return (step - 1 - 256 * late) * (ahead | late)
