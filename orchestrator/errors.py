"""What can go wrong, as a tree.

OrchError                 anything that is reported as an error message, without a traceback
  ExperimentError         the experiment file or its FMUs have problems: nothing was started (exit 2)
  FmuError                an FMU cannot be read, built or loaded (exit 2)
  StoreError              a record cannot be found, read or written (exit 2)
  RunError                the run itself failed; `.run` is open on the record (exit 3)
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from .arrays import Signals


class OrchError(Exception):
    """An error message that says where, what, and what would do."""

    exit_code = 2

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle: an exception would be made of its message alone, which fails where it takes other arguments, and
        a pool of processes breaks when one of its workers raises it."""
        return _unpickled, (type(self), self.args, vars(self))


def _unpickled(of: type[OrchError], arguments: tuple[Any, ...], attributes: dict[str, Any]) -> OrchError:
    error = of.__new__(of, *arguments)
    vars(error).update(attributes)
    return error


@dataclass(frozen=True)
class Problem:
    """One problem of a file.  key: the dotted key, "" for the file as a whole."""

    key: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.key}: {self.sentence}" if self.key else self.sentence


class ExperimentError(OrchError):
    """All problems of one file at once.  `.problems`: the list."""

    def __init__(self, path: object, problems: Sequence[Problem]):
        self.path, self.problems = str(path), list(problems)
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        super().__init__("\n  ".join([f"{path}: {count}", *map(str, problems)]))


class FmuError(OrchError):
    pass


class StoreError(OrchError):
    pass


class RunError(OrchError):
    """A run that failed.

    run: its record, open, as an `orchestrator.Run`; None where the record cannot be read, and in another process than
    the one that ran.
    """

    exit_code = 3

    def __init__(self, message: str, run: Signals | None = None):
        super().__init__(message)
        self.run = run

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self.args, {**vars(self), "run": None})


def did_you_mean(name: str, choices: Iterable[str], what: str = "known") -> str:
    """The end of a message on a name that does not exist: "; did you mean 'eta'?  known: eta, nu".

    A part that does not apply is left out.
    """
    choices = list(choices)
    lower = {choice.lower(): choice for choice in choices}
    near = difflib.get_close_matches(name, choices, n=1, cutoff=0.5)
    near += [lower[match] for match in difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.5)]
    hint = f"; did you mean {near[0]!r}?" if near else ";"
    if not choices:
        return f"{hint} there is none" if near else ""
    shown = ", ".join(choices[:12]) + (", ..." if len(choices) > 12 else "")
    return f"{hint} {what}: {shown}"


def no_such_file(path: Path, suffix: str, otherwise: Path | None = None) -> str:
    """The message for a file that does not exist, with the files of that suffix beside it, or in `otherwise`."""
    folder = path.parent if path.parent.is_dir() or not otherwise else otherwise
    return f"no such file{did_you_mean(path.name, sorted(p.name for p in folder.glob(f'*{suffix}')), f'in {folder}')}"
