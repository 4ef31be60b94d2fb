"""Watches in flight whether lasting shifts of the trims are beyond what the vehicle's lean against the wind explains.

They are judged by the function that logs are judged by, with the settled flight so far. A shift is judged again as the
flight goes on: soon after it, little flight shows what the lean explains.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from mavdem.containers import Numbers
from mavdem.dataset.intervals import TimeInterval
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import BLOCK_SECONDS, MAX_GAP, SteadyRun
from mavdem.motors.balance_blocks import BlockAverager, CommandBlock
from mavdem.motors.lean_check import without_shifts_by_lean
from mavdem.motors.motor_changes import MotorChange, lasting_changes
from mavdem.motors.signatures import motor_signatures

JUDGING_PERIOD = BLOCK_SECONDS
"""Time between two judgements of the same shifts, s: a shorter time adds no block to the fit."""

ANY_HEADING = 0.0
"""Heading, rad, that all samples get, since the fit uses turns like other flight."""


class LeanWatch:
    """Keeps the settled flight of one vehicle so far, and judges the shifts of its trims by it."""

    def __init__(self, geometry: MotorGeometry) -> None:
        """Begins without flight.

        Args:
            geometry: positions and spins of the k motors.
        """
        self._signatures = motor_signatures(geometry)
        self._averager = BlockAverager()
        # Means of the samples, in runs without a gap of ``MAX_GAP``.
        self._runs: list[list[CommandBlock]] = []
        self._latest_time = -inf
        self._judging_time = -inf
        # The lasting changes at the latest judgement, and the shifts among them that lean does not explain.
        self._judged_changes: list[MotorChange] = []
        self._unexplained_shifts: list[MotorChange] = []

    def add_sample(self, time: float, commands: Sequence[float], lean: Numbers) -> None:
        """Adds a sample of settled flight.

        Args:
            time: time of the sample, s of the boot clock.
            commands: (k,) outputs of the motors, as fractions of the range.
            lean: roll and pitch, rad; NaN where they are not known.
        """
        is_continued = 0 < time - self._latest_time < MAX_GAP
        if not is_continued:
            self._averager.restart(time, ANY_HEADING)
            self._runs.append([])
        self._latest_time = time
        completed_block = self._averager.add(time, commands, ANY_HEADING, lean)
        if completed_block is not None:
            self._runs[-1].append(completed_block)

    def withdraw_since(self, time: float) -> None:
        """Discards the samples since the beginning of a landing or of a loss of control.

        The motors' commands since then show nothing about their trims. The next call of :meth:`unexplained_shifts`
        judges the shifts of the trims anew.

        Args:
            time: beginning of the landing or of the loss of control, s of the boot clock.
        """
        self._runs = [[block for block in run if block.end <= time] for run in self._runs]
        self._judging_time = -inf

    def unexplained_shifts(self, changes: Sequence[MotorChange]) -> list[MotorChange]:
        """Returns the lasting shifts of the trims that the lean does not explain, by the settled flight so far.

        The same shifts are judged at most once in ``JUDGING_PERIOD``; in between the former judgement is returned.

        Args:
            changes: all changes of the motors' balance in this flight, in the order of time. Those that name a motor
                are not judged, but the flight on their other side is not used for a shift beside them.

        Returns:
            The shifts, which are the changes that name no motor, in the same order.
        """
        present_changes = lasting_changes(changes)
        if all(change.motor is not None for change in present_changes):
            return []
        is_due = self._latest_time - self._judging_time >= JUDGING_PERIOD
        if is_due or present_changes != self._judged_changes:
            self._judge(present_changes)
        return self._unexplained_shifts

    def _judge(self, present_changes: list[MotorChange]) -> None:
        """Judges the shifts of the trims anew, and stores those that the lean does not explain.

        Args:
            present_changes: the lasting changes of the motors' balance in this flight, in the order of time; those that
                name a motor are not judged.
        """
        self._judging_time = self._latest_time
        self._judged_changes = present_changes
        unexplained_changes = without_shifts_by_lean(
            present_changes, self._signatures, self._run_around
        )
        self._unexplained_shifts = [
            change for change in unexplained_changes if change.motor is None
        ]

    def _run_around(self, change: MotorChange, interval: TimeInterval) -> SteadyRun | None:
        """Returns the settled flight before and after a change; None if the change is in no settled flight.

        Args:
            change: the change, at whose onset the flight must be settled.
            interval: interval, s of the boot clock, in which nothing else changed. Flight outside is left out.
        """
        start, end = interval
        for run in self._runs:
            if run and run[0].end <= change.onset_time <= run[-1].end:
                blocks = [block for block in run if start <= block.end <= end]
                return SteadyRun(
                    time=np.array([block.end for block in blocks]),
                    commands=np.array([block.commands for block in blocks]),
                    lean=np.array([block.lean for block in blocks]),
                )
        return None
