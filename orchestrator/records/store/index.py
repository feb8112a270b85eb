"""Facts of every record of a store, from a cache beside the records.

Only the files count.  The cache, STORE/.index.sqlite, holds what was read from files of the same size and time; it may
be deleted, and is rebuilt if it is damaged.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from ...errors import StoreError

NAME = ".index.sqlite"
VERSION = 3  # of what the cache holds; one of another version is rebuilt
TABLE = f"facts{VERSION}"
FEW = 400  # files that one process reads while others would still start
PLAIN = (
    "run_id",
    "experiment",
    "title",
    "status",
    "error",
    "created",
    "wall_time",
    "real_time_factor",
    "algorithm",
    "step",
    "seed",
    "digest",
    "git_commit",
    "failed_at",
    "stopped_at",
    "hostname",
    "pid",
)
DECODED = ("metrics", "metrics_never", "versions", "warnings", "warning_kinds")
# What is large and seldom needed is kept, and decoded, by itself: thousands of records are listed without it.
PLACES = {"metrics": "metrics", "metrics_never": "metrics"}
PLACES |= dict.fromkeys(("components", "versions", "warnings", "warning_kinds"), "details")
CORRUPT = "corrupt"

File = tuple[str, int, int]  # path, size, time of the last change [ns]
Parts = tuple[dict[str, Any], dict[str, str]]  # of facts: the plain ones, and texts by their places


class LazyFacts(Mapping[str, Any]):
    """Facts of one record.  What has a place in PLACES is decoded when it is read.

    plain: the other facts; texts: {place: facts as JSON}.
    """

    __slots__ = ("_known", "_texts")

    def __init__(self, plain: Mapping[str, Any], texts: Mapping[str, str]):
        self._known, self._texts = dict(plain), dict(texts)

    def __getitem__(self, name: str) -> Any:
        return self._decoded(name)[name]

    def __contains__(self, name: object) -> bool:
        return name in self._decoded(name)

    def __iter__(self) -> Iterator[str]:
        for name in PLACES:
            self._decoded(name)
        return iter(self._known)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _decoded(self, name: object) -> dict[str, Any]:
        place = PLACES.get(name) if isinstance(name, str) else None
        if place in self._texts:
            self._known |= json.loads(self._texts.pop(place))
        return self._known


def runs(folder: Path) -> list[LazyFacts]:
    """Facts of every record in a store, oldest file first: those in PLAIN and DECODED, `components` by name, `master`,
    `record`, `marks` (why a completed run may not be compared, see `file.marks`), `file`, `bytes`.

    A file that cannot be read has the status "corrupt" and the reason as its error; one that is deleted meanwhile is
    left out.  Raises StoreError where the store cannot be read.
    """
    files: list[File] = sorted(_files(folder), key=lambda file: (file[2], file[0]))
    known = _cached(folder)
    stale = [file for file in files if file not in known]
    if stale:
        read_now = zip(stale, _read_all([path for path, _, _ in stale]), strict=True)
        fresh = {file: _split(facts) for file, facts in read_now if facts}
        known |= fresh
        # A file that is being written changes while its size and time stay the same.
        _keep(folder, {file: parts for file, parts in fresh.items() if parts[0]["status"] != "running"}, files)
    result = []
    for file in files:
        if file in known:
            plain, texts = known[file]
            path, size, _ = file
            status = plain["status"] if plain["status"] != "running" else _status_of_running(path)
            result.append(LazyFacts({**plain, "status": status, "file": path, "bytes": size}, texts))
    return result


def _split(facts: Mapping[str, Any]) -> Parts:
    """The plain facts, and the others as texts by their places."""
    places: dict[str, dict[str, Any]] = {place: {} for place in PLACES.values()}
    for name, place in PLACES.items():
        if name in facts:
            places[place][name] = facts[name]
    plain = {name: value for name, value in facts.items() if name not in PLACES}
    return plain, {place: json.dumps(below) for place, below in places.items()}


def _files(folder: Path) -> Iterator[File]:
    """Path, size and time of every record; folders that begin with _ or . are ignored.  Raises StoreError."""
    try:
        entries = [entry for entry in _entries(folder) if entry.name[0] not in "_."]
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise StoreError(f"{folder} cannot be read: {error.strerror}") from None
    for entry in entries:
        # A file or folder that is removed or cannot be read does not hide the others.
        with contextlib.suppress(OSError):
            for file in _entries(entry.path) if entry.is_dir() else []:
                if file.name.endswith(".h5"):
                    with contextlib.suppress(OSError):
                        status = file.stat()
                        yield file.path, status.st_size, status.st_mtime_ns


def _entries(folder: str | Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return list(entries)


def _read_all(paths: list[str]) -> list[dict[str, Any]]:
    if len(paths) <= FEW:
        return [read(path) for path in paths]
    with ProcessPoolExecutor() as pool:
        return list(pool.map(read, paths, chunksize=64))


def read(path: str) -> dict[str, Any]:
    """Facts of one record, from the file; {} if it no longer exists."""
    import h5py

    from ..file.access import UNREADABLE, first_line
    from ..file.foreign import root_attributes
    from ..file.marks import COMPLETED, standing_of

    try:
        with h5py.File(path, "r", locking=False) as file:
            attributes = root_attributes(file, without=("model_descriptions",))
        resolved = attributes["experiment_resolved"]
        facts: dict[str, Any] = {name: _plain(attributes[name]) for name in PLAIN if name in attributes}
        facts |= {name: attributes[name] for name in DECODED if name in attributes}
        facts["marks"] = "; ".join(standing_of(attributes, COMPLETED).marks)
        facts["components"] = {component.pop("name"): component for component in resolved["components"]}
        return {**facts, "master": resolved["master"], "record": {"every": resolved["record"]["every"]}}
    except FileNotFoundError:
        return {}
    except UNREADABLE as error:
        if _status_of_running(path) == "running":  # it has just started
            return {**_nameless(path), "status": "running"}
        return {**_nameless(path), "status": CORRUPT, "error": first_line(error)}


def _nameless(path: str) -> dict[str, Any]:
    """Facts that the place of a file gives."""
    place = Path(path)
    return {
        "run_id": place.stem,
        "experiment": place.parent.name,
        "created": "",
        "metrics": {},
        "components": {},
        "error": "",
    }


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value


def _status_of_running(path: str) -> str:
    from ..file.access import is_locked

    return "running" if is_locked(Path(path)) else "interrupted (killed)"


@contextlib.contextmanager
def _database(folder: Path) -> Iterator[sqlite3.Connection]:
    connection = sqlite3.connect(folder / NAME, timeout=2.0)
    try:
        with connection:
            columns = "path PRIMARY KEY, size, time, plain, metrics, details"
            connection.execute(f"CREATE TABLE IF NOT EXISTS {TABLE} ({columns})")
            yield connection
    finally:
        connection.close()


def _cached(folder: Path) -> dict[File, Parts]:
    """The facts of files of that size and time; {} where there is no cache that can be read."""
    if not (folder / NAME).exists():
        return {}
    places = list(dict.fromkeys(PLACES.values()))
    try:
        with _database(folder) as connection:
            rows = connection.execute(f"SELECT path, size, time, plain, {', '.join(places)} FROM {TABLE}").fetchall()
        above = f"{folder}{os.sep}"
        return {
            (above + path, size, time): (json.loads(plain), dict(zip(places, texts, strict=True)))
            for path, size, time, plain, *texts in rows
        }
    except sqlite3.OperationalError:  # another process writes it, or it cannot be opened here
        return {}
    except (sqlite3.DatabaseError, ValueError):  # damaged
        with contextlib.suppress(OSError):
            (folder / NAME).unlink()
        return {}


def _keep(folder: Path, fresh: Mapping[File, Parts], files: list[File]) -> None:
    """Add to the cache, and forget files that no longer exist.  A store that cannot be written has no cache."""
    rows = [
        (os.path.relpath(path, folder), size, time, json.dumps(plain), *texts.values())
        for (path, size, time), (plain, texts) in fresh.items()
    ]
    existing = {os.path.relpath(path, folder) for path, _, _ in files}
    with contextlib.suppress(sqlite3.Error), _database(folder) as connection:
        for version in range(1, VERSION):
            connection.execute(f"DROP TABLE IF EXISTS facts{version}")
        gone = [row for row in connection.execute(f"SELECT path FROM {TABLE}") if row[0] not in existing]
        connection.executemany(f"DELETE FROM {TABLE} WHERE path = ?", gone)
        connection.executemany(f"INSERT OR REPLACE INTO {TABLE} VALUES (?, ?, ?, ?, ?, ?)", rows)
