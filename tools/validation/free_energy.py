#!/usr/bin/env python
"""Compares the sum of the free energy F(t) over the samples with the reported free energy action F̄; prints two tables.

F̄ of a model is the sum of F(t) over the samples that it was learned from, so that they must agree up to rounding.

First table, offline: a model is learned from the settled flight of each log. The table has the sum of F(t), F̄, and the
largest difference between them in any of their terms.

Second table, live: the flight is given to the online learner sample by sample, which learns a model again and again.
The table has the largest difference of a learning run between the sum of F(t), over the samples that it learned from,
and its F̄. It also has F(t) of the samples as streamed, each by the model that was learned before it.

Usage: tools/validation/free_energy.py [--seconds S of each log] LOG ...
"""

from pathlib import Path

import click
import numpy as np
import pandas as pd

from mavdem import Flight, Learned, OnlineLearner, learn, read_flight
from mavdem.errors import NotLearnable, Unreadable


def offline_row(learned: Learned) -> dict[str, float]:
    """Compares the sum of F(t) over a model's training samples with its reported F̄, as a whole and term by term.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Returns:
        The row of the first table by column, all in nats but the number of samples.
    """
    differences_of_terms = []
    for name, terms_of_samples in learned.free_energy_terms_of_samples().items():
        # The terms of F̄ are recorded at each iteration of the fit; the last ones belong to the model. Of F(t) there
        # is one term more, the mean field, which sums to zero over the samples and is not a term of F̄.
        terms_by_iteration = learned.free_energy.terms.get(name)
        reported_term = 0.0 if terms_by_iteration is None else terms_by_iteration[-1]
        differences_of_terms.append(abs(terms_of_samples.sum() - reported_term))
    free_energies = learned.free_energy_of_samples
    return {
        "samples": len(free_energies),
        "sum of F(t)": free_energies.sum(),
        "F̄": learned.free_energy[-1],
        "largest difference of a term": max(differences_of_terms),
        "F(t), mean": free_energies.mean(),
        "F(t), sd": free_energies.std(),
    }


def live_row(flight: Flight) -> dict[str, float]:
    """Gives a flight to the online learner, and compares the sum of F(t) with F̄ for each model that it learns.

    Args:
        flight: samples of the stream, without a gap.

    Returns:
        The row of the second table by column, all in nats but the number of learning runs. "F(t) as streamed" and the
        "mean" after it are of the values that the learner returned with each sample.
    """
    learner = OnlineLearner(
        dt=flight.dt, n_inputs=flight.inputs.shape[1], n_outputs=flight.outputs.shape[1]
    )
    models: list[Learned] = []
    streamed_free_energies = []
    for time, outputs, inputs in zip(flight.time, flight.outputs, flight.inputs, strict=True):
        estimate = learner.update(time, outputs, inputs)
        if np.isfinite(estimate.free_energy):
            streamed_free_energies.append(estimate.free_energy)
        # The learner replaces its model whenever a learning run has ended.
        model = learner.learned
        if model is not None and (not models or model is not models[-1]):
            models.append(model)
    sums = np.array([model.free_energy_of_samples.sum() for model in models])
    # F̄ of a model is F̄ in the last iteration of its fit.
    actions = np.array([model.free_energy[-1] for model in models])
    sample_counts = np.array([len(model.free_energy_of_samples) for model in models])
    return {
        "learning runs": len(models),
        "sum of F(t), last run": sums[-1],
        "F̄, last run": actions[-1],
        "largest difference of a run": abs(sums - actions).max(),
        "F̄ a sample, mean of runs": (actions / sample_counts).mean(),
        "F(t) as streamed, median": np.median(streamed_free_energies),
        "mean": np.mean(streamed_free_energies),
    }


@click.command(help=__doc__)
@click.option("--seconds", default=20.0, help="Longest part of a log that is learned from, s.")
@click.argument("logs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(seconds: float, logs: tuple[Path, ...]) -> None:
    """Learns a model of each log, offline and online, and prints two tables: the sum of F(t) beside the reported F̄.

    A log from which nothing can be learned is named on standard error with the reason.

    Args:
        seconds: longest part of a log that is learned from, s, from its beginning.
        logs: files of the logs.
    """
    offline_rows = []
    live_rows = []
    for path in logs:
        try:
            flight = read_flight(path)
            flight = flight[: round(seconds / flight.dt)]
            offline_rows.append({"log": path.name} | offline_row(learn(flight)))
            live_rows.append({"log": path.name} | live_row(flight))
        except (NotLearnable, Unreadable) as error:
            click.echo(f"{path.name}: {error}", err=True)
    for rows in (offline_rows, live_rows):
        print(pd.DataFrame(rows).to_string(index=False, float_format="{:,.6g}".format))
        print()


if __name__ == "__main__":
    main()
