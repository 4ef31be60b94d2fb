"""The claims of the paper that are tested again, with the labels of its figures and tables.

Source: A. Anil Meera, M. Wisse, "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind".
"""

from __future__ import annotations

from typing import NamedTuple


class Claim(NamedTuple):
    """One claim that is tested again; ``labels`` count figures, tables and algorithms in the order of the source."""

    name: str
    title: str
    section: str
    labels: tuple[str, ...]
    quote: str


CLAIMS = (
    Claim(
        "noise",
        "Noise colour and the Laplace approximation",
        "V.C Noise color and Laplace approximation",
        ("Fig. 5 (histograms)", "Fig. 7 (autocorr)"),
        "The histograms of process noise w^φ̇ for all five flight experiments follow a Gaussian distribution. The "
        "autocorrelation plot of process noise for all five experiments doesn’t drop within the confidence bound "
        "immediately after zero lag, confirming the presence of a range of noise color.",
    ),
    Claim(
        "prediction",
        "Output prediction with DEM",
        "V.E Output prediction using DEM",
        ("Fig. 6 (DEM_estimation_eg)",),
        "DEM can accurately perform one step ahead output prediction on the training data, and 150 step ahead output "
        "predictions on unseen data. The parameter estimation converges to a solution within few iterations, despite "
        "starting from wrong random priors. Perception is driven by the maximization of F̄.",
    ),
    Claim(
        "coordinates",
        "Influence of generalized coordinates",
        "V.G Importance of generalized coordinates",
        ("Table II (SSE_GC)", "Fig. 8 (generalized_coor_y_pred)"),
        "The results show a lower MSPE for DEM with GC when compared to DEM without using GC, revealing the importance "
        "of using GC for output prediction.",
    ),
    Claim(
        "benchmark",
        "DEM beside PEM, subspace identification and EM",
        "V.H Benchmarking",
        ("Fig. 9 (MSPE_benchmarking)",),
        "The n-step ahead output prediction error is the lowest for DEM for most cases. DEM outperforms other methods "
        "for all five experiments with minimum MSPE on unseen test data.",
    ),
    Claim(
        "order",
        "Model order by free energy",
        "V.I Extended DEM for black-box estimation",
        ("Fig. 10 (model_nx)", "Table I (systems)", "Algorithm 1 (extended_DEM)"),
        "F̄ saturates when the robot brain’s model order matches the real system order (4, 3, 2 and 1).",
    ),
    Claim(
        "oracle",
        "The authors’ own code on simulated data",
        "The authors’ own code",
        ("System 2 of Table I (systems), simulated",),
        "No figure of the paper: the results of the authors’ published MATLAB code on a simulated System 2, run in GNU "
        "Octave with its numerical core unchanged, and of their EM from five starts.",
    ),
    Claim(
        "demonstrations",
        "The manifold of the free energy",
        "IV Preliminaries",
        ("Fig. 2 (FreeE_curves)", "Fig. 3 (para_FE_opt)"),
        "The free energy manifold rises and sharpens as it is climbed, and priors from all sides climb to one peak.",
    ),
)
"""In the order of the paper, then its preliminaries."""

MSPE_WITHOUT_COORDINATES = (0.1197, 0.0640, 0.1647, 0.0518, 0.0951)
"""Table II (SSE_GC), DEM without GC, p = 1: experiments 1 to 5, summed over outputs; 0.4953 in total."""

MSPE_WITH_COORDINATES = (0.0521, 0.0133, 0.0583, 0.0458, 0.1172)
"""Table II (SSE_GC), DEM with GC, p = 2: likewise; 0.2867 in total."""
