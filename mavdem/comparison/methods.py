"""The methods that are compared: DEM, its peers, and what needs no model."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from mavdem import baselines
from mavdem.comparison.method import Method
from mavdem.dem import Settings, learn


def dem(name: str, settings: Settings) -> Method:
    """DEM with settings.

    Args:
        name: of the method.
        settings: what decides the fit.
    """
    return Method(name, partial(learn, settings=settings))


DEM = dem("DEM", Settings())
DEM_WITHOUT = dem("DEM p=1", replace(Settings(), p=1, d=1))
PAPER = dem("DEM paper", Settings.paper())
PAPER_WITHOUT = dem("DEM paper p=1", replace(Settings.paper(), p=1, d=1, window=2))

PEERS = (
    *(Method(f"subspace({order})", partial(baselines.subspace, order=order)) for order in (2, 4)),
    *(Method(f"PEM({order})", partial(baselines.pem, order=order)) for order in (2, 4)),
    Method("EM(2)", partial(baselines.em, order=2)),
    *(Method(f"ARX({order})", partial(baselines.arx, order=order)) for order in (1, 2, 4)),
)
"""Other methods that learn a model."""

TRIVIAL = (
    Method("constant mean", baselines.constant_mean),
    Method("hold last", baselines.hold),
    Method("zero", baselines.zero),
)

METHODS = (DEM, DEM_WITHOUT, PAPER, PAPER_WITHOUT, *PEERS, *TRIVIAL)
"""What ``mavdem compare`` compares; the first with each other. p = 1 is what the paper calls without generalized
coordinates (section V.G): the first derivative, which the model itself needs, and none beyond."""

GENERALIZED_COORDINATES = ((DEM.name, DEM_WITHOUT.name), (PAPER.name, PAPER_WITHOUT.name))
"""Names of methods that differ in nothing else: with generalized coordinates, and without."""
