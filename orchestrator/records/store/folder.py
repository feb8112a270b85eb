"""A folder of records, found by run id."""

from __future__ import annotations

import contextlib
from pathlib import Path

import h5py

from ...errors import StoreError, did_you_mean
from ..file.access import UNREADABLE
from ..file.foreign import text_of
from ..file.format import ID_LENGTH
from ..file.run import Run


class Store:
    """A folder of records: FOLDER/<experiment>/<run id>.h5."""

    def __init__(self, folder: str | Path = "results"):
        self.folder = Path(folder)

    def records(self) -> list[Path]:
        """All records, oldest first; folders that begin with _ are ignored."""
        records = []
        for path in self.folder.glob("*/*.h5"):
            if not path.parent.name.startswith("_"):
                with contextlib.suppress(OSError):  # it was deleted meanwhile
                    records.append((path.stat().st_mtime_ns, path))
        return [path for _, path in sorted(records)]

    def find(self, run: str) -> Path:
        """The record that RUN names: a run id, a unique prefix of one, a file, or "last".

        Raises StoreError where it names none, or several.
        """
        if Path(run).is_file():
            return Path(run)
        records = self.records()
        if run == "last":
            if not records:
                raise StoreError(f"{self.folder} holds no record; run an experiment first")
            return records[-1]
        matches = [p for p in records if p.stem == run] or [p for p in records if p.stem.startswith(run)]
        if matches and len({p.stem for p in matches}) == 1:  # sweeps share runs: the record that holds most of it
            return max(matches, key=lambda p: p.stat().st_size)
        if matches:
            raise StoreError(f"{run!r} means several records: {', '.join(map(str, matches[:6]))}; give more of the id")
        near = did_you_mean(run, [p.stem for p in records], "there are")
        raise StoreError(f"no record {run!r} in {self.folder}{near}")

    def place(self, experiment: str, digest: str) -> tuple[str, Path]:
        """Run id and file for a digest; if a file with the same id has another digest, the id gets longer."""
        for length in range(ID_LENGTH, len(digest) + 1):
            run_id = digest[:length]
            path = self.folder / experiment / f"{run_id}.h5"
            if not path.exists() or _digest_of(path) in ("", digest):
                return run_id, path
        raise AssertionError("two digests cannot share all their digits")


def _digest_of(path: Path) -> str:
    try:
        with h5py.File(path, "r", locking=False) as file:
            return text_of(file, "digest")
    except UNREADABLE:
        return ""


def open_run(run: str | Path, results: str | Path = "results") -> Run:
    """Open a record: a run id, a unique prefix of one, a file, or "last" in the store `results`.

    Raises StoreError where there is none.
    """
    return Run(Store(results).find(str(run)))
