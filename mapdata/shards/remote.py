"""Datasets at a URL: fetching files with limits and tries, and the cache."""

from __future__ import annotations

import re
import time
import warnings
from pathlib import Path
from typing import Any

from mapdata.hashing import sha256_of
from mapdata.jit import cache_home
from mapdata.shards.errors import DatasetNotFoundError, ShardError
from mapdata.shards.files import write_file

MOST_SILENCE = 20.0
"""Seconds without a byte after which a try to read from a URL is given up."""

MOST_SECONDS = 300.0
"""Seconds that a try may take in all, however steadily the bytes drip in."""

PAUSES = (1.0, 4.0)
"""Seconds before each further try."""


def is_url(place: str) -> bool:
    """Return whether a place is a URL rather than a folder."""
    return "://" in place


def _cache(place: str) -> Path:
    """Return the folder that keeps what is fetched from a URL."""
    return cache_home() / "mapdata" / "remote" / sha256_of(place.encode())[:24]


def _keep(path: Path, data: bytes) -> None:
    """Write a file of the cache.

    Raises:
        OSError: it may not be written to, or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)
    except OSError as error:
        raise OSError(
            f"{path}: cannot keep what was fetched ({error.strerror}); set NUMBA_CACHE_DIR to a "
            "folder that is writable and has room"
        ) from None


def _fetch(place: str, name: str, most: int, least: int = 0) -> bytes:
    """Return a file at a URL, no more of it than one byte above ``most``; try several times.

    Where less than ``least`` bytes came, they are asked for again, too.

    Raises:
        DatasetNotFoundError: it is not there.
        ConnectionError: no try got it; the message says why the last one did not.
        ShardError: it is longer.
    """
    for pause in PAUSES:
        try:
            data = _fetch_once(place, name, most)
            if len(data) >= least:
                return data
            why = f"{place}/{name}: {len(data)} of {least} bytes came"
        except _RefusedError:
            raise
        except ConnectionError as error:
            why = str(error)
        warnings.warn(f"{why}. Trying again in {pause:g} s", stacklevel=3)
        time.sleep(pause)
    return _fetch_once(place, name, most)


def _fetch_once(place: str, name: str, most: int) -> bytes:
    """Do what `_fetch` does, in one try."""
    url = f"{place}/{name}"
    pieces = []
    length = 0
    try:
        with _open_url(url) as file:
            # a stream gives what has arrived, which may be less than is asked for
            while piece := file.read(most + 1 - length):
                pieces.append(piece)
                length += len(piece)
    except ImportError as error:
        raise ValueError(f"root: {place} needs another package: {error}") from None
    except ValueError as error:  # a protocol that fsspec does not know
        raise ValueError(f"root: {place}: {error}") from None
    except FileNotFoundError as error:
        raise DatasetNotFoundError(place, f"{url} was not found") from error
    except Exception as error:
        # A timeout of fsspec says nothing. That of the package below it does, unless it is the
        # one in all, which has a name at least.
        why = " ".join((str(error) or str(error.__cause__) or repr(error)).split())
        refusal = _refusal(error, why)
    else:
        # Before it is joined or parsed, which takes some times as much memory.
        if length > most:
            raise ShardError(f"{url}: what was fetched is damaged (it has more than {most} bytes)")
        return _checked_body(url, b"".join(pieces))
    # Not from within the handler: the error of HTTP holds what cannot be pickled, and Dask pickles
    # an error with its causes.
    if refusal is not None:
        raise _RefusedError(f"{url} could not be read: {refusal}")
    raise ConnectionError(
        f"{url} could not be read: {why} ({len(PAUSES) + 1} tries, each given up after "
        f"{MOST_SILENCE:g} s without a byte or {MOST_SECONDS:g} s in all)"
    )


class _RefusedError(ConnectionError):
    """A server answers, but not with the file: asking it again would not help."""


_PASSING = (408, 425, 429)
"""Statuses of HTTP that blame the client and pass all the same: timeout, too early, too many."""


def _refusal(error: Exception, why: str) -> str | None:
    """Return what is said of an error that stays however often one asks; None if it may pass."""
    status = getattr(error, "status", None)
    status = status if isinstance(status, int) else 0  # of HTTP
    if isinstance(error, PermissionError) or status in (401, 403, 407):
        return f"access is denied ({why}); mapdata has no login: copy the dataset to a folder"
    # aiohttp's errors of redirects; one that leads on and on is an error of HTTP with a status
    if "Redirect" in type(error).__name__:
        where = "in a circle" if hasattr(error, "status") else f"to {why}, no address of the web"
        return f"its server redirects {where}; check the URL"
    if 400 <= status < 500 and status not in _PASSING:
        return f"its server refuses the request ({why})"
    return None


def _checked_body(url: str, data: bytes) -> bytes:
    """Return what a server sent, unless its first bytes tell that it is no file of a dataset.

    Raises:
        ConnectionError: it is a page, or packed.
    """
    if re.match(rb"(\xef\xbb\xbf)?\s*<", data[:1000]):
        raise _RefusedError(
            f"{url} could not be read: its server sent a page of HTML or XML, expected the file; "
            "check the URL, and whether the server asks for a login"
        )
    if data.startswith(b"\x1f\x8b"):
        raise _RefusedError(
            f"{url} could not be read: its server packs it with gzip, unasked; serve it as it is, "
            "without Content-Encoding"
        )
    return data


def _open_url(url: str) -> Any:
    """Open a file at a URL to read its bytes, as a stream where it is HTTP."""
    import fsspec

    if not url.startswith(("http://", "https://")):
        return fsspec.open(url, "rb")
    import aiohttp

    client = {
        "timeout": aiohttp.ClientTimeout(
            total=MOST_SECONDS, sock_connect=MOST_SILENCE, sock_read=MOST_SILENCE
        ),
        # what a server packs could be a bomb
        "headers": {"Accept-Encoding": "identity"},
        "auto_decompress": False,
    }
    # with any size, fsspec does not ask for the true one first
    return fsspec.filesystem("http", client_kwargs=client).open(url, block_size=0, size=1)
