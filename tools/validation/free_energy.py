#!/usr/bin/env python
"""The sum of F(t) over the samples beside the reported F̄, of logs and of the same logs as streams; prints two tables.

Offline a model is learned from the settled flight of each log: the sum of F(t), F̄, and their largest difference by
term. Live the flight is given to the online learner sample by sample: for each learning run the sum of F(t) over the
samples that it learned from, beside its F̄; and of the stream the mean F(t), each sample by the model before it, beside
the mean of the models' F̄ a sample.

Usage: tools/validation/free_energy.py [--seconds S of each log] LOG ...
"""

from pathlib import Path

import click
import numpy as np
import pandas as pd

from mavdem import Flight, Learned, OnlineLearner, learn, read_flight
from mavdem.errors import NotLearnable, Unreadable


def offline_row(learned: Learned) -> dict[str, float]:
    """Returns the sum of F(t) beside F̄ of a model, nats."""
    sums = {name: terms.sum() for name, terms in learned.free_energy_terms_of_samples().items()}
    reported = {name: terms[-1] for name, terms in learned.free_energy.terms.items()}
    differences = [abs(total - reported.get(name, 0.0)) for name, total in sums.items()]
    return {
        "samples": len(learned.free_energy_of_samples),
        "sum of F(t)": learned.free_energy_of_samples.sum(),
        "F̄": learned.free_energy[-1],
        "largest difference of a term": max(differences),
        "F(t), mean": learned.free_energy_of_samples.mean(),
        "F(t), sd": learned.free_energy_of_samples.std(),
    }


def live_row(flight: Flight) -> dict[str, float]:
    """Returns the sums of F(t) beside F̄ of all learning runs of a stream, nats.

    Args:
        flight: the samples of the stream, without a gap.
    """
    r = flight.inputs.shape[1]
    m = flight.outputs.shape[1]
    learner = OnlineLearner(dt=flight.dt, n_inputs=r, n_outputs=m)
    models: list[Learned] = []
    streamed = []
    for time, outputs, inputs in zip(flight.time, flight.outputs, flight.inputs, strict=True):
        estimate = learner.update(time, outputs, inputs)
        if np.isfinite(estimate.free_energy):
            streamed.append(estimate.free_energy)
        model = learner.learned
        if model is not None and (not models or model is not models[-1]):
            models.append(model)
    sums = np.array([model.free_energy_of_samples.sum() for model in models])
    actions = np.array([model.free_energy[-1] for model in models])
    sample_counts = np.array([len(model.free_energy_of_samples) for model in models])
    return {
        "learning runs": len(models),
        "sum of F(t), last run": sums[-1],
        "F̄, last run": actions[-1],
        "largest difference of a run": abs(sums - actions).max(),
        "F̄ a sample, mean of runs": (actions / sample_counts).mean(),
        "F(t) as streamed, median": np.median(streamed),
        "mean": np.mean(streamed),
    }


@click.command(help=__doc__)
@click.option("--seconds", default=20.0, help="Longest part of a log that is learned from, s.")
@click.argument("logs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(seconds: float, logs: tuple[Path, ...]) -> None:
    offline = []
    live = []
    for path in logs:
        try:
            flight = read_flight(path)
            flight = flight[: round(seconds / flight.dt)]
            offline.append({"log": path.name} | offline_row(learn(flight)))
            live.append({"log": path.name} | live_row(flight))
        except (NotLearnable, Unreadable) as error:
            click.echo(f"{path.name}: {error}", err=True)
    for rows in (offline, live):
        print(pd.DataFrame(rows).to_string(index=False, float_format="{:,.6g}".format))
        print()


if __name__ == "__main__":
    main()
