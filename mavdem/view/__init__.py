"""View: flights, models and forecasts as Rerun recordings. The only part of mavdem that imports rerun."""

import os
from typing import TYPE_CHECKING

from mavdem.lazy_names import lazy_names

if TYPE_CHECKING:
    from mavdem.view.flown import pose_from_motion, write_pose
    from mavdem.view.plots import Target, streamed
    from mavdem.view.recording import write_recording, write_words
    from mavdem.view.sinks import WebServer, show

# Rerun warns of each file that is written without a table of its chunks, as one of a flight under way has to be, and
# reports each viewer that is closed, which we report ourselves. It reads this when it is first imported.
os.environ.setdefault(
    "RUST_LOG",
    "warn,re_log_encoding::rrd::file_sink=off,re_grpc_client=off,re_sdk::recording_stream=off",
)

__all__ = [
    "Target",
    "WebServer",
    "pose_from_motion",
    "show",
    "streamed",
    "write_pose",
    "write_recording",
    "write_words",
]

# Rerun takes a second to import, and the ranges of axes alone need none of it.
__getattr__ = lazy_names(
    __name__,
    {
        "Target": "plots",
        "WebServer": "sinks",
        "pose_from_motion": "flown",
        "show": "sinks",
        "streamed": "plots",
        "write_pose": "flown",
        "write_recording": "recording",
        "write_words": "recording",
    },
)


def __dir__() -> list[str]:
    """Returns the public names, also those that are not imported yet."""
    return __all__
