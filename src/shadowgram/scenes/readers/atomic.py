"""Writing a file so that its name holds either the old contents or the new, whatever happens in between."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

Chunk = bytes | memoryview


def replace_file(path: str | os.PathLike[str], chunks: Iterable[Chunk]) -> None:
    """Write `chunks` one after the other to `path`, in place of what is there.

    They go to a temporary file in the same folder, which is forced to the disk and then renamed; if the process is
    killed or the machine stops, `path` holds its old contents or all of the new ones. The permissions of an old file
    are kept.

    Raises
    ------
    OSError
        If the file cannot be written; `path` is then as it was, and the temporary file is removed.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from shadowgram.scenes.readers.atomic import replace_file
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "note.txt"
    >>> replace_file(path, [b"old"])
    >>> replace_file(path, [b"new ", b"text"])
    >>> path.read_text()
    'new text'
    """
    replace_files([(path, chunks)])


def replace_files(parts: Sequence[tuple[str | os.PathLike[str], Iterable[Chunk]]]) -> None:
    """Write files that belong together, the last of which says how the others are to be read, such as a header.

    The last one is taken away before the first is put in place: after a crash in between there is no header rather than
    one that does not belong to its data.

    Raises
    ------
    OSError
        If one cannot be written; then all are as they were, but for a crash between the last steps.
    """
    targets = [_resolved(path) for path, _ in parts]
    temporaries = [target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part") for target in targets]
    path = parts[-1][0]
    try:
        try:
            for target in targets:
                _check_target(target)
            for (_, chunks), target, temporary in zip(parts, targets, temporaries, strict=True):
                _write(temporary, chunks, _permissions(target))
            if len(parts) > 1:
                targets[-1].unlink(missing_ok=True)
            for target, temporary in zip(targets, temporaries, strict=True):
                temporary.replace(target)
        except BaseException:
            for temporary in temporaries:
                with suppress(OSError):
                    temporary.unlink()
            raise
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror or error}; nothing was changed") from error
    _sync_folder(targets[-1].parent)


def _resolved(path: str | os.PathLike[str]) -> Path:
    """The file itself: a symbolic link stays one, and what it points to is replaced."""
    try:
        return Path(path).resolve()
    except RuntimeError:  # of Python before 3.13
        raise OSError(f"cannot write {path}: its symbolic links go round in a circle") from None


def _check_target(target: Path) -> None:
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {target.parent}")
    if target.exists() and not target.is_file():
        raise OSError("it is a folder or a device, not a file")


def _permissions(target: Path) -> int | None:
    return stat.S_IMODE(target.stat().st_mode) if target.exists() else None


def _write(temporary: Path, chunks: Iterable[Chunk], permissions: int | None) -> None:
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(descriptor, "wb") as file:
        for chunk in chunks:
            file.write(chunk)
        file.flush()
        if permissions is not None:
            temporary.chmod(permissions)
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    # The new name is already in place; some file systems cannot sync a folder, and nothing is lost by that but the
    # certainty that the name survives a power cut in the next seconds.
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
