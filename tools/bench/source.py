"""What source a module runs, read from its imports: a digest that changes only with it, and not with comments."""

from __future__ import annotations

import ast
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

OWN = "mavdem"
"""The package whose source counts; of others the versions must."""


@cache
def digest(*modules: str) -> str:
    """Of the modules and of all of our own that they import, however far away.

    A package only hands on the names of its files: of ``from mavdem.evaluate import skill`` the file where ``skill`` is
    made counts, and not what else the package imports.
    """
    return sha256(repr([(name, ast.dump(_tree(name))) for name in sorted(imported(*modules))]).encode()).hexdigest()


def imported(*modules: str) -> set[str]:
    """Names of the modules and of all of our own that they import."""
    found: set[str] = set()
    ahead = list(modules)
    while ahead:
        module = ahead.pop()
        if module not in found:
            found.add(module)
            ahead += _imports(module)
    return found


def _imports(module: str) -> list[str]:
    """Where the names are made that a module of ours imports, also inside its functions."""
    made = []
    for node in ast.walk(_tree(module)):
        if isinstance(node, ast.Import):
            made += [alias.name for alias in node.names if _is_own(alias.name)]
        elif isinstance(node, ast.ImportFrom) and node.module and _is_own(node.module):
            made += [_home(node.module, alias.name) for alias in node.names]
    return made


def _home(module: str, name: str) -> str:
    """The module that makes a name, which another may hand on."""
    if not _is_package(module):
        return module
    for node in ast.walk(_tree(module)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module != module and _is_own(node.module):
            for alias in node.names:
                if name == (alias.asname or alias.name):
                    return _home(node.module, alias.name)
    within = f"{module}.{name}"
    return within if find_spec(within) else module


def _is_own(module: str) -> bool:
    return module.split(".")[0] == OWN


@cache
def _tree(module: str) -> ast.Module:
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"there is no source of {module}")
    return ast.parse(Path(spec.origin).read_text())


def _is_package(module: str) -> bool:
    spec = find_spec(module)
    return spec is not None and spec.submodule_search_locations is not None
