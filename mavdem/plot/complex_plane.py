"""Poles: the eigenvalues of the model in the complex plane, each with the region that its uncertainty leaves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from scipy.stats import f as fisher

from mavdem.confidence import LEVEL, half_width
from mavdem.dem import Learned, Physical
from mavdem.plot.drawn import drawn_models
from mavdem.plot.style import HAIRLINE, legend_above, note, picture
from mavdem.report.palette import BAD, BAND, BAND_OPACITY, HELD_OUT_OPACITY, PHYSICAL, PREDICTED, TRUTH

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MANY = 1e6  # degrees of freedom of a covariance that is not itself estimated
DAMPING_RATIOS = (0.2, 0.4, 0.6, 0.8)
SLOW = 10.0  # times the slowest pole, or 1/s, up to which poles are shown
CLOUD = 150  # draws that are shown
BAR = 0.04  # of the height, to each side: the interval of a real pole
MARGIN = 0.3  # beyond the outermost poles, in spans


class Pole(NamedTuple):
    """A pole, 1/s, the covariance (2, 2) of its real and imaginary part, and the degrees of freedom of that."""

    value: complex
    covariance: Array
    freedom: float


def poles(learned: Learned, truth: Array | None = None) -> Figure:
    """The slow poles of the model, with draws from their uncertainty; fast ones are named at the edge.

    An ellipse holds its pole with probability 90 % to first order. Where it would reach another pole that is not
    valid, as for two poles that are nearly one, and the draws alone show where the poles may be.

    Args:
        learned: the model, with the covariance of its parameters.
        truth: A (n, n) of a simulated vehicle, for its poles.
    """
    values: Complex = np.linalg.eigvals(learned.model.A).astype(complex)
    true: Complex = np.empty(0, complex) if truth is None else np.linalg.eigvals(truth).astype(complex)
    limit = SLOW * max(float(np.abs(values).min()), 1.0)
    slow = np.abs(values) <= limit
    drawn: Complex = np.linalg.eigvals(drawn_models(learned, np.ones(learned.model.B.shape[1])).A[:CLOUD]).astype(
        complex
    )
    with picture() as figure:
        axes = figure.subplots()
        _plane(axes, np.concatenate([values[slow], true[np.abs(true) <= limit]]))
        _cloud(axes, drawn)
        for pole in uncertain_poles(learned):
            _region(axes, pole, values)
        axes.plot(values.real, values.imag, "x", color=PREDICTED, markersize=7, markeredgewidth=2, label="DEM's model")
        _physical(axes, learned.physical)
        if len(true):
            axes.plot(true.real, true.imag, "+", color=TRUTH, markersize=9, markeredgewidth=2, label="truth")
        axes.set(xlabel="real part (1/s)", ylabel="imaginary part (rad/s)")
        _names(axes, values[slow])
        if not slow.all():
            fast = ", ".join(_named(value) for value in values[~slow] if value.imag >= 0)
            axes.annotate(f"◂ {fast}", (0.01, 0.53), xycoords="axes fraction", fontsize=7.5)
        legend_above(axes)
        note(
            figure,
            "Dots: draws from the uncertainty of A, without closed-loop bias. Rays: ζ = 0.2 to 0.8.",
        )
    return figure


def _physical(axes: Axes, read: Physical | None) -> None:
    """Those of damping and lag, where both are reported, with the interval of the damping."""
    if read is None or set(read.status.values()) != {"reported"}:
        return
    half = read.interval(LEVEL).damping
    style: dict[str, Any] = {"color": PHYSICAL, "alpha": BAND_OPACITY, "linewidth": 0}
    axes.fill_between([-read.damping - half, -read.damping + half], *(BAR * np.array(axes.get_ylim())), **style)
    ends = [-read.damping, -1 / read.lag]
    axes.plot(ends, [0, 0], "s", color=PHYSICAL, markersize=5, label="physical parameters")


def _cloud(axes: Axes, drawn: Complex) -> None:
    """Those inside the plane."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    points = drawn.ravel()
    inside = (points.real > left) & (points.real < right) & (points.imag > bottom) & (points.imag < top)
    shown = points[inside]
    axes.plot(shown.real, shown.imag, ".", color=PREDICTED, alpha=0.45, markersize=3, markeredgewidth=0)


def uncertain_poles(learned: Learned) -> Iterator[Pole]:
    """The n poles of the model, each with its covariance to first order in that of A."""
    A, n = learned.model.A, len(learned.model.A)
    scatter = learned.scatter
    covariance, freedom = (learned.theta_covariance, MANY) if scatter is None else scatter
    values, modes = np.linalg.eig(A)
    for value, left, right in zip(values, np.linalg.pinv(modes), modes.T, strict=True):
        slope = np.outer(left, right).ravel()  # of the eigenvalue by the entries of A
        both = np.array([slope.real, slope.imag])
        yield Pole(complex(value), both @ covariance[: n * n, : n * n] @ both.T, freedom)


def _region(axes: Axes, pole: Pole, values: Complex) -> None:
    """The ellipse, or the interval of a real pole, if it is too small to reach another pole."""
    name = "" if "90 % region" in axes.get_legend_handles_labels()[1] else "90 % region"
    style: dict[str, Any] = {"color": BAND, "alpha": BAND_OPACITY, "linewidth": 0, "label": name}
    others = np.abs(values - pole.value)
    nearest = float(others[others > 0].min(initial=np.inf))
    if not pole.value.imag:
        half = float(half_width(pole.covariance[0, 0], LEVEL, pole.freedom))
        if half < nearest:
            ends = [pole.value.real - half, pole.value.real + half]
            axes.fill_between(ends, *(BAR * np.array(axes.get_ylim())), **style)
        return
    variances, directions = np.linalg.eigh(pole.covariance)
    # Hotelling: two numbers whose covariance has so many degrees of freedom.
    axis = np.sqrt(2 * fisher.ppf(LEVEL, 2, pole.freedom) * variances.clip(0))
    if axis.max() < nearest:
        angle = np.degrees(np.arctan2(directions[1, 0], directions[0, 0]))
        place = (pole.value.real, pole.value.imag)
        axes.add_patch(Ellipse(place, *(2 * axis), angle=angle, **style))


def _plane(axes: Axes, values: Complex) -> None:
    """Ranges of the axes, the unstable half, and lines of equal damping ratio."""
    left, right = min(float(values.real.min()), 0.0), max(float(values.real.max()), 0.0)
    top = max(float(np.abs(values.imag).max()), 0.25 * (right - left), 1e-3)
    span = right - left or 1.0
    left, right, top = left - MARGIN * span, right + MARGIN * span / 2, (1 + MARGIN) * top
    axes.set(xlim=(left, right), ylim=(-top, top))
    axes.axvspan(0, right, color=BAD, alpha=HELD_OUT_OPACITY, linewidth=0)
    small: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "fontsize": 7.5}
    axes.annotate("unstable", (1, 0), (-3, 4), ha="right", color=BAD, **small)
    axes.axhline(0, **HAIRLINE)
    for ratio in DAMPING_RATIOS:
        slope = np.sqrt(1 - ratio**2) / ratio
        end = max(left, -top / slope)
        for sign in (1, -1):
            axes.plot([0, end], [0, -sign * slope * end], **HAIRLINE | {"alpha": 0.35})


def _names(axes: Axes, values: Complex) -> None:
    """Frequency and damping ratio, or the time constant, beside each pole above or on the real axis."""
    middle, above = sum(axes.get_xlim()) / 2, True
    for value in sorted(values[values.imag >= 0], key=lambda pole: pole.real):
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7.5}
        if value.imag:
            side = -1 if value.real > middle else 1
            place, style = (8 * side, 6), style | {"ha": "left" if side > 0 else "right"}
        else:
            place, above, style = (0, 9 if above else -15), not above, style | {"ha": "center"}
        axes.annotate(_named(value), (value.real, value.imag), place, **style)


def _named(value: complex) -> str:
    size = abs(value)
    if value.imag:
        return f"{size / (2 * np.pi):.2g} Hz, ζ = {-value.real / size:.2g}"
    return f"{1 / size:.2g} s" if size else "integrator"
