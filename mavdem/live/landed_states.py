"""When a live vehicle was in the air or on the ground since its autopilot started, in the form that logs have."""

from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.vocabulary import IN_AIR

MAX_PHASES = 1000
"""Phases that are kept, at most: a choice, far more than a day of flying has. It bounds the memory for a state that
flaps."""


class _StateSample(NamedTuple):
    """A landed state at a time."""

    time: float
    """Time on the boot clock, s."""

    landed_state: int
    """``IN_AIR`` or ``ON_GROUND``."""


class LandedStates:
    """The phases in the air and on the ground in one boot, as the periodic reviews of the vehicle found them.

    Each phase is kept as two samples: when it was found first, and when it was found last before the next one began.
    Of more than ``MAX_PHASES`` the oldest are forgotten.
    """

    def __init__(self) -> None:
        """Begins without a phase."""
        self._samples: list[_StateSample] = []

    @property
    def latest(self) -> int | None:
        """The latest state, ``IN_AIR`` or ``ON_GROUND``; None before the first review."""
        return self._samples[-1].landed_state if self._samples else None

    @property
    def is_in_air(self) -> bool:
        """Whether the vehicle is in the air."""
        return self.latest == IN_AIR

    @property
    def phase_start(self) -> float:
        """When the present phase began, s of the boot clock; there must be one."""
        return self._samples[-1].time

    @property
    def is_first_phase(self) -> bool:
        """Whether the state has not changed in this boot yet."""
        # Each phase has two samples (:meth:`begin_phase`).
        return len(self._samples) <= 2

    @property
    def flight_end(self) -> float | None:
        """When the vehicle on the ground was last in the air, s of the boot clock; None in flight or before any."""
        if self.is_in_air or not self._samples:
            return None
        last_of_former_phase = self._samples[-2]
        return last_of_former_phase.time if last_of_former_phase.landed_state == IN_AIR else None

    def begin_phase(self, state: int, now: float, last_review_time: float) -> None:
        """Begins a phase in the air or on the ground, by a sample of the former state and one of the new state.

        The vehicle changed its state at some time between two reviews. So the former state is stored with the time of
        the review before, and the new state with that of the present review.

        Args:
            state: landed state of the phase, ``IN_AIR`` or ``ON_GROUND``.
            now: time of the review that found the new state, s of the boot clock.
            last_review_time: time of the review before, which still found the former state, s.
        """
        # Before the first phase no other state is known.
        former_state = state if self.latest is None else self.latest
        self._samples.append(_StateSample(last_review_time, former_state))
        self._samples.append(_StateSample(now, state))
        # Each phase has two samples.
        max_samples = 2 * MAX_PHASES
        del self._samples[:-max_samples]

    def begin_in_air(self, now: float) -> None:
        """Notes that the vehicle has been in the air since the boot began, whatever state was assumed before.

        Args:
            now: time of the review that has found it, s of the boot clock.
        """
        self._samples = [_StateSample(-inf, IN_AIR), _StateSample(now, IN_AIR)]

    def series(self, now: float, boot: int, *, was_flying: bool) -> TimeSeries:
        """Returns the states over time, as a log has them.

        Args:
            now: time until which the latest state lasts, s of the boot clock.
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.
            was_flying: whether the vehicle was in flight when the former boot ended. Nothing else is known of that
                boot.

        Returns:
            MAV_LANDED_STATE (N,) of this boot. If the vehicle was in flight at the end of the former boot, the first
            sample is of that boot.
        """
        # The latest state is repeated at the present time.
        latest_sample = self._samples[-1]
        samples = [*self._samples, latest_sample._replace(time=now)]
        boots = [boot] * len(samples)
        if was_flying:
            # One sample shows the state of the former boot; its time does not matter.
            former_boot = boot - 1
            samples.insert(0, _StateSample(0.0, IN_AIR))
            boots.insert(0, former_boot)
        return TimeSeries(
            np.array([sample.time for sample in samples]),
            boot=np.array(boots),
            values=np.array([sample.landed_state for sample in samples]),
        )
