"""Foreign formats: `read_any` and `import_maps` read maps, and `export` writes them.

docs/formats.md describes the formats. Each is a module with a `Format`, listed below. The command
line takes the options of a format from the keyword-only parameters of its functions.
"""

from typing import TYPE_CHECKING

from mapdata.aliases import former_names
from mapdata.formats import (
    images,
    maze_hard,
    movingai,
    paper,
    planning,
    ros,
    text,
    tilebased,
    transpath,
    warcraft,
)
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import Limits
from mapdata.formats.importing import import_maps
from mapdata.formats.maze_answers import (
    AnswerCheck,
    check_answer,
    is_shortest_answer,
    score_answer,
)
from mapdata.formats.registry import Format, export, read_any, read_problems, register
from mapdata.formats.ros import RosMap
from mapdata.npy import FormatError

# The order matters: if several formats recognise a file, it belongs to the last of them. The first
# are images and text, since the others know better what some pictures, arrays and tables mean.
for _module in (
    images,
    text,
    paper,
    movingai,
    ros,
    planning,
    transpath,
    maze_hard,
    warcraft,
    tilebased,
):
    register(_module.FORMAT)

__all__ = [
    "AnswerCheck",
    "Collection",
    "ForeignMap",
    "Format",
    "FormatError",
    "Limits",
    "RosMap",
    "check_answer",
    "export",
    "import_maps",
    "is_shortest_answer",
    "read_any",
    "read_problems",
    "register",
    "score_answer",
]

if not TYPE_CHECKING:
    __getattr__ = former_names(
        __name__,
        {
            "FORMATS": "registry",
            "recognise": "registry",
        },
    )
