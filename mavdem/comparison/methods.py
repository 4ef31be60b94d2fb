"""The methods that are compared: DEM, other model classes, and forecasts without a model."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from mavdem import baselines
from mavdem.comparison.outcome import Method
from mavdem.dem import Settings, learn


def dem(name: str, settings: Settings, predicts: bool = False) -> Method:
    """DEM with these ``settings`` of the fit, as the method of this ``name``, which ``predicts`` as well."""
    return Method(name, partial(learn, settings=settings), predicts)


PAPER_SETTINGS_WITHOUT = replace(Settings.paper(), p=1, d=1, window=2)
"""The paper's settings without generalized coordinates: the first derivative, which the model needs, and no
higher one."""

DEM = dem("DEM", Settings(), predicts=True)
DEM_WITHOUT = dem("DEM p=1", replace(Settings(), p=1, d=1))
PAPER = dem("DEM paper", Settings.paper())
PAPER_WITHOUT = dem("DEM paper p=1", PAPER_SETTINGS_WITHOUT)

PEERS = (
    *(Method(f"subspace({order})", partial(baselines.subspace, order=order)) for order in (2, 4)),
    *(Method(f"PEM({order})", partial(baselines.pem, order=order)) for order in (2, 4)),
    Method("EM(2)", partial(baselines.em, order=2)),
    *(Method(f"ARX({order})", partial(baselines.arx, order=order)) for order in (1, 2, 4)),
    *(Method(f"joint VAR({order})", partial(baselines.var, order=order), predicts=True) for order in (4, 10)),
)
"""Other methods that learn a model."""

TRIVIAL = (
    Method("constant mean", baselines.constant_mean, predicts=True),
    Method("hold last", baselines.hold, predicts=True),
    Method("zero", baselines.zero),
)

METHODS = (DEM, DEM_WITHOUT, PAPER, PAPER_WITHOUT, *PEERS, *TRIVIAL)
"""The methods of ``mavdem compare``; the first is compared with each of the others. Predictions without the inputs are
compared of those that make them; settings of DEM do not matter to these. p = 1 is what the paper calls
without generalized coordinates (section V.G): the first derivative only, which the model itself needs."""

GENERALIZED_COORDINATES = ((DEM.name, DEM_WITHOUT.name), (PAPER.name, PAPER_WITHOUT.name))
"""Pairs of names: the same method with generalized coordinates, and without."""
