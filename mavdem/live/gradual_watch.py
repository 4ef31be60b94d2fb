"""Watches a live flight for a motor that loses thrust slowly, by the search that logs are judged by, once a second.

A loss that takes ten seconds or more moves the reference of the sequential test along (``mavdem.motors.gradual_loss``),
which then finds it late, and only the part of it that is new.
"""

from collections import deque
from math import inf

import numpy as np

from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance_blocks import BlockAverager, CommandBlock
from mavdem.motors.gradual_loss import MAX_BLOCKS, gradual_loss
from mavdem.motors.loss_confirmation import MAX_CONFIRMATION_SECONDS
from mavdem.motors.loss_detection import MAX_GAP
from mavdem.motors.motor_changes import MotorAlarm

SEARCH_PERIOD = 1.0
"""Time between two searches, s: a choice; one takes some milliseconds."""

STEADY_HEADING = 0.0
"""Heading, rad, that all samples get, as only those are taken whose attitude follows its setpoint."""


class GradualLossWatch:
    """Searches the settled flight so far, two minutes at most, for a motor that lost thrust slowly.

    Attributes:
        loss: the loss as of the latest search that found it; None without one.
    """

    def __init__(self, geometry: MotorGeometry, boot: int) -> None:
        """Begins without a sample.

        Args:
            geometry: positions and spins of the k motors.
            boot: number of the boot.
        """
        self.loss: MotorAlarm | None = None
        self._geometry = geometry
        self._boot = boot
        self._averager = BlockAverager()
        self._blocks: deque[CommandBlock] = deque(maxlen=MAX_BLOCKS)
        self._latest_time = -inf
        self._search_time = -inf
        # When the loss was found last, s.
        self._found_time = -inf

    def restart(self) -> None:
        """Forgets the flight so far: it is no reference for later flight, as after a sudden change or a landing."""
        self.loss = None
        self._blocks.clear()
        self._latest_time = -inf

    def add_sample(self, time: float, commands: list[float]) -> None:
        """Adds a sample of settled flight whose attitude follows its setpoint, and searches when that is due.

        A loss that has not been found for ``MAX_CONFIRMATION_SECONDS`` is over.

        Args:
            time: time of the sample, s of the boot clock.
            commands: (k,) outputs of the motors, as fractions of the range.
        """
        if not 0 < time - self._latest_time < MAX_GAP:
            self.restart()
            self._averager.restart(time, STEADY_HEADING)
        self._latest_time = time
        block = self._averager.add(time, commands, STEADY_HEADING)
        if block is None:
            return
        self._blocks.append(block)
        if time - self._search_time < SEARCH_PERIOD:
            return
        self._search_time = time
        loss = gradual_loss(
            np.array([each.end for each in self._blocks]),
            np.array([each.commands for each in self._blocks]),
            self._geometry,
            self._boot,
        )
        if loss is not None:
            self.loss = loss
            self._found_time = time
        elif time - self._found_time > MAX_CONFIRMATION_SECONDS:
            self.loss = None
