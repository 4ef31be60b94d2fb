"""Roll, pitch and yaw: the axes that a vehicle turns about, and the range of an angle and a rate about one."""

from __future__ import annotations

from math import tau

import numpy as np

from mavdem.ingest.motors import MotorGeometry as MotorGeometry
from mavdem.ingest.motors import position_name as position_name

pass


MAX_ANGLE = tau  # rad: no Euler angle lies beyond, whatever the convention
MAX_BODY_RATE = np.radians(4000.0)
"""rad/s: beyond the range of the gyroscopes that autopilots carry, 2000 °/s and at most 4000."""


TILT_AXES = ("roll", "pitch")  # The axes of a model with angle and rate; yaw has its rate only
AXES = (*TILT_AXES, "yaw")
