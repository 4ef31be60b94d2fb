"""Rows of a live flight, made up, with predictions whose errors are known."""

import numpy as np
from partial_records import partial_record

from mavdem.dem.online.estimate import Estimate

DT = 0.01
REPORTED_HORIZON = (0.01, 0.25)


def add_flight(history, seconds, segment=0, start=100.0, learnt=True, boot=0):
    """Adds rows of a sine to a live history, with predictions that are wrong by 0.1 and 0.2."""
    time = start + DT * np.arange(round(seconds / DT))
    motion = np.stack([np.sin(time), np.cos(time)], axis=-1)
    for now, row in zip(time, motion, strict=True):
        later = now + np.array(REPORTED_HORIZON)
        estimate = partial_record(
            Estimate,
            time=now,
            ahead_times=later,
            ahead=np.stack([np.sin(later) + 0.1, np.cos(later) - 0.2], axis=-1),
            ahead_band=np.array([[0.05, 0.3]] * 2),
            wind_torque=1.0,
            wind_torque_band=0.5,
        )
        history.advance(now, boot)
        history.add_row(segment, now, row, estimate if learnt else None)
    return time, motion
