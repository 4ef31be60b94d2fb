"""Public names of a package that are imported when they are first used, since some of them take long to import."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """Returns the function ``__getattr__`` of a package (PEP 562), which imports a name when it is first used.

    Args:
        package: name of the package, its ``__name__``.
        modules: the module below the package that defines each name, by the name.
    """

    def imported_name(name: str) -> Any:
        """Imports and returns the object of a public name.

        Args:
            name: the name.

        Raises:
            AttributeError: the package has no such name.
        """
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    return imported_name
