"""Parameters of a loop's likelihood, and what is known of each beforehand."""

import tomllib
from pathlib import Path

import numpy as np

_KNOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
TYPICAL_VALUES: dict[str, float] = _KNOWN["usual"]
NAMES = tuple(TYPICAL_VALUES)
MEAN = np.log(list(TYPICAL_VALUES.values()))
SD = np.array([_KNOWN["sd"][name] for name in NAMES])
PLANT = EFFECT, DAMPING, LAG, DELAY = tuple(map(NAMES.index, ("effect", "damping", "lag", "delay")))
CONTROLLER, STEP_TIME = NAMES.index("controller"), NAMES.index("step_time")
