"""What a reproduction of the thesis gives: the runs, each published number beside ours, the claims, what disagrees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cases.runs import CaseRecord
from . import tables
from .claims import Claim
from .tables import Verdict


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """folder: of the files; figures: numbers; drawn: how many of them were drawn now; study: rows of the step study.

    outside: a sentence for every gated cell and claim that is not met.
    """

    folder: Path
    records: tuple[CaseRecord, ...]
    verdicts: tuple[Verdict, ...]
    claims: tuple[Claim, ...]
    figures: tuple[str, ...]
    drawn: int
    outside: tuple[str, ...]
    study: tuple[Mapping[str, Any], ...]
    quick: bool

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Cells by controller, see `tables.counts`."""
        return tables.counts(self.verdicts)
