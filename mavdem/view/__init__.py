"""View: what a learner would want to look at, for Rerun. The only part of mavdem that imports rerun."""

from mavdem.view.recording import write_recording
from mavdem.view.show import show

__all__ = ["show", "write_recording"]
