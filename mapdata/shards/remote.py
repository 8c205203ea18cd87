"""Datasets at a URL: fetching their files with limits and retries, and the local cache."""

from __future__ import annotations

import re
import time
import warnings
from pathlib import Path
from typing import Any

from mapdata.hashing import sha256_hex
from mapdata.jit import cache_home
from mapdata.shards.errors import DatasetNotFoundError, ShardError
from mapdata.shards.files import write_file

MAX_SILENCE = 20.0
"""Seconds without a byte after which an attempt to read from a URL is given up."""

MAX_SECONDS = 300.0
"""Seconds after which an attempt is given up in any case, even while bytes still arrive."""

PAUSES = (1.0, 4.0)
"""Seconds before each repeated attempt."""


def cache_folder(url: str) -> Path:
    """Return the folder that keeps the files of the dataset at a URL."""
    return cache_home() / "mapdata" / "remote" / sha256_hex(url.encode())[:24]


def write_to_cache(path: Path, content: bytes) -> None:
    """Write a file of the cache.

    Raises:
        OSError: it may not be written to, or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content)
    except OSError as error:
        raise OSError(
            f"{path}: cannot keep what was fetched ({error.strerror}); set NUMBA_CACHE_DIR to a "
            "folder that is writable and has room"
        ) from None


def fetch(location: str, name: str, max_bytes: int, min_bytes: int = 0) -> bytes:
    """Return the content of a file at a URL, in several attempts if it must be.

    Args:
        location: URL of the dataset.
        name: of the file.
        max_bytes: a file that is longer is refused; only one byte more than this is read.
        min_bytes: if fewer bytes arrive, another attempt is made. After the last attempt even
            fewer bytes are returned.

    Raises:
        DatasetNotFoundError: there is no such file.
        ConnectionError: no attempt succeeded; the message says why the last one failed.
        ShardError: the file is longer than ``max_bytes``.
        ValueError: the URL needs a package that is not installed, or has an unknown protocol.
    """
    for pause in PAUSES:
        try:
            content = _fetch_once(location, name, max_bytes)
            if len(content) >= min_bytes:
                return content
            reason = f"{location}/{name}: {len(content)} of {min_bytes} bytes came"
        except _RefusedError:
            raise
        except ConnectionError as error:
            reason = str(error)
        warnings.warn(f"{reason}. Trying again in {pause:g} s", stacklevel=3)
        time.sleep(pause)
    return _fetch_once(location, name, max_bytes)


def _fetch_once(location: str, name: str, max_bytes: int) -> bytes:
    """Return the content of a file at a URL in one attempt; see `fetch`."""
    url = f"{location}/{name}"
    pieces = []
    length = 0
    try:
        with _open_url(url) as file:
            # A stream returns the bytes that have arrived, which may be fewer than asked for.
            while piece := file.read(max_bytes + 1 - length):
                pieces.append(piece)
                length += len(piece)
    except ImportError as error:
        raise ValueError(f"root: {location} needs another package: {error}") from None
    except ValueError as error:  # fsspec does not know the protocol
        raise ValueError(f"root: {location}: {error}") from None
    except FileNotFoundError as error:
        raise DatasetNotFoundError(location, f"{url} was not found") from error
    except Exception as error:
        # A timeout of fsspec has no text. Its cause, a timeout of aiohttp, has a text unless it is
        # that of the whole attempt, which has at least a name.
        text = str(error) or str(error.__cause__) or repr(error)
        reason = " ".join(text.split())
        refusal = _lasting_refusal(error, reason)
    else:
        # The length is checked before the pieces are joined and parsed, which takes several times
        # as much memory.
        if length > max_bytes:
            raise ShardError(
                f"{url}: what was fetched is damaged (it has more than {max_bytes} bytes)"
            )
        return _checked_body(url, b"".join(pieces))
    # These are raised outside of the handler, so that they do not keep the error of HTTP as their
    # context: it cannot be pickled, and Dask pickles an error with its context.
    if refusal is not None:
        raise _RefusedError(f"{url} could not be read: {refusal}")
    raise ConnectionError(
        f"{url} could not be read: {reason} ({len(PAUSES) + 1} tries, each given up after "
        f"{MAX_SILENCE:g} s without a byte or {MAX_SECONDS:g} s in all)"
    )


class _RefusedError(ConnectionError):
    """A server answers, but not with the file, so repeated attempts would not help."""


_TEMPORARY_STATUSES = (408, 425, 429)
"""HTTP statuses that blame the client but are temporary: timeout, too early, too many requests."""


def _lasting_refusal(error: Exception, reason: str) -> str | None:
    """Return the text for an error that repeated attempts would not change; None for others.

    The error is one of fsspec or aiohttp, and ``reason`` its text on one line.
    """
    status = getattr(error, "status", None)  # of HTTP
    if not isinstance(status, int):
        status = 0
    if isinstance(error, PermissionError) or status in (401, 403, 407):
        return f"access is denied ({reason}); mapdata has no login: copy the dataset to a folder"
    if "Redirect" in type(error).__name__:
        # aiohttp has two errors of redirects. The one for too many redirects has a status.
        direction = (
            "in a circle" if hasattr(error, "status") else f"to {reason}, no address of the web"
        )
        return f"its server redirects {direction}; check the URL"
    if 400 <= status < 500 and status not in _TEMPORARY_STATUSES:
        return f"its server refuses the request ({reason})"
    return None


def _checked_body(url: str, body: bytes) -> bytes:
    """Return the body of a response, unless its first bytes are not those of a dataset's file.

    Raises:
        ConnectionError: it is a page of HTML or XML, or compressed by gzip.
    """
    if re.match(rb"(\xef\xbb\xbf)?\s*<", body[:1000]):
        raise _RefusedError(
            f"{url} could not be read: its server sent a page of HTML or XML, expected the file; "
            "check the URL, and whether the server asks for a login"
        )
    if body.startswith(b"\x1f\x8b"):
        raise _RefusedError(
            f"{url} could not be read: its server packs it with gzip, unasked; serve it as it is, "
            "without Content-Encoding"
        )
    return body


def _open_url(url: str) -> Any:
    """Return a context manager that opens the file at a URL to read bytes.

    Over HTTP the file is a stream; for other protocols it is what fsspec returns.
    """
    import fsspec

    if not url.startswith(("http://", "https://")):
        return fsspec.open(url, "rb")
    import aiohttp

    client_options = {
        "timeout": aiohttp.ClientTimeout(
            total=MAX_SECONDS, sock_connect=MAX_SILENCE, sock_read=MAX_SILENCE
        ),
        # Compressed content could unpack to any size, so the server is asked for none.
        "headers": {"Accept-Encoding": "identity"},
        "auto_decompress": False,
    }
    filesystem = fsspec.filesystem("http", client_kwargs=client_options)
    # fsspec first asks the server for the size of the file unless it is given one. The given size
    # is not used with a block size of 0, which makes the file a stream.
    return filesystem.open(url, block_size=0, size=1)
