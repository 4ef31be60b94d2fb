"""View: what a learner would want to look at, for Rerun. The only part of mavdem that imports rerun."""

import os

# Rerun warns of each file that is written without a table of its chunks, as one of a flight under way has to be, and
# reports each viewer that is closed, which is told in our words. It reads this when it is first imported.
os.environ.setdefault(
    "RUST_LOG", "warn,re_log_encoding::rrd::file_sink=off,re_grpc_client=off,re_sdk::recording_stream=off"
)

from mavdem.view.flown import write_pose  # noqa: E402
from mavdem.view.pose import Pose  # noqa: E402
from mavdem.view.recording import write_recording  # noqa: E402
from mavdem.view.show import show  # noqa: E402

__all__ = ["Pose", "show", "write_pose", "write_recording"]
