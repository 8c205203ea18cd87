"""What all command lines share: the parser, exit codes, and the summary of a dataset."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from mapdata.shards import Manifest


class DisagreeError(Exception):
    """The data are damaged or are not what they should be: exit code 1."""


def summary(root: str, manifest: Manifest, seconds: float | None = None) -> str:
    """Return the short summary of a dataset, one fact to a line."""
    done = sum(entry.stop - entry.start for entry in manifest.shards)
    size = sum(entry.bytes for entry in manifest.shards)
    segments = max(manifest.total("segments"), 1)
    rows, columns = manifest.map_size
    shards = "1 shard" if len(manifest.shards) == 1 else f"{len(manifest.shards)} shards"
    unfinished = "" if manifest.complete else f" (of {manifest.maps:,}: not finished)"
    drawn = manifest.total("drawn")  # none where maps have no rooms: mazes, imports
    shown = min(7, max(done - 1, 0))
    lines = {
        "maps": f"{done:,} of {rows} x {columns} cells in {shards}{unfinished}",
        "rate": "" if seconds is None else f"{seconds:.1f} s, {done / seconds:,.0f} maps/s",
        "size": f"{size / 1e6:,.1f} MB, {size / max(done, 1):.0f} bytes a map",
        "drawn passages": f"{drawn / segments:.1%}" if drawn else "",
        "reachable segments": f"{manifest.total('reachable') / segments:.1%}",
        "fully connected maps": f"{manifest.total('all_connected') / max(done, 1):.1%}",
        "identity": manifest.identity or "none (imported)",
        "content hash": manifest.content_hash,
        "look": f"mapdata show {shlex.quote(str(root))} --index {shown} -o map.png",
    }
    return "\n".join(f"{name + ':':22}{text}" for name, text in lines.items() if text)


def run(command: Callable[..., None], **values: object) -> None:
    """Call ``command`` and exit with 0, 1 or 2: one clear line instead of a traceback for what a
    user can put right.
    """
    from mapdata.shards import ShardError
    from mapdata.shards.workers import THREADS

    try:
        command(**values)
        print(end="", flush=True)  # so that a reader that is gone is noticed here, not at exit
    except BrokenPipeError:  # as in: mapdata info ROOT | head -1
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left to print
        sys.exit(141)  # as a shell says it
    except (DisagreeError, ShardError) as error:
        sys.exit(_complain(error, 1))
    except KeyboardInterrupt:
        code = _complain("stopped; run the same command again to go on", 130)
        if any(thread.name.startswith(THREADS) for thread in threading.enumerate()):
            sys.stdout.flush()
            os._exit(
                code
            )  # a plain exit would wait for the shards under way, however long they take
        sys.exit(code)
    except (ValueError, OSError) as error:
        sys.exit(_complain(error, 2))


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        sys.exit(_complain(f"{message} ({self.prog} --help says more)", 2))


def path_name(text: str) -> str:
    """Return the name of a file or folder, which is not empty: else it would be the working
    folder.
    """
    if not text:
        raise argparse.ArgumentTypeError("got an empty name")
    return text


def _complain(error: object, code: int) -> int:
    print(f"mapdata: {' '.join(str(error).split())}", file=sys.stderr)
    return code
