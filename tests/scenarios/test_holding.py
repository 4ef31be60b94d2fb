"""Whether a vehicle held its place is told as it was."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_motion import made_up_motion

from sitl_scenarios.mavlink.transmitter import rows_of_motion
from sitl_scenarios.motion import Holding, Motion
from sitl_scenarios.scenario import Scenario


def hovering(east: float, seconds: float, outputs: float = 1500.0, state: int = 2) -> Motion:
    """Ten seconds in the air, of which the last few are spent ``east`` of where it should be."""
    motion = made_up_motion(10.0)
    away = motion.time > motion.time[-1] - seconds
    position = np.column_stack([0 * motion.time, np.where(away, east, 0.0), np.full(len(motion), -5.0)])
    return replace(
        motion,
        position=position,
        armed=np.ones(len(motion), dtype=np.bool_),
        landed_state=np.where(away, state, 2).astype(np.uint8),
        outputs=np.where(away[:, None], outputs, np.full((len(motion), 4), 1500.0)),
    )


# Where it lands it need not hold its place; blown down to the ground it should have.
@pytest.mark.parametrize(
    ("east", "seconds", "state", "told"),
    [(6.0, 2.0, 2, True), (6.0, 0.9, 2, False), (4.9, 5.0, 2, False), (6.0, 2.0, 4, False), (6.0, 2.0, 1, True)],
)
def test_a_second_too_far_away_is_reported(east, seconds, state, told):
    motion, holding = hovering(east, seconds, state=state), Holding(Scenario())
    for begin in range(0, len(motion), 7):
        holding.add(rows_of_motion(motion, slice(begin, begin + 7)))
    assert bool(holding.farthest) == told == bool(holding.cautions())


@pytest.mark.parametrize("outputs", [2000.0, 1100.0])
def test_motors_at_their_limits_are_reported(outputs):
    holding = Holding(Scenario())
    holding.add(hovering(0.0, 2.0, outputs))
    assert holding.at_limit == pytest.approx(0.2, abs=0.01)
    (caution,) = holding.cautions()
    assert caution.startswith("motors were at their limits in 20% of the time")
