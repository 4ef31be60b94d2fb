"""Assessment: what happened in a log, how it ended, and eight lights on the vehicle, whatever the log's rate."""

from mavdem.assessment.assess import review
from mavdem.assessment.record import Assessment

__all__ = ["Assessment", "review"]
