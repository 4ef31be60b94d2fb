"""The pages of a comparison and of a choice of the model order."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.comparison import Comparison
from mavdem.dem.order.choice import OrderChoice
from mavdem.page.document import render_page
from mavdem.report.comparison import comparison_report
from mavdem.report.order import order_report


def comparison_page(comparison: Comparison, from_zero: bool = False) -> str:
    """The HTML of a comparison; ``from_zero``: forecasts start from state 0."""
    return render_page(
        "DEM and other methods",
        f"Forecasts of the same windows of {_listed(comparison.flights)}.",
        comparison_report(comparison, from_zero),
    )


def order_page(choice: OrderChoice, names: Sequence[str]) -> str:
    """The HTML of a choice of the model order; ``names`` are those of its flights."""
    return render_page(
        "Model order",
        f"The number of states that {_listed(names)} show, by the free energy.",
        order_report(choice, names),
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
