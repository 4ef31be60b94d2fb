"""Assessment: what happened in a log, how it ended, and eight lights on the vehicle, whatever the log's rate."""

from mavdem.assessment.assess import Assessment, review

__all__ = ["Assessment", "review"]
