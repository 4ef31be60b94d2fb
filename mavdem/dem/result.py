"""From a finished fit, in the engine's units, to the result of learning in physical ones."""

from __future__ import annotations

import numpy as np

from mavdem.dem.engine.linalg import Array, inverse
from mavdem.dem.engine.trace import FreeEnergy, Learning
from mavdem.dem.fitting import Fit, held_by_prior, of_vehicle
from mavdem.dem.forecast.forecasts import TrainingForecasts
from mavdem.dem.learned import Learned
from mavdem.dem.record import Record
from mavdem.dem.smoothness import SmoothnessEstimate
from mavdem.dem.uncertainty import (
    ParameterUncertainty,
    SandwichCovariance,
    marginal_information,
    undetermined_directions,
)


def learned_of(
    fit: Fit,
    record: Record,
    uncertainty: ParameterUncertainty,
    free_energy_of_samples: Array,
    training_forecasts: TrainingForecasts,
    smoothness_estimate: SmoothnessEstimate | None,
    cautions: tuple[str, ...],
) -> Learned:
    """The result of a finished ``fit``, in the engine's units, to the training data ``record`` it was made from.

    ``uncertainty`` is of the fit's θ, ``free_energy_of_samples`` of its generalized samples;
    ``training_forecasts``, ``smoothness_estimate`` and ``cautions`` were found outside the fit.
    """
    order, ascent, scaling = fit.model.n, fit.ascent, fit.scaling
    scale = scaling.parameter_scale(order)
    motors = of_vehicle(order, record.inputs.shape[1], fit.model.m, scaling.constant)
    of_motors = np.ix_(motors, motors)
    precision = fit.model.prior.theta_precision
    prior_covariance = inverse(precision) * np.outer(scale, scale)
    covariance, scatter = ascent.belief.theta_covariance, uncertainty.scatter
    if fit.simulation_fit is not None:
        covariance = fit.simulation_fit.theta_covariance(inverse(precision))
        scatter = SandwichCovariance(covariance, fit.simulation_fit.freedom)
    covariance = covariance * np.outer(scale, scale)
    held = held_by_prior(np.diag(precision)[motors], scale[motors], fit.settings, record)
    information = marginal_information(uncertainty.information, precision, motors)
    return Learned(
        settings=fit.settings,
        model=scaling.physical_model(ascent.belief.theta, order),
        theta_covariance=covariance[of_motors],
        scatter=scatter and scatter._replace(covariance=(scatter.covariance * np.outer(scale, scale))[of_motors]),
        undetermined=undetermined_directions(
            information, precision[of_motors], ~held, (order, record.inputs.shape[1], fit.model.m)
        ),
        prior_sd=np.sqrt(np.diag(prior_covariance))[motors],
        known=held,
        free_energy=FreeEnergy(dict(ascent.terms)),
        free_energy_of_samples=free_energy_of_samples,
        learning=Learning(
            (ascent.theta * scale)[:, motors].copy(),
            (ascent.theta_sd * scale)[:, motors].copy(),
            ascent.lambda_,
            ascent.lambda_sd,
        ),
        converged=fit.converged,
        dt=record.dt,
        smoothness=fit.smoothness,
        smoothness_estimate=smoothness_estimate,
        record=record,
        training_forecasts=training_forecasts,
        cautions=cautions,
        scaling=scaling,
        predictor=fit.predictor,
        state_map=np.ascontiguousarray(ascent.state_map),
        theta=ascent.belief.theta,
        simulation_fit=fit.simulation_fit,
    )
