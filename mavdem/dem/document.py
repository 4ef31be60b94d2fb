"""A learnt model as a JSON document, and back: every field by its name, arrays as nested lists."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.choice import Candidate
from mavdem.dem.colour import Colour
from mavdem.dem.determined import Direction
from mavdem.dem.layout import Layout
from mavdem.dem.model import LinearModel, Transition
from mavdem.dem.prediction import Predictor
from mavdem.dem.record import LARGEST, SHORTEST_STEP, Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.scatter import Scatter
from mavdem.dem.settings import Settings
from mavdem.dem.trace import FreeEnergy, Learning
from mavdem.dem.trajectory import Trajectory
from mavdem.dem.trials import Unseen

if TYPE_CHECKING:
    from mavdem.dem.learned import Learned

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Of a covariance: how far below zero its least variance may be, over the largest."""

ARRAYS = ("theta_covariance", "prior_sd", "free_energy_of_samples", "state_map", "theta")


def values_of(learned: Learned) -> dict[str, Any]:
    """The fields of a learnt model as plain JSON values."""
    return {
        "settings": learned.settings.to_dict(),
        "model": _lists(learned.model._asdict()),
        "known": learned.known.tolist(),
        "free_energy": _lists(learned.free_energy.terms),
        "learning": _lists(vars(learned.learning)),
        "settled": learned.settled,
        "unseen": _lists(learned.unseen._asdict()),
        "candidates": [{**vars(c), "error": _finite(c.error)} for c in learned.candidates],
        "dt": learned.dt,
        "smoothness": learned.smoothness,
        "colour": None if learned.colour is None else _colour_values(learned.colour),
        "scatter": None if learned.scatter is None else _lists(learned.scatter._asdict()),
        "undetermined": [
            {"weights": direction.weights.tolist(), "share": direction.share} for direction in learned.undetermined
        ],
        "cautions": list(learned.cautions),
        "inputs": learned.record.inputs.tolist(),
        "outputs": learned.record.outputs.tolist(),
        "segments": list(learned.record.lengths),
        "scaling": _lists(learned.scaling._asdict()),
        "predictor": {
            "transition": _lists(learned.predictor.transition._asdict()),
            "C": learned.predictor.C.tolist(),
            "gain": learned.predictor.gain.tolist(),
            "of_outputs": learned.predictor.of_outputs.tolist(),
            "of_inputs": learned.predictor.of_inputs.tolist(),
        },
        "trajectory": None if learned.trajectory is None else _trajectory_values(learned.trajectory),
        **{name: getattr(learned, name).tolist() for name in ARRAYS},
    }


def fields_of(values: Any) -> dict[str, Any]:
    """The fields of a learnt model by name, from what :func:`values_of` gave.

    Raises:
        ValueError: something is missing, of another kind, or of a shape that does not fit the rest.
    """
    try:
        fields = _fields(values)
        _check(fields)
    except (KeyError, TypeError, AttributeError, IndexError, OverflowError, AssertionError) as error:
        raise ValueError(f"not the document of a learnt model: {type(error).__name__} {error}") from None
    return fields


def _fields(values: Mapping[str, Any]) -> dict[str, Any]:
    predictor, scaling, model = values["predictor"], values["scaling"], LinearModel(**_arrays(values["model"]))
    sizes = len(model.A), model.B.shape[1], len(model.C)
    return {
        "settings": Settings.from_dict(values["settings"]),
        "model": model,
        "known": np.array(values["known"], np.bool_),
        "free_energy": FreeEnergy(_arrays(values["free_energy"])),
        "learning": Learning(**_arrays(values["learning"])),
        "settled": bool(values["settled"]),
        "unseen": Unseen(
            **_arrays({name: values["unseen"][name] for name in ("mse", "weight", "weighted_mse")}),
            motors_share=float(values["unseen"]["motors_share"]),
        ),
        "candidates": tuple(Candidate(**{**c, "error": _or_infinite(c["error"])}) for c in values["candidates"]),
        "dt": float(values["dt"]),
        "smoothness": float(values["smoothness"]),
        "colour": None if values["colour"] is None else _colour(values["colour"]),
        "scatter": None if values["scatter"] is None else _scatter(values["scatter"]),
        "undetermined": tuple(
            Direction(np.array(direction["weights"], np.float64), float(direction["share"]), sizes)
            for direction in values["undetermined"]
        ),
        "cautions": tuple(values["cautions"]),
        "record": Record(
            np.array(values["inputs"], np.float64),
            np.array(values["outputs"], np.float64),
            float(values["dt"]),
            tuple(map(int, values["segments"])),
        ),
        "scaling": Scaling(
            np.array(scaling["input_trim"], float),
            np.array(scaling["input_scale"], float),
            np.array(scaling["output_trim"], float),
            np.array(scaling["output_scale"], float),
            bool(scaling["constant"]),
            np.array(scaling["known"], np.bool_),
        ),
        "predictor": Predictor(
            Transition(**_arrays(predictor["transition"])),
            **_arrays({name: predictor[name] for name in ("C", "gain", "of_outputs", "of_inputs")}),
        ),
        "trajectory": None if values["trajectory"] is None else _trajectory(values["trajectory"], sizes[1]),
        **_arrays({name: values[name] for name in ARRAYS}),
    }


def _scatter(values: Mapping[str, Any]) -> Scatter:
    return Scatter(np.array(values["covariance"], np.float64), float(values["freedom"]))


def _trajectory_values(trajectory: Trajectory) -> dict[str, Any]:
    return {
        **_lists({name: getattr(trajectory, name) for name in ("theta", "places", "covariance", "mse", "gain")}),
        "numbers": trajectory.numbers,
        "horizon": trajectory.horizon,
        "settled": trajectory.settled,
        "terms": _lists(trajectory.terms),
        "layout": None if trajectory.layout is None else _lists(trajectory.layout._asdict()),
    }


def _trajectory(values: Mapping[str, Any], rotors: int) -> Trajectory:
    return Trajectory(
        **_arrays({name: values[name] for name in ("theta", "covariance", "mse", "gain")}),
        places=np.array(values["places"], np.intp),
        numbers=float(values["numbers"]),
        horizon=int(values["horizon"]),
        terms=_arrays(values["terms"]),
        settled=bool(values["settled"]),
        layout=None if values["layout"] is None else _layout(values["layout"], rotors),
    )


def _layout(values: Mapping[str, Any], rotors: int) -> Layout:
    # Of no combination there is no row that would tell how many rotors there are.
    quiet = np.array(values["quiet"], np.float64)
    return Layout(quiet if quiet.size else np.empty((0, rotors)), float(values["log_odds"]))


def _colour_values(colour: Colour) -> dict[str, Any]:
    return {
        "smoothness": colour.smoothness,
        "log_sd": _finite(colour.log_sd),
        "tried": colour.tried.tolist(),
        "free_energy": colour.free_energy.tolist(),
    }


def _colour(values: Mapping[str, Any]) -> Colour:
    arrays = _arrays({name: values[name] for name in ("tried", "free_energy")})
    return Colour(float(values["smoothness"]), _or_infinite(values["log_sd"]), **arrays)


def _check(fields: dict[str, Any]) -> None:
    """That every array is finite and of the shape that the model, the data and the settings give it."""
    model, settings, scaling = fields["model"], fields["settings"], fields["scaling"]
    unseen, scatter = fields["unseen"], fields["scatter"]
    record = fields["record"]
    inputs, outputs = record.inputs, record.outputs
    tables = {"model.A": model.A, "unseen.mse": unseen.mse, "inputs": inputs, "outputs": outputs}
    for name, table in tables.items():
        if table.ndim != 2 or not table.size:
            raise ValueError(f"{name} must be a table, not of shape {table.shape}")
    n, (T, r), m = len(model.A), inputs.shape, outputs.shape[1]
    k, p, d, driven = n * n + n * r + m * n, settings.p, settings.d, r + scaling.constant
    data = m * (p + 1) + driven * (d + 1)
    shapes = {
        "model.A": (model.A, (n, n)),
        "model.B": (model.B, (n, r)),
        "model.C": (model.C, (m, n)),
        "model.offset": (model.offset, (n,)),
        "model.input_trim": (model.input_trim, (r,)),
        "model.output_trim": (model.output_trim, (m,)),
        "theta_covariance": (fields["theta_covariance"], (k, k)),
        **({"scatter.covariance": (scatter.covariance, (k, k))} if scatter else {}),
        **{f"undetermined[{i}]": (d.weights, (k,)) for i, d in enumerate(fields["undetermined"])},
        "prior_sd": (fields["prior_sd"], (k,)),
        "known": (fields["known"], (k,)),
        "inputs": (inputs, (T, r)),
        "outputs": (outputs, (T, m)),
        "unseen.mse": (unseen.mse, (len(unseen.mse), m)),
        "unseen.weight": (unseen.weight, unseen.mse.shape),
        "unseen.weighted_mse": (unseen.weighted_mse, unseen.mse.shape),
        "scaling.input_trim": (scaling.input_trim, (r,)),
        "scaling.input_scale": (scaling.input_scale, (r,)),
        "scaling.known": (scaling.known, (r,)),
        "scaling.output_trim": (scaling.output_trim, (m,)),
        "scaling.output_scale": (scaling.output_scale, (m,)),
        **_predictor_shapes(fields["predictor"], n, m, driven),
        "state_map": (fields["state_map"], (n * (p + 1) + driven * (d + 1), data)),
        "theta": (fields["theta"], (n * n + n * driven + m * n,)),
    }
    if fields["trajectory"] is not None:
        shapes |= _trajectory_shapes(fields["trajectory"], fields["theta"], n, r, m)
    for name, (array, shape) in shapes.items():
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite and of shape {shape}, not {array.shape}")
    for name, table in (("inputs", inputs), ("outputs", outputs)):
        if np.abs(table).max() > LARGEST:
            raise ValueError(f"{name} must not be larger than {LARGEST:g}")
    if fields["trajectory"] is not None:
        _check_trajectory(fields["trajectory"], T)
    if len(fields["free_energy_of_samples"]) != record.windows(settings.window or T + 1):
        raise ValueError("free_energy_of_samples must have one value for each sample with a whole window")
    if sum(record.lengths) != T or min(record.lengths, default=0) < 1:
        raise ValueError(f"segments must be positive lengths that sum to {T}, not {record.lengths}")
    open_settings = [
        name for name in ("order", "d", "window", "parameter_precision") if getattr(settings, name) is None
    ]
    if open_settings or settings.smoothness == "learn":
        raise ValueError(f"settings must be complete, not without {', '.join(open_settings or ['smoothness'])}")
    scales = {
        "dt": fields["dt"],
        "smoothness": fields["smoothness"],
        "scaling.input_scale": scaling.input_scale,
        "scaling.output_scale": scaling.output_scale,
        "prior_sd": fields["prior_sd"],
        "theta_covariance": np.diag(fields["theta_covariance"]),
        **({"scatter": np.append(np.diag(scatter.covariance), scatter.freedom)} if scatter else {}),
    }
    for name, values in scales.items():
        if not (np.isfinite(values).all() and np.all(np.asarray(values) > 0)):
            raise ValueError(f"{name} must be positive")
    if not SHORTEST_STEP <= fields["dt"] <= 1 / SHORTEST_STEP:
        raise ValueError(f"dt must be positive seconds, at least {SHORTEST_STEP:g}, not {fields['dt']}")
    if not (unseen.mse >= 0).all() or not (unseen.weighted_mse >= 0).all():
        raise ValueError("unseen.mse and unseen.weighted_mse must not be negative")
    terms = fields["free_energy"].terms
    lengths = {len(term) for term in terms.values()}
    lengths |= {len(rows) for rows in vars(fields["learning"]).values()}
    if not terms or len(lengths) != 1 or 0 in lengths:
        raise ValueError("free_energy and learning must have as many rows")


def _predictor_shapes(predictor: Predictor, n: int, m: int, driven: int) -> dict[str, tuple[Array, tuple[int, ...]]]:
    """Its state is that of the vehicle, n, or more."""
    carried = max(n, len(predictor.C.T))
    return {
        "predictor.state": (predictor.transition.state, (carried, carried)),
        "predictor.input_now": (predictor.transition.input_now, (carried, driven)),
        "predictor.input_next": (predictor.transition.input_next, (carried, driven)),
        "predictor.C": (predictor.C, (m, carried)),
        "predictor.gain": (predictor.gain, (carried, m)),
        "predictor.of_outputs": (predictor.of_outputs, (carried, m)),
        "predictor.of_inputs": (predictor.of_inputs, (carried, driven)),
    }


def _trajectory_shapes(
    trajectory: Trajectory, theta: Array, n: int, r: int, m: int
) -> dict[str, tuple[Array, tuple[int, ...]]]:
    """Which shape its arrays must have."""
    free, places, layout = len(trajectory.places), trajectory.places, trajectory.layout
    if not (free and places.min() >= 0 and places.max() < len(theta) and len(np.unique(places)) == free):
        raise ValueError("trajectory.places must be different places of theta")
    if not (trajectory.numbers > free and trajectory.horizon >= 1 and len(trajectory.mse)):
        raise ValueError("trajectory must have more numbers than places, a horizon and errors of forecasts")
    return {
        "trajectory.theta": (trajectory.theta, theta.shape),
        "trajectory.covariance": (trajectory.covariance, (free, free)),
        "trajectory.mse": (trajectory.mse, (len(trajectory.mse), m)),
        "trajectory.gain": (trajectory.gain, (n, m)),
        **({} if layout is None else {"trajectory.layout.quiet": (layout.quiet, (len(layout.quiet), r))}),
    }


def _check_trajectory(trajectory: Trajectory, samples: int) -> None:
    """That what has a shape also is what it is called, of a record of so many samples."""
    if not (np.isfinite(trajectory.numbers) and trajectory.horizon <= samples):
        raise ValueError(f"trajectory must have finite numbers, and a horizon within its {samples} samples")
    if not (trajectory.mse >= 0).all():
        raise ValueError("trajectory.mse must not be negative")
    variances = np.linalg.eigvalsh(trajectory.covariance)
    if not variances[0] >= -ROUNDING * variances[-1]:
        raise ValueError("trajectory.covariance must be positive definite")
    terms = trajectory.terms
    rounds = {term.shape for term in terms.values()}
    if "noise entropy" not in terms or len(rounds) != 1 or len(*rounds) != 1 or (0,) in rounds:
        raise ValueError("trajectory.terms must be named as those of the free energy, each with as many values")
    layout = trajectory.layout
    if layout is not None and not np.isfinite(layout.log_odds):
        raise ValueError("trajectory.layout must have finite log_odds")


def _finite(value: float) -> float | None:
    """JSON has no infinity: nothing stands for it."""
    return value if np.isfinite(value) else None


def _or_infinite(value: float | None) -> float:
    return np.inf if value is None else float(value)


def _lists(arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in arrays.items()}


def _arrays(values: Mapping[str, Any]) -> dict[str, Array]:
    return {name: np.array(value, dtype=np.float64) for name, value in values.items()}
