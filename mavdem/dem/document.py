"""The document of a learnt model, ``model.json``: every field by its name, arrays as nested lists.

It depends on the parts of a result, not on :class:`mavdem.dem.Learned`, which converts itself by it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from types import GenericAlias
from typing import Annotated, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    create_model,
)

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import LinearModel, Transition
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.engine.trace import FreeEnergy, Learning
from mavdem.dem.forecast.forecasts import TrainingForecasts
from mavdem.dem.forecast.mixer import MixerPrior
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.record import LABELS, LARGEST, SHORTEST_STEP, Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings
from mavdem.dem.smoothness import SmoothnessEstimate
from mavdem.dem.uncertainty import Direction, SandwichCovariance
from mavdem.dem.validation import STRICT, first_problem

ROUNDING = 1e-9  # of a covariance: how far below zero its least variance may be, relative to the largest


KEYS = {"smoothness_estimate": "colour", "simulation_fit": "trajectory", "converged": "settled"}
"""Of attributes whose keys in the document are older."""

TINY = float(np.finfo(np.float64).tiny)  # the least of what must be positive


def _covariance(array: Array) -> Array:
    variances = np.linalg.eigvalsh(array)
    if not variances[0] >= -ROUNDING * variances[-1]:
        raise ValueError("must be positive definite")
    return array


def _variances(array: Array) -> Array:
    if not (array.diagonal() > 0).all():
        raise ValueError("must be positive on its diagonal")
    return array


def _step(value: Any) -> Any:
    if not (isinstance(value, float | int) and SHORTEST_STEP <= value <= 1 / SHORTEST_STEP):
        raise ValueError(f"must be positive seconds, at least {SHORTEST_STEP:g}, not {value!r}")
    return value


def _innovation_form(value: Any) -> Any:
    """The predictor of an older document, whose filter corrects the state of each sample, in today's form."""
    if not (isinstance(value, dict) and "transition" in value):
        return value
    try:
        transition = Transition(**{name: np.array(matrix, np.float64) for name, matrix in value["transition"].items()})
        C, gain, *first = (np.array(value[name], np.float64) for name in ("C", "gain", "of_outputs", "of_inputs"))
        return _plain(StateSpace.of_transition(transition, C, gain, (first[0], first[1])))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise ValueError(f"is not a predictor: {error}") from None


def _shape(sizes: str, least: float = -np.inf, most: float = np.inf, dtype: DTypeLike = np.float64) -> Any:
    """The type of nested lists that become an array of finite numbers between ``least`` and ``most``.

    Equal names of ``sizes`` are equal throughout a document: the validation's context holds those found so far.
    """
    names = sizes.split()
    shape = f"({', '.join(names)})"

    def validated(value: Any, info: ValidationInfo) -> NDArray[Any]:
        try:
            array = np.array(value, dtype)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"must be numbers of shape {shape}") from None
        known: dict[str, int] = {} if info.context is None else info.context
        if not array.size and len(names) == 2:
            array = array.reshape(0, known.get(names[1], 0))
        if array.ndim != len(names) or not np.isfinite(array).all():
            raise ValueError(f"must be finite and of shape {shape}, not {array.shape}")
        expected = tuple(known.setdefault(name, size) for name, size in zip(names, array.shape, strict=True))
        if array.shape != expected:
            raise ValueError(f"must be of shape {expected}, not {array.shape}")
        if not (array >= least).all():
            raise ValueError("must be positive" if least > 0 else "must not be negative")
        if not (np.abs(array) <= most).all():
            raise ValueError(f"must not be larger than {most:g}")
        return array

    return Annotated[Any, PlainValidator(validated)]


def _part(kind: Callable[..., Any], **hints: Any) -> Any:
    """The type of an object of these fields, which makes a ``kind`` of them; a text is the sizes of an array."""
    given = {name: (_shape(hint) if isinstance(hint, str) else hint, ...) for name, hint in hints.items()}
    model = create_model(kind.__name__, __config__=STRICT, **given)  # type: ignore[call-overload]
    return Annotated[model, AfterValidator(lambda part: kind(**dict(part)))]


def _by_name(sizes: str) -> Any:
    """Arrays of one shape by name."""
    return GenericAlias(dict, (str, _shape(sizes)))


Covariance: Any = Annotated[_shape("k k"), AfterValidator(_variances)]
Step = Annotated[float, BeforeValidator(_step)]
Whole = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Unbounded = Annotated[float | None, AfterValidator(lambda value: np.inf if value is None else value)]
"""JSON has no infinity: null represents it."""

DOCUMENT = TypeAdapter(
    _part(
        dict,
        settings=Any,
        inputs=_shape("T r", most=LARGEST),
        outputs=_shape("T m", most=LARGEST),
        segments=list[Whole],
        dt=Step,
        smoothness=Positive,
        model=_part(LinearModel, A="n n", B="n r", C="m n", offset="n", input_trim="r", output_trim="m"),
        theta_covariance=Covariance,
        prior_sd=_shape("k", least=TINY),
        known=_shape("k", dtype=np.bool_),
        free_energy=_by_name("iterations"),
        learning=_part(
            Learning,
            theta="iterations k",
            theta_sd="iterations k",
            lambda_="iterations g",
            lambda_sd="iterations g",
        ),
        settled=bool,
        training_forecasts=_part(
            TrainingForecasts,
            mse=_shape("H m", least=0),
            weight="H m",
            weighted_mse=_shape("H m", least=0),
            motors_share=float,
        ),
        colour=_part(SmoothnessEstimate, smoothness=float, log_sd=Unbounded, tried="tried", free_energy="tried") | None,
        scatter=_part(SandwichCovariance, covariance=Covariance, freedom=Positive) | None,
        undetermined=GenericAlias(list, (_part(dict, weights="k", share=float),)),
        cautions=list[str],
        scaling=_part(
            Scaling,
            input_trim="r",
            input_scale=_shape("r", least=TINY),
            output_trim="m",
            output_scale=_shape("m", least=TINY),
            constant=bool,
            known=_shape("r", dtype=np.bool_),
        ),
        predictor=Annotated[
            _part(
                StateSpace,
                A="carried carried",
                B="carried driven",
                C="m carried",
                D="m driven",
                K="carried m",
                offset="carried",
                input_trim="driven",
                output_trim="m",
                second_of_outputs="carried m",
                second_of_inputs="carried driven",
            ),
            BeforeValidator(_innovation_form),
        ],
        trajectory=_part(
            SimulationFit,
            theta="K",
            places=_shape("free", least=0, dtype=np.intp),
            covariance=Annotated[_shape("free free"), AfterValidator(_covariance)],
            mse=_shape("longest m", least=0),
            gain="n m",
            numbers=float,
            horizon=Whole,
            settled=bool,
            terms=_by_name("rounds"),
            layout=_part(MixerPrior, quiet="combinations r", log_odds=float) | None,
        )
        | None,
        free_energy_of_samples="windows",
        state_map="X data",
        theta="K",
        of_vehicle=_part(
            dict,
            effect_directions=list[float] | None,
            setpoints=list[list[float | None]] | None,
            setpoint_names=list[str],
            voltage=list[float | None] | None,
        )
        | None,
        labels=_part(dict, begins=list[float], **dict.fromkeys(LABELS, list[str])) | None,
    )
)
"""The document by its keys. Sizes: T samples, r inputs, m outputs, n states, k parameters of the vehicle, K of the
engine, which may have a constant input more."""


def values_of(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Plain JSON values of the fields of a learnt model, ``parts`` by name."""
    record = parts["record"]
    values = {name: _plain(value) for name, value in parts.items() if name != "record"}
    # A direction's sizes are those of the model.
    directions = [{"weights": one["weights"], "share": one["share"]} for one in values["undetermined"]]
    values |= {key: values.pop(name) for name, key in KEYS.items()}
    return {
        **values,
        "free_energy": _plain(parts["free_energy"].terms),
        "undetermined": directions,
        "inputs": record.inputs.tolist(),
        "outputs": record.outputs.tolist(),
        "segments": list(record.lengths),
        "of_vehicle": _of_vehicle(record),
        "labels": {name: list(getattr(record, name)) for name in (*LABELS, "begins")},
    }


def _of_vehicle(record: Record) -> dict[str, Any] | None:
    """What only the physical parameters use, if anything is known; where a setpoint is not, it is null."""
    known = {"effect_directions": record.effect_directions, "setpoints": record.setpoints, "voltage": record.voltage}
    if all(table is None for table in known.values()):
        return None
    tables = {name: None if table is None else _nulls(table) for name, table in known.items()}
    return {**tables, "setpoint_names": list(record.setpoint_names)}


def _nulls(table: Array) -> Any:
    plain = table.astype(object)
    plain[~np.isfinite(table)] = None
    return plain.tolist()


def parts_of(values: Any) -> dict[str, Any]:
    """The fields of a learnt model, from what :func:`values_of` returned; ``ValueError`` if one does not fit."""
    sizes: dict[str, int] = {}
    try:
        parts: dict[str, Any] = DOCUMENT.validate_python(_current(values), context=sizes)
    except ValidationError as error:
        problem = first_problem(error)
        missing = problem.endswith("is missing") or not isinstance(values, dict)
        raise ValueError(f"not the document of a learnt model: {problem}" if missing else problem) from None
    parts |= {name: parts.pop(key) for name, key in KEYS.items()}
    parts["settings"] = CompleteSettings.from_dict(parts["settings"])
    record = Record(parts.pop("inputs"), parts.pop("outputs"), parts["dt"], tuple(parts.pop("segments")))
    of_vehicle, labels = parts.pop("of_vehicle"), parts.pop("labels")
    record = _with_labels(record, labels) if labels else record
    parts["record"] = _with_vehicle(record, of_vehicle) if of_vehicle else record
    _check(parts, sizes)
    model_sizes = sizes["n"], sizes["r"], sizes["m"]
    parts["undetermined"] = tuple(Direction(**one, sizes=model_sizes) for one in parts["undetermined"])
    return {
        **parts,
        "free_energy": FreeEnergy(parts["free_energy"]),
        "cautions": tuple(parts["cautions"]),
    }


def _with_labels(record: Record, values: Mapping[str, Any]) -> Record:
    inputs, outputs = record.inputs.shape[1], record.outputs.shape[1]
    columns = {"input": inputs, "output": outputs}
    sizes = {name: columns[name.split("_")[0]] for name in LABELS} | {"begins": len(record.lengths)}
    for name, size in sizes.items():
        if len(values[name]) not in (0, size):
            raise ValueError(f"labels.{name} must be {size}, or none, not {len(values[name])}")
    known: dict[str, Any] = {name: tuple(values[name]) for name in sizes}
    return replace(record, **known)


def _with_vehicle(record: Record, values: Mapping[str, Any]) -> Record:
    names = tuple(values["setpoint_names"])
    shapes = {
        "effect_directions": (record.inputs.shape[1],),
        "setpoints": (len(record), len(names)),
        "voltage": (len(record),),
    }
    tables = {name: None if values[name] is None else np.array(values[name], np.float64) for name in shapes}
    for name, table in tables.items():
        if table is not None and table.shape != shapes[name]:
            raise ValueError(f"of_vehicle.{name} must be of shape {shapes[name]}, not {table.shape}")
    directions, setpoints, voltage = tables.values()
    return replace(record, effect_directions=directions, setpoints=setpoints, voltage=voltage, setpoint_names=names)


def _current(values: Any) -> Any:
    """A document of today: version 0.1 wrote every candidate, "unseen" for training forecasts, and no closed loop."""
    if isinstance(values, dict):
        values = {"of_vehicle": None, "labels": None, **values}
    if not (isinstance(values, dict) and "unseen" in values):
        return values
    kept = {name: value for name, value in values.items() if name not in ("unseen", "candidates")}
    if isinstance(kept.get("settings"), dict):
        kept["settings"] = {"closed_loop": False, **kept["settings"]}
    return {"training_forecasts": values["unseen"], **kept}


def _check(parts: Mapping[str, Any], sizes: Mapping[str, int]) -> None:
    """Whether sizes follow from each other, and what else a single field does not show."""
    record, settings, simulation_fit = parts["record"], parts["settings"], parts["simulation_fit"]
    n, r, m, T, p = (*(sizes[name] for name in ("n", "r", "m", "T")), settings.p)
    driven = r + parts["scaling"].constant
    expected = {
        "k": n * n + n * r + m * n,
        "K": n * n + n * driven + m * n,
        "driven": driven,
        "data": m * (p + 1) + driven * (settings.d + 1),
        "X": n * (p + 1) + driven * (settings.d + 1),
        "T": sum(record.lengths),
        "windows": record.windows(settings.window),
    }
    for name, size in expected.items():
        if sizes[name] != size:
            raise ValueError(f"the document's arrays must have {name} = {size}, not {sizes[name]}")
    if not (min(n, r, m, T, sizes["H"], sizes.get("iterations", 0)) and sizes["carried"] >= n):
        raise ValueError("the document's arrays must not be empty")
    if simulation_fit is not None:
        _check_simulation_fit(simulation_fit, sizes)


def _check_simulation_fit(fit: SimulationFit, sizes: Mapping[str, int]) -> None:
    free, T = sizes["free"], sizes["T"]
    if not (free and fit.places.max() < sizes["K"] and len(np.unique(fit.places)) == free):
        raise ValueError("trajectory.places must be different indices of theta")
    if not (fit.numbers > free and fit.horizon <= T and sizes["longest"]):
        raise ValueError(f"trajectory must have more numbers than places, and a horizon within its {T} samples")
    if not ("noise entropy" in fit.terms and sizes["rounds"]):
        raise ValueError("trajectory.terms must be named like those of the free energy")


def _plain(value: Any) -> Any:
    """Arrays, tuples and dataclasses as lists and dictionaries."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, CompleteSettings):
        return value.to_dict()
    if hasattr(value, "_asdict"):
        value = value._asdict()
    elif is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and np.isinf(value) else value
