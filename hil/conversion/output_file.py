"""Write a file as a whole or not at all, and overwrite nothing that the user did not name."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hil.core.errors import RecordingError, RecordingExistsError


@contextlib.contextmanager
def new_file(path: Path, *, force: bool, source: Path | None = None) -> Iterator[Path]:
    """Yield a temporary file beside ``path``, which becomes ``path`` when the block ends without an error.

    The temporary file is removed when the block fails or is interrupted. ``force`` allows that ``path`` is a
    file already; it must never be ``source``, the file that is being read. Raises RecordingExistsError when
    ``path`` exists, and RecordingError when it cannot be written.
    """
    check_output(path, force=force, source=source)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:100]}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}; see -o") from None
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        check_output(path, force=force, source=source)
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def check_output(path: Path, *, force: bool, source: Path | None = None) -> None:
    """Raise the errors of :func:`new_file` that are known before anything is written."""
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory; name a file in it with -o")
        if not path.parent.is_dir():
            raise RecordingError(f"{path}: cannot be created: there is no directory {path.parent}")
        if not os.path.lexists(path):
            return
        if not path.is_file():
            raise RecordingError(f"{path}: is not a regular file; choose another name with -o")
        if source is not None and path.samefile(source):
            raise RecordingError(f"{path}: is the file that is being read; choose another name with -o")
        if not force:
            raise RecordingExistsError(
                f"{path}: exists already; choose another name with -o, or overwrite it with --force"
            )
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}; see -o") from None


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
