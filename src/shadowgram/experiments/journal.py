"""The journal: what finished tasks found, a row each, in an SQLite file that survives the death of whoever writes it.

A row goes in as one transaction that is on the disk before the call returns, so it is there whole or not at all. Rows are never
changed and never replaced. Each carries a digest of everything in it, which is compared when it is read.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import sqlite3
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from .source import SceneSource
from .study import Record, Value

FILE_NAME = "journal.sqlite"
APPLICATION_ID = int.from_bytes(b"SGjl", "big")
VERSION = 1
PATIENCE = 60.0  # s to wait for another program that is writing

COLUMNS = (
    "key", "study", "revision", "scene", "scene_digest", "spec", "result", "seed",
    "version", "code_commit", "host", "started", "seconds",
)  # fmt: skip
SCHEMA = (
    "CREATE TABLE scenes (digest TEXT PRIMARY KEY, fields TEXT NOT NULL)",
    """CREATE TABLE records (
        key TEXT PRIMARY KEY, study TEXT NOT NULL, revision INTEGER NOT NULL, scene TEXT NOT NULL, scene_digest TEXT NOT NULL,
        spec TEXT NOT NULL, result TEXT NOT NULL, seed INTEGER, version TEXT NOT NULL, code_commit TEXT NOT NULL,
        host TEXT NOT NULL, started TEXT NOT NULL, seconds REAL NOT NULL, checksum TEXT NOT NULL, arrays BLOB NOT NULL)""",
    """CREATE TABLE failures (
        key TEXT PRIMARY KEY, study TEXT NOT NULL, spec TEXT NOT NULL, error TEXT NOT NULL, time TEXT NOT NULL)""",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {VERSION}",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """A row of the journal.

    Attributes
    ----------
    key : of the task, as `study.task_key` gives it.
    study, revision : what the task belongs to.
    scene : that it used.
    spec, result : specification and values, JSON texts.
    arrays : as `pack_arrays` makes them.
    version, commit : of the shadowgram that computed; no commit if it did not run from a checkout.
    host : name of the machine.
    started : UTC, ISO 8601.
    seconds : that the task took.
    """

    key: str
    study: str
    revision: int
    scene: SceneSource
    spec: str
    result: str
    arrays: bytes
    version: str
    commit: str
    host: str
    started: str
    seconds: float

    def columns(self) -> tuple[object, ...]:
        """Values of `COLUMNS`."""
        seed = json.loads(self.spec).get("seed")
        storable = isinstance(seed, int) and not isinstance(seed, bool) and abs(seed) < 2**63
        return (
            self.key, self.study, self.revision, self.scene.name, self.scene.digest, self.spec, self.result,
            seed if storable else None,
            self.version, self.commit, self.host, self.started, float(self.seconds),
        )  # fmt: skip


class Journal:
    """An open journal; `open_journal` and `read_journal` give one.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from shadowgram.experiments.journal import open_journal
    >>> with open_journal(Path(tempfile.mkdtemp())) as journal:
    ...     journal.seconds("a key") is None
    True
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._db = connection

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    def add(self, entry: Entry) -> bool:
        """Put a result in; whether it was new. An old one with its key stays as it is, and a failure of the task is forgotten.

        Raises
        ------
        OSError
            If it cannot be written; the journal is then as it was.
        """
        columns = entry.columns()
        places = ", ".join("?" * (len(columns) + 2))
        scene = entry.scene.digest, json.dumps(dataclasses.asdict(entry.scene))
        with self._transaction():
            self._db.execute("INSERT OR IGNORE INTO scenes VALUES (?, ?)", scene)
            added = self._db.execute(
                f"INSERT OR IGNORE INTO records ({', '.join(COLUMNS)}, checksum, arrays) VALUES ({places})",  # noqa: S608 - our own names
                (*columns, _checksum(columns, entry.arrays), entry.arrays),
            )
            self._db.execute("DELETE FROM failures WHERE key = ?", (entry.key,))
        return added.rowcount == 1

    def add_failure(self, key: str, study: str, spec: str, error: str, time: str) -> None:
        """Note that a task failed, in place of an earlier failure of it.

        Raises
        ------
        OSError
            If it cannot be written; the journal is then as it was.
        """
        with self._transaction():
            self._db.execute("INSERT OR REPLACE INTO failures VALUES (?, ?, ?, ?, ?)", (key, study, spec, error, time))

    def seconds(self, key: str) -> float | None:
        """How long a task took; None if it is not in the journal."""
        with _explained(self.path):
            row = self._db.execute("SELECT seconds FROM records WHERE key = ?", (key,)).fetchone()
        return None if row is None else row[0]

    def records(self, keys: Iterable[str]) -> dict[str, Record]:
        """Records of the tasks that are in the journal, by key.

        Raises
        ------
        ValueError
            If a record is not as it was written.
        """
        found = {}
        for key in dict.fromkeys(keys):
            with _explained(self.path):
                query = f"SELECT {', '.join(COLUMNS)}, checksum, arrays FROM records WHERE key = ?"  # noqa: S608 - our own names
                row = self._db.execute(query, (key,)).fetchone()
            if row is not None:
                found[key] = self._record(row)
        return found

    def failures(self, keys: Iterable[str]) -> dict[str, str]:
        """Errors of the tasks that failed when they were last tried, by key."""
        query = "SELECT error FROM failures WHERE key = ?"
        with _explained(self.path):
            rows = {key: self._db.execute(query, (key,)).fetchone() for key in keys}
        return {key: row[0] for key, row in rows.items() if row is not None}

    def scenes(self, study: str, revision: int) -> list[SceneSource]:
        """Scenes of which there are records of a study, in the order in which they came."""
        query = """SELECT fields FROM scenes WHERE digest IN (SELECT scene_digest FROM records WHERE study = ? AND revision = ?)
            ORDER BY rowid"""
        with _explained(self.path):
            rows = self._db.execute(query, (study, revision)).fetchall()
        return [_scene(json.loads(fields)) for (fields,) in rows]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with _explained(self.path):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _record(self, row: tuple) -> Record:
        *columns, checksum, arrays = row
        named = dict(zip(COLUMNS, columns, strict=True))
        if checksum != _checksum(tuple(columns), arrays):
            raise ValueError(
                f"the record {named['key']} of {named['study']} in {self.path} is damaged; put back a copy of the journal,"
                " or take that row out of its table 'records' and run the study again"
            )
        return Record(
            spec=json.loads(named["spec"]),
            values=json.loads(named["result"]),
            arrays=unpack_arrays(arrays),
            seconds=named["seconds"],
        )


def open_journal(folder: Path) -> Journal:
    """Journal of a folder, to be written; made if there is none.

    Raises
    ------
    OSError
        If it cannot be written.
    ValueError
        If the file is damaged, of another version, or something else; it is then left as it is.
    """
    path = folder / FILE_NAME
    with _explained(path):
        connection = _connect(path, "rw" if path.exists() else "rwc")
        try:
            if _is_empty(connection):
                _create(connection)
            _check(path, connection)
            # A transaction is on the disk when it is committed; readers and a writer do not wait for one another.
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            # If it cannot be written, an error now and not after hours.
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(f"PRAGMA user_version = {VERSION}")
            connection.execute("ROLLBACK")
        except BaseException:
            connection.close()
            raise
    return Journal(path, connection)


def read_journal(folder: Path) -> Journal:
    """Journal of a folder, to be read only.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If the file is damaged, of another version, or something else.
    """
    path = folder / FILE_NAME
    if not path.exists():
        raise FileNotFoundError(f"there is no journal {path}; 'shadowgram study run' makes one")
    with _explained(path):
        connection = _connect_to_read(path)
        try:
            _check(path, connection)
        except BaseException:
            connection.close()
            raise
    return Journal(path, connection)


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Arrays as a compressed .npz without pickle; nothing if there are none.

    Raises
    ------
    TypeError
        If one is not an array of numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.journal import pack_arrays, unpack_arrays
    >>> unpack_arrays(pack_arrays({"psnr": np.array([30.5, 31.0])}))
    {'psnr': array([30.5, 31. ])}
    """
    if not arrays:
        return b""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufcSU":
                raise TypeError(
                    f"the array {name!r} of a result must be a NumPy array of numbers or text, got {array!r:.60}"
                )
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_arrays(packed: bytes) -> dict[str, np.ndarray]:
    """Arrays that `pack_arrays` packed."""
    if not packed:
        return {}
    with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _checksum(columns: tuple[object, ...], arrays: bytes) -> str:
    return hashlib.sha256(json.dumps(columns).encode() + arrays).hexdigest()


def _scene(fields: dict[str, Value]) -> SceneSource:
    # JSON has no tuples.
    return SceneSource(**{**fields, "wavelengths": tuple(fields["wavelengths"]), "size": tuple(fields["size"])})


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=PATIENCE, isolation_level=None)


def _connect_to_read(path: Path) -> sqlite3.Connection:
    connection = _connect(path, "ro")
    try:
        connection.execute("PRAGMA schema_version")
    except sqlite3.OperationalError:
        connection.close()
        if _has_log(path):
            raise
        # In a folder that cannot be written SQLite cannot make the file that readers and writers share, and needs none.
        return _connect(path, "ro&immutable=1")
    return connection


def _is_empty(connection: sqlite3.Connection) -> bool:
    """Whether nobody has put anything into the database yet."""
    return not any(connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "schema_version"))


def _create(connection: sqlite3.Connection) -> None:
    connection.execute("BEGIN IMMEDIATE")
    if _is_empty(connection):  # nobody was faster
        for statement in SCHEMA:
            connection.execute(statement)
    connection.execute("COMMIT")


def _check(path: Path, connection: sqlite3.Connection) -> None:
    """Raise a ValueError unless this is a whole journal that we understand."""
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise ValueError(f"{path} is not a journal of shadowgram; choose another folder, or move it away")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION:
        raise ValueError(
            f"{path} is a journal of version {version}, and this shadowgram knows version {VERSION};"
            " choose another folder, or use the shadowgram that wrote it"
        )
    if _is_cut(path, connection) or connection.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
        raise ValueError(_damaged(path))


def _has_log(path: Path) -> bool:
    """Whether there are transactions that have not been moved to the main file yet."""
    log = path.with_name(f"{path.name}-wal")
    return log.exists() and log.stat().st_size > 0


def _is_cut(path: Path, connection: sqlite3.Connection) -> bool:
    """Whether the last page is not whole; SQLite would fill it with zeros."""
    page = connection.execute("PRAGMA page_size").fetchone()[0]
    return not _has_log(path) and path.stat().st_size % page != 0


def _damaged(path: Path) -> str:
    return f"{path} is damaged and was left as it is; put back a copy, or move it away and run the studies again"


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Errors of SQLite in plain words."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
        if code == sqlite3.SQLITE_NOTADB:
            raise ValueError(
                f"{path} is not a journal of shadowgram; choose another folder, or move it away"
            ) from error
        if code == sqlite3.SQLITE_CORRUPT:
            raise ValueError(_damaged(path)) from error
        reasons = {
            sqlite3.SQLITE_FULL: "the disk is full",
            sqlite3.SQLITE_READONLY: "it, or its folder, is read-only",
            sqlite3.SQLITE_CANTOPEN: "it cannot be opened; look at the permissions of the file and its folder",
            sqlite3.SQLITE_BUSY: f"another program has held it for {PATIENCE:.0f} s",
        }
        raise OSError(f"cannot use {path}: {reasons.get(code, error)}; what is in it is safe") from error
