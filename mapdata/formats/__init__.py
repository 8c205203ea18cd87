"""Foreign formats, one file each: `read_any` and `import_maps` bring maps in, `export` writes them.

docs/formats.md describes each format. A new one is a file with a `Format` and its name in the list
below; the command line takes its options from the keyword-only parameters of its functions.
"""

from mapdata.formats import huggingface, images, maze_hard, movingai, paper, planning, ros
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import Limits
from mapdata.formats.importing import import_maps
from mapdata.formats.maze_hard import is_shortest_answer
from mapdata.formats.registry import (
    FORMATS,
    Format,
    export,
    read_any,
    read_problems,
    recognise,
    register,
)
from mapdata.npy import FormatError

# images first: of formats that know a file, the last one has it, and these know some images better
for _module in (images, paper, movingai, ros, planning, maze_hard, huggingface):
    register(_module.FORMAT)

__all__ = [
    "FORMATS",
    "Collection",
    "ForeignMap",
    "Format",
    "FormatError",
    "Limits",
    "export",
    "import_maps",
    "is_shortest_answer",
    "read_any",
    "read_problems",
    "recognise",
    "register",
]
