"""What a store holds, quickly: facts of every record, kept in a cache beside them.

The files are the truth.  The cache, STORE/.index.sqlite, holds what was read of files of the same size and time; it can
be deleted, and is built anew where it is damaged.
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

NAME = ".index.sqlite"
VERSION = 1  # of what is kept; another one is built anew
FEW = 400  # files that one process reads while others would still start
PLAIN = ("run_id", "experiment", "title", "status", "error", "created", "wall_time", "real_time_factor", "algorithm",
         "step", "seed", "digest", "git_commit", "failed_at", "stopped_at", "hostname", "pid")  # fmt: skip
DECODED = ("metrics", "versions", "warnings")
CORRUPT = "corrupt"

Facts = dict[str, Any]
File = tuple[str, int, int]  # path, size, time of the last change [ns]


def runs(folder: Path) -> list[Facts]:
    """Facts of every record in a store, oldest file first: those in PLAIN and DECODED, `components` by name, `master`,
    `record`, `file`, `bytes`.

    A file that cannot be read has the status "corrupt" and the reason as its error.
    """
    files: list[File] = sorted(_files(folder), key=lambda file: (file[2], file[0]))
    known = _cached(folder)
    stale = [file for file in files if file not in known]
    if stale:
        fresh = dict(zip(stale, _read_all([path for path, _, _ in stale]), strict=True))
        known |= fresh
        # What is being written changes without its size and time telling.
        _keep(folder, {key: facts for key, facts in fresh.items() if facts["status"] != "running"}, files)
    found = []
    for path, size, time in files:
        facts = {**known[path, size, time], "file": path, "bytes": size}
        if facts["status"] == "running":
            facts["status"] = _status_of_running(path)
        found.append(facts)
    return found


def _files(folder: Path) -> Iterator[File]:
    """Path, size and time of every record; folders that begin with _ or . are ignored."""
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name[0] in "_." or not entry.is_dir():
                continue
            with os.scandir(entry.path) as inside:
                for file in inside:
                    if file.name.endswith(".h5"):
                        status = file.stat()
                        yield file.path, status.st_size, status.st_mtime_ns


def _read_all(paths: list[str]) -> list[Facts]:
    if len(paths) <= FEW:
        return [read(path) for path in paths]
    with ProcessPoolExecutor() as pool:
        return list(pool.map(read, paths, chunksize=64))


def read(path: str) -> Facts:
    """Facts of one record, from the file."""
    import h5py

    from .store import UNREADABLE, first_line

    try:
        with h5py.File(path, "r", locking=False) as file:
            found = {name: _plain(value) for name, value in file.attrs.items() if name != "model_descriptions"}
        if found["format"] != "orch-run":
            raise KeyError("it is no record")
        resolved = json.loads(found["experiment_resolved"])
        facts = {name: found[name] for name in PLAIN if name in found}
        facts |= {name: json.loads(found[name]) for name in DECODED}
        facts["components"] = {component.pop("name"): component for component in resolved["components"]}
        return {**facts, "master": resolved["master"], "record": {"every": resolved["record"]["every"]}}
    except UNREADABLE as error:
        if _status_of_running(path) == "running":  # it has just begun
            return {**_nameless(path), "status": "running"}
        return {**_nameless(path), "status": CORRUPT, "error": first_line(error)}


def _nameless(path: str) -> Facts:
    """What the place of a file says of it."""
    place = Path(path)
    return {"run_id": place.stem, "experiment": place.parent.name, "created": "", "metrics": {}, "components": {},
            "error": ""}  # fmt: skip


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and value != value else value


def _status_of_running(path: str) -> str:
    from .store import is_locked

    return "running" if is_locked(Path(path)) else "interrupted (killed)"


@contextlib.contextmanager
def _database(folder: Path) -> Iterator[sqlite3.Connection]:
    connection = sqlite3.connect(folder / NAME, timeout=2.0)
    try:
        with connection:
            connection.execute(f"CREATE TABLE IF NOT EXISTS facts{VERSION} (path PRIMARY KEY, size, time, facts)")
            yield connection
    finally:
        connection.close()


def _cached(folder: Path) -> dict[File, Facts]:
    """{(path, size, time): facts}; nothing where there is no cache, or none that can be read."""
    if not (folder / NAME).exists():
        return {}
    try:
        with _database(folder) as connection:
            rows = connection.execute(f"SELECT path, size, time, facts FROM facts{VERSION}").fetchall()
            return {(str(folder / path), size, time): json.loads(facts) for path, size, time, facts in rows}
    except sqlite3.OperationalError:  # another process writes it, or it cannot be opened here
        return {}
    except (sqlite3.DatabaseError, ValueError):  # damaged
        with contextlib.suppress(OSError):
            (folder / NAME).unlink()
        return {}


def _keep(folder: Path, fresh: Mapping[File, Facts], files: list[File]) -> None:
    """Add to the cache, and forget files that are gone.  A store that cannot be written goes without."""
    rows = [
        (os.path.relpath(path, folder), size, time, json.dumps(facts)) for (path, size, time), facts in fresh.items()
    ]
    there = {os.path.relpath(path, folder) for path, _, _ in files}
    with contextlib.suppress(sqlite3.Error), _database(folder) as connection:
        gone = [row for row in connection.execute(f"SELECT path FROM facts{VERSION}") if row[0] not in there]
        connection.executemany(f"DELETE FROM facts{VERSION} WHERE path = ?", gone)
        connection.executemany(f"INSERT OR REPLACE INTO facts{VERSION} VALUES (?, ?, ?, ?)", rows)
