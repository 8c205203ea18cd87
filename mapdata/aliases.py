"""Names that have left the face of a folder, and that it still gives for one version."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module


def former_names(face: str, module_by_name: Mapping[str, str]) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a folder, which warns of each use of a name that has left it.

    Args:
        face: the folder as it is imported, such as ``mapdata.search``.
        module_by_name: the module below the folder that has each name.
    """

    def get(name: str) -> object:
        if name not in module_by_name:
            raise AttributeError(f"module {face!r} has no attribute {name!r}")
        home = f"{face}.{module_by_name[name]}"
        warnings.warn(
            f"{face}.{name} will be gone in 0.5.0: it is in {home}",
            FutureWarning,
            stacklevel=2,
        )
        value: object = getattr(import_module(home), name)
        return value

    return get
