"""Every public name is documented; every argument and attribute of what a room exports is mentioned there."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import click

import mavdem
import sitl_scenarios

MODULES = [
    importlib.import_module(found.name)
    for package in (mavdem, sitl_scenarios)
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
]


def public(owner: Any) -> Iterator[tuple[str, Any]]:
    """The public functions, methods, properties and classes that ``owner`` itself defines."""
    for name, value in vars(owner).items():
        value = getattr(value, "__func__", value)
        if isinstance(value, click.Command):
            value = value.callback
        kind = inspect.isfunction(value) or inspect.isclass(value) or isinstance(value, property | cached_property)
        if name.startswith("_") or not kind:
            continue
        if inspect.ismodule(owner) and value.__module__ != owner.__name__:
            continue
        yield f"{owner.__name__}.{name}", value
        if inspect.isclass(value) and not getattr(value, "_is_protocol", False):
            yield from public(value)


def exported() -> Iterator[tuple[str, Any]]:
    """What ``__all__`` of each room names, and the members of the classes and modules among it."""
    for room in [mavdem, *MODULES]:
        for name in getattr(room, "__all__", ()):
            value = getattr(room, name)
            yield f"{room.__name__}.{name}", value
            if inspect.isclass(value) or inspect.ismodule(value):
                yield from public(value)


EVERYTHING = {name: value for module in MODULES for name, value in public(module)}
EXPORTED = dict(exported())


def arguments(value: Any) -> list[str]:
    """What a caller passes or reads by name."""
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
    elif hasattr(value, "_fields"):
        names = list(value._fields)
    elif inspect.isfunction(value):
        names = [name for name in inspect.signature(value).parameters if name not in ("self", "cls")]
    else:
        names = []
    return [name for name in names if not name.startswith("_")]


def test_every_module_says_what_it_holds():
    assert [module.__name__ for module in MODULES if not module.__doc__] == []


def test_every_public_name_has_a_docstring_of_its_own():
    def generated(value):
        return inspect.isclass(value) and value.__doc__.startswith(f"{value.__name__}(")

    assert len(EVERYTHING) > 500
    assert [name for name, value in EVERYTHING.items() if not value.__doc__ or generated(value)] == []


def test_arguments_and_attributes_are_mentioned():
    assert {
        name: missing
        for name, value in EXPORTED.items()
        if (missing := [one for one in arguments(value) if not re.search(rf"\b{one}\b", value.__doc__ or "")])
    } == {}
