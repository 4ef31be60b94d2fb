"""View: flights, models and forecasts as Rerun recordings. The only part of mavdem that imports rerun."""

import os

# Rerun warns of each file that is written without a table of its chunks, as one of a flight under way has to be, and
# reports each viewer that is closed, which we report ourselves. It reads this when it is first imported.
os.environ.setdefault(
    "RUST_LOG",
    "warn,re_log_encoding::rrd::file_sink=off,re_grpc_client=off,re_sdk::recording_stream=off",
)

from mavdem.view.flown import pose_from_motion, write_pose  # noqa: E402
from mavdem.view.plots import Target, streamed  # noqa: E402
from mavdem.view.recording import write_recording, write_words  # noqa: E402
from mavdem.view.sinks import WebServer, show  # noqa: E402

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
