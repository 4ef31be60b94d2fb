"""Subspace identification held against that of nfoursid and, where it is installed, of SIPPY."""

import importlib

import numpy as np
import pytest
from innovation_systems import flown, random_system

from mavdem import Flight, baselines
from mavdem.baselines import StateSpace

HORIZON = 6


def of_nfoursid(flight: Flight, system: StateSpace) -> StateSpace:
    """N4SID, which weights nothing; told the trims, of which it knows nothing."""
    nfoursid = pytest.importorskip("nfoursid.nfoursid")
    import pandas

    r, m = flight.inputs.shape[1], flight.outputs.shape[1]
    columns = [f"u{i}" for i in range(r)], [f"y{i}" for i in range(m)]
    order, trims = len(system.A), (system.input_trim, system.output_trim)
    table = np.hstack([flight.inputs - trims[0], flight.outputs - trims[1]])
    frame = pandas.DataFrame(table, columns=[*columns[0], *columns[1]])
    identification = nfoursid.NFourSID(frame, columns[1], columns[0], num_block_rows=HORIZON)
    identification.subspace_identification()
    found, _ = identification.system_identification(rank=order)
    K, offset = np.zeros((order, m)), np.zeros(order)
    return StateSpace(found.a, found.b, found.c, found.d, K, offset, *trims)


def of_mavdem(flight: Flight, order: int, monkeypatch: pytest.MonkeyPatch) -> StateSpace:
    """With the same horizon as theirs."""
    module = importlib.import_module("mavdem.baselines.subspace_identification")
    monkeypatch.setattr(module, "_horizon", lambda segments, order: HORIZON)
    return baselines.subspace(flight, order).model


def input_answers(model: StateSpace) -> np.ndarray:
    return np.array([model.C @ np.linalg.matrix_power(model.A, k) @ model.B for k in range(2 * HORIZON)])


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_without_noise_nfoursid_finds_the_same_system(order, monkeypatch):
    system = random_system(order, order)
    flight, _ = flown(system, 1, 600, noise=0.0)
    theirs = input_answers(of_nfoursid(flight, system))
    ours = input_answers(of_mavdem(flight, order, monkeypatch))
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max())
