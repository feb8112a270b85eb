"""Records in the formats of other tools, one module a format.

The same run gives the same bytes: a file holds what decided the numbers, and nothing that was read from a clock.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ... import files
from ...errors import OrchError, StoreError

if TYPE_CHECKING:
    from ...records.file.run import Run
    from .content import Content


@dataclass(frozen=True)
class Format:
    """suffix: of its files.  needs: libraries that its module, as_<name>, imports beside orch's own dependencies.
    extra: the extra of orch that installs them."""

    suffix: str
    needs: tuple[str, ...] = ()
    extra: str = "export"


FORMATS = {
    "csv": Format(".csv"),
    "parquet": Format(".parquet", ("pyarrow",)),
    "mat": Format(".mat", ("scipy",)),
    "netcdf": Format(".nc", ("xarray", "h5netcdf")),
    "mcap": Format(".mcap", ("mcap",)),
    "tlog": Format(".tlog", ("pymavlink",), "mavlink"),
}


def named_by(target: Path) -> str | None:
    """The format of a file by its suffix; None for any other."""
    return next((name for name, form in FORMATS.items() if form.suffix == target.suffix.lower()), None)


def require(form: str) -> None:
    """Raises OrchError where a library that writes this format is not installed."""
    missing = [library for library in FORMATS[form].needs if not _is_installed(library)]
    if missing:
        libraries = " and ".join(missing)
        remedy = f'pip install "orch[{FORMATS[form].extra}]"'
        raise OrchError(f"the format {form} needs {libraries}, not installed here: {remedy}")


def export(run: Run, form: str, target: Path) -> Path:
    """Write a run's rows in a format, a key of FORMATS.

    Raises OrchError where a library is missing, StoreError where there is no row, the format cannot hold the rows, or
    the file cannot be written; an existing file is left as it was.
    """
    require(form)
    files.target(target, used=[run.path])
    if not len(run.time):
        raise StoreError(f"{run.path} holds no rows: there is nothing to export")
    from .content import read

    write: Callable[[Content, Path], None] = importlib.import_module(f".as_{form}", __name__).write
    with files.replacing(target) as half:
        write(read(run), half)
    return target


def _is_installed(library: str) -> bool:
    try:
        importlib.import_module(library)
    except ImportError:
        return False
    return True
