"""The first tab of both dashboards: five plots, and texts such as the events, which are facts (coded findings).

From the top: the angle that the model is of, with its prediction; the motors; the physical parameters; the wind; and
the torque of the wind.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import rerun.blueprint as rrb

from mavdem.facts import Level
from mavdem.facts.event import Event
from mavdem.facts.model import ModelName
from mavdem.fleet.row import utf8_text
from mavdem.report.numbers import TORQUE_UNIT, name_with_unit

PLOT_HEIGHTS = {"angle": 23, "motors": 21, "parameters": 20, "wind": 18, "torque": 18}
"""The plots of the first tab, from the top, with their heights relative to each other.

The legend of the angle has up to six entries, that of the motors as many as there are motors and one, that of the
parameters four, the others three.
"""

SIDE_WIDTH_SHARE = 28
"""Width of the column of texts next to the plots, in percent of the tab."""

EVENT_MARKS = {Level.BAD: "**bad** · ", Level.WATCH: "**watch** · "}
"""What stands before an event of a level that needs attention."""


def plot_titles(
    axis: str,
    angle_unit: str,
    prediction: str,
    motor_unit: str,
    model: ModelName = ModelName.JOINT_VAR,
) -> dict[str, str]:
    """Returns the titles of the five plots of the first tab; each names the model by which its values were estimated.

    Args:
        axis: "roll" or "pitch".
        angle_unit: unit of the angle.
        prediction: name of the prediction that is drawn with the angle, such as "0.25 s ahead".
        motor_unit: unit of the outputs of the motors; empty where they are fractions of the range.
        model: model that makes this prediction.

    Returns:
        Titles by the keys of ``PLOT_HEIGHTS``.
    """
    angle = name_with_unit(axis.capitalize(), angle_unit)
    return {
        "angle": f"{angle}, with {prediction} · model: {model}",
        "motors": name_with_unit("Motors", motor_unit),
        "parameters": f"Physical parameters of {axis} · model: {ModelName.GRAY_BOX}",
        "wind": f"Wind, m/s · model: {ModelName.WIND}",
        "torque": f"Wind torque on {axis}, {TORQUE_UNIT.name} · model: {ModelName.GRAY_BOX}",
    }


def free_energy_title() -> str:
    """Returns the title of the plot of the free energy F(t), and of F̄, which names the model of these figures."""
    energy = "Free energy F(t) of each sample, and F̄ per sample of each learning run, nats"
    return f"{energy} · model: {ModelName.DEM}"


def height_shares(names: Collection[str]) -> dict[str, float]:
    """Returns the height of each plot of the first tab as a fraction of the height of the tab, which they fill.

    Args:
        names: names of the plots that there are, keys of ``PLOT_HEIGHTS``, which has their relative heights.
    """
    total_height = sum(PLOT_HEIGHTS[name] for name in names)
    return {name: PLOT_HEIGHTS[name] / total_height for name in names}


class SideTexts(NamedTuple):
    """Texts next to the plots."""

    views: Sequence[rrb.View]
    """Views of the texts, from the top."""

    shares: Sequence[float]
    """Their heights relative to each other."""


def first_tab(plots: Mapping[str, rrb.View], side_texts: SideTexts) -> rrb.Container:
    """Returns the layout of the first tab: the plots one below the other, and a column of texts on their right.

    Args:
        plots: views of the plots that there are, by the keys of ``PLOT_HEIGHTS``.
        side_texts: texts next to the plots, with their heights.
    """
    plot_heights = [PLOT_HEIGHTS[name] for name in plots]
    plot_column = rrb.Vertical(*plots.values(), row_shares=plot_heights)
    text_column = rrb.Vertical(*side_texts.views, row_shares=list(side_texts.shares))
    # The widths are percentages of the tab.
    widths = [100 - SIDE_WIDTH_SHARE, SIDE_WIDTH_SHARE]
    return rrb.Horizontal(plot_column, text_column, column_shares=widths, name="Flight")


def events_text(events: Iterable[Event]) -> str:
    """Lists events as Markdown, for the column of texts beside the plots.

    The viewer has an event log of its own, but cuts off its long lines, while it wraps the lines of this text.

    Args:
        events: events in the order in which they are listed.

    Returns:
        The text, with a paragraph for each event.
    """
    lines = ["**Events**"]
    for event in events:
        mark = EVENT_MARKS.get(event.fact.level, "")
        time = f"{event.seconds:.1f} s · " if event.has_time else ""
        lines.append(f"{time}{mark}{event.sentence}")
    return utf8_text("\n\n".join(lines))
