"""Frames of multirotors whose motors all tests know: places and spins by the number of motors."""

import numpy as np

from mavdem.ingest.motors import MotorGeometry

QUAD = np.sqrt(0.5) * np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)])
HEXAGON = np.radians([90, -90, -30, 150, 30, -150])
OCTAGON = np.radians(np.arange(22.5, 360, 45))
FRAMES = {
    4: (QUAD, (1, 1, -1, -1)),
    6: (np.column_stack([np.cos(HEXAGON), np.sin(HEXAGON)]), (-1, 1, -1, 1, 1, -1)),
    8: (np.column_stack([np.cos(OCTAGON), np.sin(OCTAGON)]), (1, -1) * 4),
}


def geometry(motors=4, **known):
    """The geometry of a frame with so many motors, of which something else may be ``known``."""
    places, spins = FRAMES[motors]
    numbers = tuple(range(1, motors + 1))
    usual = {"positions": tuple(map(tuple, places.tolist())), "spins": spins}
    return MotorGeometry(numbers, numbers, **usual | known)
