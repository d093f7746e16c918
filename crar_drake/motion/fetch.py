"""Downloads trials of the CMU Graphics Lab Motion Capture Database.

A file appears in the cache only when it is complete and checked.
"""

import fcntl
import hashlib
import http.client
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import rich.progress
from rich.console import Console

from crar_drake.errors import MotionError, WriteError
from crar_drake.files import whole_file
from crar_drake.motion.catalogue import (
    SEARCH_PATH_VARIABLE,
    KnownTrial,
    MotionFiles,
    cache_folder,
    known_trials,
    trial_files,
    trial_id,
)
from crar_drake.motion.formats.asf_amc import read_amc, read_asf

DATABASE_URL = "http://mocap.cs.cmu.edu"

LICENCE_NOTICE = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. The database "
    "was created with funding from NSF EIA-0196217.\n"
    "It is free for all uses, but it may not be resold, even in converted form."
)

_ATTEMPTS = 5
_FIRST_PAUSE = 0.5  # doubles with every further attempt [s]
_TIMEOUT = 30.0  # without a byte [s]
_CHUNK = 1 << 16  # [bytes]


# What `fetch` tells some times a second: a file's name, its bytes so far, and all of
# them, None if that is not known.
ProgressCallback = Callable[[str, int, int | None], None]


def fetch(
    trial: str,
    cache: str | os.PathLike[str] | None = None,
    base_url: str = DATABASE_URL,
    progress: ProgressCallback | None = None,
    force: bool = False,
    *,
    known: Mapping[str, KnownTrial] | None = None,
    sleep: Callable[[float], object] = time.sleep,
) -> MotionFiles:
    """Downloads a trial and its skeleton, unless they are there and right.

    Files are checked by SHA-256 where it is known, else by reading them. One fetch
    at a time works on a cache; others wait for it. Who shows or passes on the data
    must state LICENCE_NOTICE.

    Args:
        trial: `05_02` or `cmu:05_02`.
        cache: folder to keep the files in; the user's cache by default.
        base_url: a server with the database's layout.
        progress: is called with how far each download is.
        force: downloads again, whatever is there.
        known: the checksums; those of `known_trials` by default.
        sleep: waits between attempts [s].

    Raises:
        MotionError: no such trial, no connection, or not the right file. No file
            has then got its name in the cache without being complete and right.
    """
    trial = trial_id(trial)
    known = known_trials() if known is None else known
    folder = cache_folder() if cache is None else Path(cache)
    files = trial_files(folder, trial)

    def download(path: Path, sha256: str | None, read: Callable[[Path], object]):
        if path.is_file() and not force and not _complaint(path, sha256, read):
            return
        url = f"{base_url.rstrip('/')}/{path.relative_to(folder).as_posix()}"
        data = _download(url, trial, sha256 is not None, progress, sleep)
        with whole_file(path) as temporary:
            temporary.write_bytes(data)
            if complaint := _complaint(temporary, sha256, read):
                raise MotionError(
                    f"{url}: {complaint}. The download was removed; fetch it again, or "
                    f"put the right file into a folder of {SEARCH_PATH_VARIABLE}"
                )

    try:
        with _one_at_a_time(folder):
            download(files.asf, _skeleton_sha256(trial, known), read_asf)
            download(
                files.amc,
                known[trial].amc_sha256 if trial in known else None,
                lambda path: read_amc(path, read_asf(files.asf)),
            )
    except (OSError, WriteError) as error:
        why = getattr(error, "strerror", None) or error
        raise MotionError(
            f"cannot keep trial {trial} in {folder}: {why}; make room there or name "
            "another cache folder"
        ) from error
    return files


@contextmanager
def rich_progress(console: Console | None = None) -> Iterator[ProgressCallback]:
    """Yields a callback for `fetch` that draws one bar a file."""
    columns = (
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        rich.progress.DownloadColumn(),
        rich.progress.TransferSpeedColumn(),
    )
    with rich.progress.Progress(*columns, console=console) as bars:
        tasks: dict[str, rich.progress.TaskID] = {}

        def show(file: str, done: int, total: int | None) -> None:
            if file not in tasks:
                tasks[file] = bars.add_task(file, total=total)
            bars.update(tasks[file], completed=done, total=total)

        yield show


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Holds the folder's lock, which the system frees even if we are killed."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


# --- checking ---------------------------------------------------------------------


def _skeleton_sha256(trial: str, known: Mapping[str, KnownTrial]) -> str | None:
    """Returns the skeleton's checksum, which any trial of the subject tells."""
    subject = trial.partition("_")[0]
    for other, facts in known.items():
        if other.partition("_")[0] == subject:
            return facts.asf_sha256
    return None


def _complaint(
    path: Path, sha256: str | None, read: Callable[[Path], object]
) -> str | None:
    """Returns what is wrong with a file, or None."""
    if sha256 is not None:
        with open(path, "rb") as file:
            actual = hashlib.file_digest(file, "sha256").hexdigest()
        if actual == sha256:
            return None
        return f"wrong checksum: expected SHA-256 {sha256}, got {actual}"
    try:
        read(path)
    except MotionError as error:
        return f"not a readable file of its kind ({error})"
    return None


# --- downloading ------------------------------------------------------------------


class _CutOff(Exception):
    """A response ended too early; says where."""


def _download(
    url: str,
    trial: str,
    has_checksum: bool,
    progress: ProgressCallback | None,
    sleep: Callable[[float], object],
) -> bytes:
    """What is at an address, in several attempts if need be."""
    request = urllib.request.Request(url, headers={"User-Agent": "crar-drake"})
    for attempt in range(_ATTEMPTS):
        if attempt > 0:
            sleep(_FIRST_PAUSE * 2 ** (attempt - 1))
        try:
            response = urllib.request.urlopen(request, timeout=_TIMEOUT)
        except urllib.error.HTTPError as error:
            error.close()
            if error.code in (404, 410):
                raise MotionError(
                    f"the database has no trial {trial}: {url} does not exist; look "
                    f"its number up at {DATABASE_URL}"
                ) from error
            if error.code < 500 and error.code not in (408, 429):
                raise MotionError(
                    f"{url}: the server answers {error.code} {error.reason}; get the "
                    f"files another way and name their folder in {SEARCH_PATH_VARIABLE}"
                ) from error
            reason = f"the server answers {error.code}"
        except urllib.error.URLError as error:
            passing = isinstance(error.reason, TimeoutError | ConnectionError)
            if not passing or isinstance(error.reason, ConnectionRefusedError):
                host = urllib.parse.urlsplit(url).netloc
                raise MotionError(
                    f"cannot reach {host} ({error.reason}); check the network, or get "
                    "the files another way and name their folder in "
                    f"{SEARCH_PATH_VARIABLE}"
                ) from error
            reason = "the connection was cut off"
        except (OSError, http.client.HTTPException):
            reason = "the connection was cut off"
        else:
            try:
                with response:
                    return _receive(response, url, has_checksum, progress)
            except _CutOff as error:
                reason = str(error)
    raise MotionError(
        f"{url}: {reason}; gave up after {_ATTEMPTS} attempts. Run the same command "
        "later"
    )


def _receive(
    response: http.client.HTTPResponse,
    url: str,
    has_checksum: bool,
    progress: ProgressCallback | None,
) -> bytes:
    """The whole of a response."""
    length = response.headers.get("Content-Length", "")
    total = int(length) if length.isdecimal() else None
    if total is None and not response.chunked and not has_checksum:
        raise MotionError(
            f"{url}: the server does not say how long the file is, so that a cut-off "
            "one could not be noticed; name another server"
        )
    data = bytearray()
    while True:
        if progress is not None:
            progress(url.rpartition("/")[2], len(data), total)
        try:
            chunk = response.read(_CHUNK)
        except (OSError, http.client.HTTPException) as error:
            raise _CutOff(f"cut off at {len(data)} bytes") from error
        if not chunk:
            break
        data += chunk
    if total is not None and len(data) != total:
        raise _CutOff(f"cut off at {len(data)} of {total} bytes")
    return bytes(data)
