"""The errors of stored datasets."""

from __future__ import annotations

import shlex
from typing import Any

from mapdata.generators import PRESETS

REPAIRS = "'mapdata verify' with --repair makes it again where there is a recipe"
"""The end of error messages about a damaged or missing shard, which says what to do."""

NOT_AS_WRITTEN = (
    "damaged, or written by another HDF5 program, whose files h5py reads and mapdata does not; "
    f"{REPAIRS}"
)
"""The end of error messages about the bytes of a file that are not those of a shard."""

LINK_REMEDY = (
    "'cp -rL FOLDER COPY' makes a copy without links; --follow-links (follow_links=True) reads the "
    "links of a folder of your own"
)
"""The end of error messages about a link that leads out of its folder, which says what to do."""


UNSOUND = (
    TypeError,
    ValueError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)
"""Errors that parsing the content of a damaged file may raise."""


class ShardError(ValueError):
    """A file that is not a sound shard; the message names the file and what is wrong with it."""


class LinkError(ShardError):
    """A file of a dataset that is a link out of the folder of the dataset, and so is not read."""


class DatasetNotFoundError(FileNotFoundError):
    """There is no dataset at a location; the message says why, and how to create one.

    Attributes:
        root: the location.
        why: why there is no dataset.
        hint: what to do; by default, how to build a dataset at this location.
    """

    def __init__(self, root: object, why: str = "", hint: str = "") -> None:
        """Compose the message.

        A single argument is the whole message: torch raises the errors of a loader's workers in
        the main process with their text as the only argument.
        """
        self.root = root
        self.why = why
        self.hint = hint
        if str(root) in PRESETS:
            default_hint = (
                f"{root} is a preset: 'mapdata build data/{root} --preset {root}' stores maps of "
                f"it in a folder, and OnlineMapDataset({str(root)!r}) serves them without one"
            )
        elif "://" in str(root):
            default_hint = "Make one in a folder with 'mapdata build FOLDER', and serve that folder"
        else:
            default_hint = (
                f"Make one with 'mapdata build {shlex.quote(str(root))}', with "
                f"mapdata.build({str(root)!r}, MapSpec()), or with MapDataModule({str(root)!r}, "
                "build='paper')"
            )
        super().__init__(f"no dataset at {root}: {why}. {hint or default_hint}" if why else root)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, so that an unpickled error has the same message."""
        return DatasetNotFoundError, (self.root, self.why, self.hint)
