"""View: what a learner would want to look at, for Rerun. The only part of mavdem that imports rerun."""

from mavdem.view.flown import write_pose
from mavdem.view.pose import Pose
from mavdem.view.recording import write_recording
from mavdem.view.show import show

__all__ = ["Pose", "show", "write_pose", "write_recording"]
