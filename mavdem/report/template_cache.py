"""Cache of compiled Jinja templates beside Python's own compiled modules, so that a command need not compile them.

A review renders about 170 templates, and compiling them took a tenth of its time. They are stored in the folder
``__pycache__`` of this package, as Python stores its modules: not with ``PYTHONDONTWRITEBYTECODE``, below
``PYTHONPYCACHEPREFIX`` where that is set, and not where the folder cannot be written to.
"""

import sys
from contextlib import suppress
from importlib.metadata import version
from importlib.util import cache_from_source
from pathlib import Path

from jinja2.bccache import Bucket, FileSystemBytecodeCache

COMPILED_MODULE = Path(cache_from_source(__file__))
"""File in which Python keeps this module compiled: it shows folder, implementation and version of Python."""


class CompiledTemplates(FileSystemBytecodeCache):
    """Compiled templates in files, one for each template, which are used as long as its text stays the same."""

    def __init__(self) -> None:
        """Names the files by the versions that compile a text, each differently: of mavdem, Jinja and Python."""
        python_version = "".join(COMPILED_MODULE.suffixes[:-1])
        folder = COMPILED_MODULE.parent / "templates"
        versions = f"{version('mavdem')}.jinja-{version('jinja2')}{python_version}"
        super().__init__(str(folder), f"%s.{versions}")

    def load_bytecode(self, bucket: Bucket) -> None:
        """Loads a compiled template; where its file cannot be read, the template is compiled again."""
        with suppress(OSError):
            super().load_bytecode(bucket)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Stores a compiled template in the folder of the cache, so that the next process need not compile it.

        Nothing is stored if Python itself stores no compiled modules, or if the folder cannot be written to.

        Args:
            bucket: Jinja's container of the compiled template.
        """
        if sys.dont_write_bytecode:
            return
        with suppress(OSError):
            Path(self.directory).mkdir(parents=True, exist_ok=True)
            super().dump_bytecode(bucket)
