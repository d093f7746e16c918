"""Files appear whole or not at all, and who may write them is known beforehand."""

import errno
import fcntl
import os
import shutil
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from crar_drake.errors import CrarError, WriteError

# What a file system says that has no locks.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path beside `path`, which replaces `path` on success.

    The temporary file keeps the suffix of `path`, since some writers (NumPy,
    matplotlib) choose the format by it. If the block raises, the temporary file
    (and folders that were made for it) is removed and whatever stood at `path`
    before is untouched.

    Raises:
        WriteError: the system refuses to write, here or in the block.
    """
    target = Path(path)
    with _writing(target), _folder(target.parent):
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent
        )
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            # mkstemp makes files private; give it what a plain open() would have.
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            os.replace(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Writes a file of text in UTF-8, as of `whole_file`.

    Raises:
        WriteError: the system refuses to write it.
    """
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_set(folder: str | os.PathLike[str], last: str = "") -> Iterator[Path]:
    """Yields a temporary folder whose files go into `folder` on success.

    They keep their places below it and replace what stands there; other files of
    `folder` stay. If the block raises, `folder` is as it was before.

    Args:
        folder: it need not be there yet.
        last: the file that is moved after all others: who finds it finds them, too.

    Raises:
        WriteError: the system refuses to write here.
    """
    target = Path(folder)
    with _folder(target):
        with _writing(target):
            temporary = Path(tempfile.mkdtemp(prefix=".making-", dir=target))
        try:
            yield temporary
            with _writing(target):
                files = [path for path in temporary.rglob("*") if path.is_file()]
                for path in sorted(files, key=lambda path: (path.name == last, path)):
                    place = target / path.relative_to(temporary)
                    place.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(path, place)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def check_folder(folder: str | os.PathLike[str]) -> None:
    """Better to know before a long simulation than after it.

    Raises:
        WriteError: `folder` is below a file, or nothing can be made in it.
    """
    folder = Path(folder)
    place = folder.absolute()
    try:
        while True:
            try:
                mode = os.stat(place).st_mode
                break
            except (FileNotFoundError, NotADirectoryError):
                if place.is_symlink():
                    raise WriteError(
                        folder, f"{place} is a link to nothing; name another folder"
                    ) from None
                place = place.parent
        if not stat.S_ISDIR(mode):
            raise WriteError(folder, f"{place} is a file; name another folder")
        # Permissions do not say it all: root may do everything, but not on a
        # file system that is read-only or made up by the kernel.
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        why = error.strerror or error
        raise WriteError(
            folder, f"{place} may not be written to ({why}); name another folder"
        ) from error


def check_file(path: str | os.PathLike[str]) -> None:
    """The same for a file that is to be written.

    Raises:
        WriteError: `path` is a folder, or its folder cannot be written to.
    """
    if os.path.isdir(path):
        raise WriteError(path, "this is a folder; name a file")
    check_folder(Path(path).parent)


@contextmanager
def sole_writer(path: str | os.PathLike[str]) -> Iterator[None]:
    """Keeps all others from writing a file that grows, as long as the block lasts.

    The system's lock (flock) on a hidden file beside it ends with the process,
    however that ends; a file that a crash left behind locks nothing.

    Raises:
        CrarError: another one holds the lock; the message names it.
        WriteError: the folder cannot be written to.
    """
    target = Path(path)
    place = target.with_name(f".{target.name}.lock")
    with _folder(target.parent):
        with _writing(target):
            stream = _hold(place)
        if isinstance(stream, str):
            raise CrarError(
                f"{target}: {stream} is writing to it; wait for its end, or name "
                "another file"
            )
        try:
            with _writing(target):
                stream.truncate(0)
                stream.write(f"process {os.getpid()} on {socket.gethostname()}\n")
                stream.flush()
            yield
        finally:
            place.unlink(missing_ok=True)
            stream.close()


@contextmanager
def turn_to_write(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Waits while another process writes a set of files into the same folder.

    It is the system's lock on the folder itself, which leaves nothing behind.

    Raises:
        WriteError: the folder cannot be made.
    """
    folder = Path(folder)
    with _writing(folder), _folder(folder):
        handle = os.open(folder, os.O_RDONLY)
        try:
            _lock(handle, wait=True)
            yield
        finally:
            os.close(handle)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """What the system refuses in the block becomes an error that names `path`."""
    try:
        yield
    except OSError as error:
        raise WriteError(path, error) from error


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """Makes a folder; if the block raises, it goes unless something is in it."""
    made = [place for place in (folder, *folder.parents) if not os.path.exists(place)]
    try:
        with _writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for place in made:
            try:
                place.rmdir()
            except OSError:
                break
        raise


def _hold(place: Path) -> IO[str] | str:
    """The open file `place`, locked; or who holds it."""
    while True:
        stream = open(place, "a+")
        if not _lock(stream.fileno()):
            stream.seek(0)
            holder = stream.read().strip()
            stream.close()
            return holder or "another process"
        # Who held it until now may have removed it after it was opened here.
        try:
            if os.path.samestat(os.fstat(stream.fileno()), os.stat(place)):
                return stream
        except FileNotFoundError:
            pass
        stream.close()


def _lock(handle: int, wait: bool = False) -> bool:
    """Whether the file is ours now; on file systems without locks it always is."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return True
