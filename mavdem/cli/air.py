"""The wind of a log in m/s beside the autopilot's own estimate, as the commands report it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mavdem.alignment.drive import Signal
from mavdem.alignment.signals import Signals
from mavdem.condition import WindVelocity, wind_of
from mavdem.condition.wind_velocity import coming_from
from mavdem.errors import NotLearnable


class Air(NamedTuple):
    """The ``wind`` of a log, or the ``reason`` why there is none; ``own``: the autopilot's estimate of it (N, 2)."""

    wind: WindVelocity | None
    own: Signal | None = None
    reason: str = ""

    @classmethod
    def of(cls, signals: Signals) -> Air:
        """Returns what a vehicle's ``signals`` say."""
        try:
            return cls(wind_of(signals), signals.autopilot_wind)
        except NotLearnable as error:
            return cls(None, reason=str(error))

    def as_dict(self) -> dict[str, Any] | None:
        """Returns plain JSON values, those of the ``autopilot`` with how far they are off; None without wind."""
        if self.wind is None:
            return None
        time, own = self.wind.time, self.own
        if own is None or not (rows := (own.time >= time[0]) & (own.time <= time[-1])).any():
            return self.wind.as_dict()
        speed, direction = float(np.hypot(*(mean := own.values[rows].mean(axis=0)))), coming_from(*mean)
        turned = (direction - self.wind.direction + 180) % 360 - 180
        off = {"speed_difference": speed - self.wind.speed, "direction_difference": turned}
        return self.wind.as_dict() | {"autopilot": {"speed": speed, "direction": direction, **off}}
