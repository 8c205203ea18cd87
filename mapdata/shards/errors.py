"""The errors of stored datasets."""

from __future__ import annotations

import shlex
from typing import Any

REPAIRS = "'mapdata verify' with --repair makes it again where there is a recipe"
"""The end of messages about a shard that is not what it should be: what to do."""


class ShardError(ValueError):
    """A file that is not a sound shard; the message names the file and what is wrong with it."""


class DatasetNotFoundError(FileNotFoundError):
    """There is no dataset; the message says where it was looked for, and what makes one."""

    def __init__(self, root: object, why: str = "", how: str = "") -> None:
        """Say what was looked for under ``root``, why it is none, and what to do."""
        self.root = root
        self.why = why
        self.how = how
        if "://" in str(root):
            build = "Make one in a folder with 'mapdata build FOLDER', and serve that folder"
        else:
            build = (
                f"Make one with 'mapdata build {shlex.quote(str(root))}', with "
                f"mapdata.build({str(root)!r}, MapSpec()), or with MapDataModule({str(root)!r}, "
                "build='paper')"
            )
        # of a loader's worker torch gives the whole text of its error as the root
        super().__init__(f"no dataset at {root}: {why}. {how or build}" if why else root)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, so that the error of a worker says the same in its parent."""
        return DatasetNotFoundError, (self.root, self.why, self.how)
