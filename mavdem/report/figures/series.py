"""Series: what was measured, forecast and learned, over time, lag or iteration; and what each motor does.

:class:`Plots` has all figures of one model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mavdem.analysis.findings import known_wind
from mavdem.analysis.residuals import BOUND_LEVEL, LAG_SECONDS, residuals
from mavdem.condition.condition import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.held_out import (
    CONSTANT_MEAN,
    FORECAST,
    HeldOut,
    held_out_test,
    held_out_windows,
)
from mavdem.flight import Flight
from mavdem.report import palette
from mavdem.report.figures import style
from mavdem.report.figures.style import (
    HAIRLINE,
    THIN,
    Room,
    band,
    legend_above,
    not_blown_up,
    note,
    picture,
    plain,
)
from mavdem.report.figures.systems import SystemPlots
from mavdem.report.labels import AxisCommand, Labels
from mavdem.report.numbers import TORQUE, per, readable
from mavdem.report.palette import HELD_OUT_OPACITY, MEASURED, TRUTH, distinct
from mavdem.report.timeline import Timeline

STILL_POINTS = 500  # of a line in the still picture of the timeline


@dataclass(frozen=True, eq=False, repr=False)
class Plots(SystemPlots):
    """The figures of the model ``learned``; each method returns a ``matplotlib.figure.Figure``.

    Notebooks show them, and ``savefig`` writes them: as PNG or, with text that stays text, as SVG.
    """

    learned: Learned

    def __repr__(self) -> str:
        names = [name for name in dir(self) if not name.startswith("_") and name != "learned"]
        return f"<Plots: {', '.join(f'{name}()' for name in names)} of {self.learned!r}>"

    def forecast(self, held_out: Flight | HeldOut | None = None, output: int = 0) -> Figure:
        """Draws an output beside forecasts of samples that no model saw, and the error of every window.

        Args:
            held_out: the flight right after the training data, as one window; or the windows of
                ``mavdem.evaluate.held_out_windows``, for which five models are trained unless given.
            output: which, in the order of the flight's outputs.
        """
        record = self.learned.record
        labels = Labels.of(self.learned)
        times = np.split(style.sample_times(record), record.starts[1:])
        flights = [
            Flight(time, *channels, record.dt, *labels, effect_directions=record.effect_directions)
            for time, channels in zip(times, record.segments, strict=True)
        ]
        if held_out is None:
            held_out = held_out_windows(flights, self.learned.settings)
        elif isinstance(held_out, Flight):
            held_out = held_out_test(flights[-1], held_out, self.learned)
        return forecast(held_out, labels, range(len(labels.output_names))[output])

    def residuals(self, output: int = -1) -> Figure:
        """Draws one-step residuals over time, their autocorrelation and their correlation with the command.

        Correlations beyond the 99 % bounds are what the model leaves: of white residuals that do not depend on the
        command, one in a hundred would be. The bounds of the second allow for autocorrelation of both (Ljung, System
        Identification, 2nd ed., sec. 16.6). The ``output`` is the last one, a rate, unless given.
        """
        learned = self.learned
        labels = Labels.of(learned)
        command = AxisCommand.of(learned)
        record = learned.record
        output = range(len(labels.output_names))[output]
        unit = readable(labels.output_units[output])
        name = labels.output_names[output]
        found = residuals(learned, output)
        with picture(3.8, Room(rows=0.7, columns=0.6)) as figure:
            axes = figure.subplot_mosaic(
                [["time", "time"], ["auto", "across"]], height_ratios=[1, 1.25]
            )
            series = style.sample_times(record), unit.scale * found.errors
            time, shown = (style.with_gaps(record, values) for values in series)
            axes["time"].plot(time, shown, color=palette.PREDICTED, linewidth=0.6)
            largest = 1.15 * float(np.nanmax(np.abs(shown)))
            axes["time"].set(
                xlabel="time since boot (s)",
                ylabel=f"residual ({unit.name})",
                ylim=(-largest, largest),
            )
            axes["time"].set_title(
                f"one-step residual of {name}: RMS {unit.scale * np.nanstd(found.errors):.2g} {unit.name}"
            )
            panels = (
                (axes["auto"], found.lag[1:], found.auto[1:]),
                (axes["across"], found.lag, found.across),
            )
            for (panel, shift, values), bound in zip(panels, found.bounds, strict=True):
                panel.axhspan(
                    -bound, bound, color=palette.BOUND, alpha=2 * HELD_OUT_OPACITY, linewidth=0
                )
                panel.axhline(0, **HAIRLINE)
                panel.vlines(shift, 0, values, color=palette.PREDICTED, linewidth=1.3)
                limit = 1.1 * max(float(np.abs(values).max()), 1.5 * bound)
                panel.set(ylim=(-limit, limit), xlim=(0, LAG_SECONDS))
            axes["auto"].set(xlabel="lag (s)", title="autocorrelation")
            axes["across"].set(
                xlabel=f"after the {command.name} (s)", title=f"correlation with {command.name}"
            )
            note(
                figure, f"Grey: where {100 * BOUND_LEVEL:.0f} % of such correlations lie by chance."
            )
        return figure

    def disturbance(self, truth: Array | None = None) -> Figure:
        """Draws the wind torque over time with band and gusts, its spectral density, and the ``truth`` (T,), rad/s².

        Raises:
            ValueError: the wind torque is not identifiable.
        """
        learned = self.learned
        wind = known_wind(learned.wind_torque, learned.physical)
        record = learned.record
        unit = TORQUE
        if wind is None:
            raise ValueError(
                "there is no wind torque to show: it is not identifiable in this flight"
            )
        with picture(4.0, Room(left=0.8, rows=0.7)) as figure:
            above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [3, 2]})
            above.axhline(0, **HAIRLINE)
            clock = style.sample_times(record)
            time = style.with_gaps(record, clock)
            torque, half = (
                unit.scale * style.with_gaps(record, values) for values in (wind.torque, wind.band)
            )
            band(above, time, torque - half, torque + half, palette.DISTURBANCE, "90 % band")
            if truth is not None:
                above.plot(
                    time,
                    unit.scale * style.with_gaps(record, truth),
                    color=TRUTH,
                    linewidth=1.6,
                    label="truth",
                )
            above.plot(time, torque, color=palette.DISTURBANCE, linewidth=THIN, label="wind torque")
            for number, gust in enumerate(wind.gusts):
                ends = clock[gust.sample], clock[gust.sample] + gust.length
                above.axvspan(
                    *ends,
                    color=palette.GUST,
                    alpha=0.3,
                    linewidth=0,
                    label="" if number else "gust",
                )
            above.set(xlabel="time since boot (s)", ylabel=f"wind torque ({unit.name})")
            legend_above(above)
            # Hz: what is faster is noise of the sensors
            shown = (wind.spectrum[0] > 0) & (wind.spectrum[0] <= 10.0)
            frequency, density, model = (values[shown] for values in wind.spectrum)
            below.plot(
                frequency, unit.scale**2 * density, color=palette.DISTURBANCE, label="wind torque"
            )
            below.plot(
                frequency, unit.scale**2 * model, color=MEASURED, label="model of it", dashes=(4, 2)
            )
            below.set(
                xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"({unit.name})²/Hz"
            )
            top = unit.scale**2 * float(max(density.max(), model.max()))
            below.set_ylim(np.clip(below.get_ylim()[0], top / 1e5, top / 1e2), 2 * top)
            for axis in (below.xaxis, below.yaxis):
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter("")  # which would overlap
            legend_above(below)
        return figure

    def motors(self, hover: HoverFigures | None = None) -> Figure:
        """Draws a row a motor: its control effectiveness and, by ``mavdem.hover``, its trim deviation and its headroom.

        Raises:
            ValueError: control effectiveness is not identifiable, and there is no ``hover``.
        """
        learned = self.learned
        labels = Labels.of(learned)
        physical = learned.physical
        # What drives the model may be no motor but the demand, which has no row here.
        of_motors = hover is None or len(hover.motors) == len(labels.input_names)
        if physical is not None and not (of_motors and physical.identifiable):
            physical = None
        if physical is None and hover is None:
            raise ValueError(
                "there are no motors to show: control effectiveness is not identifiable in this flight"
            )
        names = labels.input_names if hover is None else hover.motors
        rows = np.arange(len(names))
        # "1 front right"
        shown = [name.removeprefix("motor ").replace(" (", " ").rstrip(")") for name in names]
        room = Room(left=0.12 + 0.07 * max(map(len, shown)))  # inches a letter
        with picture(0.95 + 0.3 * len(names), room) as figure:
            panels = np.atleast_1d(
                figure.subplots(1, (physical is not None) + 2 * (hover is not None), sharey=True)
            )
            panels[0].set_yticks(rows, shown)
            for axes in panels:
                axes.grid(False, axis="y")
                axes.tick_params(axis="y", length=0)
                axes.set_ylim(len(names) - 0.4, -0.6)
            if physical is not None:
                half = TORQUE.scale * physical.interval(LEVEL).effect
                _bars(panels[0], TORQUE.scale * physical.effect, half, 0.0, palette.PREDICTED)
                panels[0].set(title="effectiveness", xlabel=per(TORQUE, labels.input_units[0]))
                note(
                    figure, f"Whiskers: {100 * LEVEL:.0f} % intervals of the control effectiveness."
                )
            if hover is not None:
                imbalance, headroom = panels[-2:]
                # Less than 5 % is not worth a look.
                _bars(
                    imbalance, np.array(hover.imbalance), np.zeros(len(names)), 5.0, palette.COMMAND
                )
                imbalance.set(title="trim", xlabel="deviation (%)")
                # The range of each motor: up to its trim, up to the highest output, and what is left.
                headroom.barh(
                    rows,
                    100 * (1 - np.array(hover.headroom)),
                    0.55,
                    color=palette.COMMAND,
                    alpha=0.35,
                )
                trim = 100 * np.array(hover.trim_of_range)
                headroom.plot(
                    trim, rows, "|", color=palette.COMMAND, markersize=13, markeredgewidth=2.2
                )
                text: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": 7.5}
                for row, left in zip(rows, hover.headroom, strict=True):
                    headroom.annotate(
                        f"{100 * left:.0f} %",
                        (100, row),
                        (-1, 0),
                        textcoords="offset points",
                        **text,
                    )
                headroom.set(xlim=(0, 100), title="headroom", xlabel="output (% of full)")
        return figure

    def learning(self) -> Figure:
        """Draws F̄ below its maximum, and the terms it is the sum of, by iteration; iteration 0 is the prior."""
        energy = self.learned.free_energy
        with picture(3.4, Room(left=0.75, right=1.75, rows=0.28)) as figure:
            action, terms = figure.subplots(
                2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 4]}
            )
            # nats: less is no more learning
            gap = np.maximum(energy.total.max() - energy.total, 1e-3)
            action.plot(gap, color=palette.PREDICTED, marker="o", markersize=2.5)
            title = f"F̄ below its maximum of {energy.total.max():,.0f} nats".replace("-", "−")
            action.set(yscale="log", ylabel="nats", title=title)
            action.yaxis.set_major_formatter("{x:g}")

            # Those that change most, less their last value: where F̄ increases, the sum of all does.
            change = {name: term - term[-1] for name, term in energy.terms.items()}
            largest = sorted(change, key=lambda name: -np.abs(change[name]).max())[:6]
            for number, name in enumerate(name for name in change if name in largest):
                terms.plot(
                    change[name],
                    color=distinct(number),
                    label=name.replace("prediction error of", "error of"),
                )
            terms.set_yscale("symlog", linthresh=10.0)
            terms.set_yticks([-1e6, -1e3, 0, 1e3, 1e6])
            terms.minorticks_off()
            terms.yaxis.set_major_formatter("{x:g}")

            terms.xaxis.set_major_locator(MaxNLocator(integer=True))
            terms.set(ylabel="nats", title="terms of F̄, less their last value", xlabel="iteration")
            terms.axhline(0, **HAIRLINE)
            terms.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
        return figure


def forecast(held: HeldOut, labels: Labels, output: int = 0, windows: int = 8) -> Figure:
    """Draws an output beside its forecasts in some windows that no model saw, and the error in every window.

    Shown in full are ``windows`` neighbours with errors nearest to the median, not the best; each is forecast anew.

    Raises:
        ValueError: no windows.
    """
    if not len(held):
        raise ValueError("there is no held-out window")
    unit = readable(labels.output_units[output])
    name = labels.output_names[output]
    shown = typical_windows(held, windows)
    several = len(held) > 1
    measured, mean, half = (
        unit.scale * values[..., output]
        for values in (held.measured, held.forecasts[FORECAST], held.band)
    )
    with picture(4.0 if several else 3.2, Room(rows=0.45)) as figure:
        axes, *below = np.atleast_1d(
            figure.subplots(1 + several, 1, gridspec_kw={"height_ratios": [5, 3][: 1 + several]})
        )
        time, lines, middle, half_width = (
            np.pad(values[shown], ((0, 0), (0, several)), constant_values=np.nan).ravel()
            for values in (held.time, measured, mean, half)
        )
        axes.plot(time, lines, color=MEASURED, linewidth=1.1, label="measured", zorder=2.1)
        axes.plot(time, middle, color=palette.PREDICTED, label="forecast")
        band(axes, time, middle - half_width, middle + half_width, palette.PREDICTED, "90 % band")
        not_blown_up(axes, measured[shown], 0.5)
        axes.vlines(
            held.time[shown, 0], *axes.get_ylim(), MEASURED, linewidth=0.6, alpha=0.5, zorder=1
        )
        axes.set(ylabel=f"{name} ({unit.name})", xlabel="" if several else "time since boot (s)")
        legend_above(axes)
        for errors in below:
            starts = held.time[:, 0]
            length = held.seconds
            ours, constant = (
                unit.scale * np.sqrt(held.squared_errors(method)[:, output])
                for method in (FORECAST, CONSTANT_MEAN)
            )
            ends = starts + 0.8 * length
            label = "constant mean (baseline)"
            bars = (
                np.column_stack([starts, ends, ends]).ravel(),
                np.column_stack([ours, ours, np.nan * ours]).ravel(),
            )
            errors.fill_between(
                bars[0], 0, bars[1], color=palette.PREDICTED, linewidth=0, label="forecast"
            )
            errors.hlines(
                constant, starts, ends, color=palette.BASELINE, linewidth=1.6, label=label
            )
            span = starts[shown][0], starts[shown][-1] + length
            errors.axvspan(
                *span, color=MEASURED, alpha=HELD_OUT_OPACITY, linewidth=0, label="shown above"
            )
            errors.set_xlim(starts[0], starts[-1] + length)
            errors.set_ylim(
                0, 1.05 * max(np.max(constant), np.percentile(ours[np.isfinite(ours)], 95))
            )
            errors.set(xlabel="time since boot (s)", ylabel=f"RMSE ({unit.name})")
            legend_above(errors)
    return figure


def still(timeline: Timeline) -> Figure:
    """Draws the rows of a ``timeline`` below each other, as the page's script does without zooming."""
    rows = list(timeline.thinned(STILL_POINTS))
    ink = {"fontsize": 6.5, "va": "bottom"}
    with picture(
        0.5 + 0.62 * len(rows), Room(left=0.65, right=1.3, rows=0.1), 1.8 * style.WIDTH
    ) as figure:
        panels = np.atleast_1d(figure.subplots(len(rows), 1, sharex=True))
        for axes, (row, grid, found) in zip(panels, rows, strict=True):
            for start, end in timeline.trained:
                axes.axvspan(start, end, color=MEASURED, alpha=HELD_OUT_OPACITY, linewidth=0)
            for event in (one for one in timeline.events if one.is_alarm):
                axes.axvline(event.seconds, color=palette.BAD, linewidth=0.7, linestyle=(0, (3, 2)))
            for line, (mean, half) in zip(row.lines, found, strict=True):
                if line.half is not None:
                    band(axes, grid, mean - half, mean + half, line.colour)
                axes.plot(grid, mean, color=line.colour, linewidth=THIN, label=plain(line.name))
            values = np.concatenate([mean for mean, _ in found])
            if np.isfinite(values).any():
                not_blown_up(axes, values, 0.3)
            beside = {
                "loc": "center left",
                "bbox_to_anchor": (1.005, 0.5),
                "handlelength": 1,
                "alignment": "left",
            }
            axes.legend(
                **beside,
                fontsize=6.5,
                title=row.title,
                title_fontproperties={"weight": "bold", "size": 7},
            )
            axes.set_ylabel(row.unit)
            axes.yaxis.set_major_locator(MaxNLocator(3))
        for start, _, name in timeline.modes:
            panels[0].annotate(
                plain(name), (start, 1.02), xycoords=("data", "axes fraction"), **ink
            )
        panels[-1].set(xlabel="time since boot (s)", xlim=timeline.span)
    return figure


def typical_windows(held: HeldOut, windows: int) -> slice:
    """Returns the neighbouring windows, without a gap, whose median error ratio is nearest to that of all."""
    ratios = np.nan_to_num(held.error_ratios(), posinf=np.finfo(float).max)
    count = min(windows, len(held))
    neighbours = np.lib.stride_tricks.sliding_window_view
    off = np.abs(np.median(neighbours(ratios, count), axis=1) - np.median(ratios))
    # less is left over at the end of a part
    gaps = np.append(np.diff(held.time[:, 0]) > 2 * held.seconds, False)
    broken = neighbours(gaps, count)[:, : count - 1].any(axis=1)
    start = int(np.argmin(np.where(broken & ~broken.all(), np.inf, off)))
    return slice(start, start + count)


def _bars(axes: Axes, values: Array, half: Array, least: float, colour: str) -> None:
    """Bars about 0 with intervals, where there are any; the axis shows ``least`` at least."""
    rows = np.arange(len(values))
    axes.barh(rows, values, 0.55, color=colour)
    if half.any():
        axes.errorbar(
            values,
            rows,
            xerr=half,
            fmt="none",
            ecolor=palette.INK_ON_LIGHT,
            capsize=3,
            linewidth=1.2,
        )
    axes.axvline(0, **HAIRLINE)
    largest = 1.15 * max(least, float((np.abs(values) + half).max()))
    axes.set_xlim(-largest, largest)
