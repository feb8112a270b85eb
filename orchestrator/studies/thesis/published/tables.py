"""Tables 5.2-5.7 of the thesis: each published number against ours, and whether they agree."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ....views.tables.latex import unit as latex_unit
from ..cases.chapter5 import CASES, LABELS, case_name, thesis_folder

CAPTIONS = {
    "5.2": "RMS error of the linear positions",
    "5.3": "RMS error of the angular positions",
    "5.4": "RMS of the control signal of each thruster",
    "5.5": "RMS error of the linear positions in a current",
    "5.6": "RMS error of the angular positions in a current",
    "5.7": "RMS of the control signal of each thruster in a current",
}
ZERO = 0.005  # deg; what is printed as 0 counts as met below this
GRADES = (0.01, 0.05, 0.20)  # relative errors that the counts are given for


@dataclass(frozen=True, kw_only=True)
class PublishedCell:
    """A published number, as experiments/thesis/published.csv has it.

    quantity: such as RMSE_x, RMS_T1, mean.  corrected: `printed` without the thesis's slips; `note` says why.
    band: largest relative error that counts as agreement; None where the cell is reported only.
    """

    table: str
    case: str
    quantity: str
    unit: str
    printed: float
    corrected: float
    band: float | None
    note: str


@dataclass(frozen=True)
class Verdict:
    """A published number beside ours."""

    cell: PublishedCell
    ours: float

    @property
    def error(self) -> float:
        """(ours - published)/published; 0 where a published 0 is met, inf where it is not."""
        published = self.cell.corrected
        if published == 0.0:
            return 0.0 if abs(self.ours) < ZERO else math.inf
        return (self.ours - published) / published

    @property
    def met(self) -> bool | None:
        """Whether ours lies within the cell's band; None where it has none."""
        return None if self.cell.band is None else abs(self.error) <= self.cell.band

    @property
    def word(self) -> str:
        if self.cell.band is None:
            return "reported"
        return f"within {self.cell.band:.0%}" if self.met else f"OUTSIDE {self.cell.band:.0%}"

    def sentence(self) -> str:
        cell = self.cell
        return (
            f"Table {cell.table}, {cell.case}, {cell.quantity}: published {cell.corrected:.4f}, "
            f"ours {self.ours:.4f} {'' if cell.unit == '1' else cell.unit}".rstrip()
            + f" ({_percent(self.error)}), {self.word}"
        )


def published() -> list[PublishedCell]:
    """All published cells, in the tables' order."""
    with (thesis_folder() / "published.csv").open(encoding="utf-8", newline="") as file:
        return [
            PublishedCell(
                table=row["table"],
                case=case_name("spiral", row["controller"], row["current"] == "yes", int(row["t_b_s"] or 0) or None),
                quantity=row["quantity"],
                unit=row["unit"],
                printed=float(row["printed"]),
                corrected=float(row["corrected"]),
                band=float(row["band"]) if row["band"] else None,
                note=row["note"],
            )
            for row in csv.DictReader(file)
        ]


def judge(metrics: Mapping[str, Mapping[str, float]]) -> list[Verdict]:
    """Every cell of the cases that have run.  metrics: {case: {metric of its file: value}}."""
    cells = published()
    verdicts = []
    for cell in cells:
        if cell.case not in metrics:
            continue
        of = metrics[cell.case]
        if cell.quantity == "mean":
            parts = [c for c in cells if (c.table, c.case) == (cell.table, cell.case) and c.quantity != "mean"]
            ours = sum(of[metric_name(c.quantity)] for c in parts) / len(parts)
        else:
            ours = of[metric_name(cell.quantity)]
        verdicts.append(Verdict(cell, ours))
    return verdicts


def metric_name(quantity: str) -> str:
    """The metric of the experiment files: rmse_x of RMSE_x."""
    kind, _, axis = quantity.partition("_")
    return f"{kind.lower()}_{axis}"


def counts(verdicts: Sequence[Verdict]) -> dict[str, dict[str, int]]:
    """{controller: {"cells", "within 1%", ..., "gated", "outside"}}; means are not counted."""
    by_controller: dict[str, dict[str, int]] = {}
    for verdict in verdicts:
        if verdict.cell.quantity == "mean":
            continue
        names = ["cells", *(f"within {g:.0%}" for g in GRADES), "gated", "outside"]
        row = by_controller.setdefault(LABELS[CASES[verdict.cell.case].controller], dict.fromkeys(names, 0))
        row["cells"] += 1
        for grade in GRADES:
            row[f"within {grade:.0%}"] += abs(verdict.error) <= grade
        row["gated"] += verdict.met is not None
        row["outside"] += verdict.met is False
    return by_controller


def best(verdicts: Sequence[Verdict]) -> tuple[set[PublishedCell], set[PublishedCell]]:
    """The smallest number of each column, at the four decimals that are printed: published, ours."""
    columns: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in verdicts:
        columns.setdefault((verdict.cell.table, verdict.cell.quantity), []).append(verdict)
    theirs, ours = set(), set()
    for column in columns.values():
        least, own = min(v.cell.corrected for v in column), min(round(v.ours, 4) for v in column)
        theirs |= {v.cell for v in column if v.cell.corrected == least}
        ours |= {v.cell for v in column if round(v.ours, 4) == own}
    return theirs, ours


def markdown(table: str, verdicts: Sequence[Verdict]) -> str:
    rows = _of(table, verdicts)
    theirs, ours = best(rows)
    lines = [f"# Table {table}: {CAPTIONS[table]}", ""]
    lines += ["Best value of each quantity in bold. RMSE of x, y, z in m, of phi, theta, psi in degrees.", ""]
    lines += ["| quantity | controller | published | ours | relative error | verdict |", "|---|---|---:|---:|---:|---|"]
    notes = []
    for v in rows:
        mark = ""
        if v.cell.note:
            notes.append(v.cell.note)
            mark = f" [{len(notes)}]"
        published, own = f"{v.cell.corrected:.4f}", f"{v.ours:.4f}"
        published = f"**{published}**" if v.cell in theirs else published
        own = f"**{own}**" if v.cell in ours else own
        cells = [v.cell.quantity, CASES[v.cell.case].label, published + mark, own, _percent(v.error), v.word]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *(f"[{k}] {note}  " for k, note in enumerate(notes, 1))] if notes else []
    return "\n".join(lines) + "\n"


def csv_text(table: str, verdicts: Sequence[Verdict]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        [
            "table",
            "case",
            "controller",
            "quantity",
            "unit",
            "printed",
            "published",
            "ours",
            "relative_error",
            "band",
            "verdict",
            "note",
        ]
    )
    for v in _of(table, verdicts):
        c = v.cell
        row = [c.table, c.case, CASES[c.case].controller, c.quantity, c.unit, c.printed, c.corrected, f"{v.ours:.8g}"]
        writer.writerow([*row, f"{v.error:.6g}", "" if c.band is None else c.band, v.word, c.note])
    return stream.getvalue()


def latex(table: str, verdicts: Sequence[Verdict]) -> str:
    """A table for siunitx and booktabs."""
    rows = _of(table, verdicts)
    theirs, ours = best(rows)
    lines = [
        r"% \usepackage{booktabs, siunitx}",
        r"\begin{table}",
        r"  \centering",
        r"  \sisetup{detect-weight = true, detect-inline-weight = math, table-format = 3.4}",
        rf"  \caption{{{CAPTIONS[table]}: published (Table {table} of the thesis) and reproduced. Best values bold.}}",
        r"  \begin{tabular}{llSSS[table-format = +3.2]l}",
        r"    \toprule",
        r"    Quantity & Controller & {Published} & {Ours} & {Rel. error (\%)} & Verdict \\",
    ]
    previous = ""
    for v in rows:
        if v.cell.quantity != previous:
            lines.append(r"    \midrule")
        name = _latex_quantity(v.cell) if v.cell.quantity != previous else ""
        previous = v.cell.quantity
        published = (r"\bfseries " if v.cell in theirs else "") + f"{v.cell.corrected:.4f}"
        own = (r"\bfseries " if v.cell in ours else "") + f"{v.ours:.4f}"
        error = f"{100 * v.error:+.2f}" if math.isfinite(v.error) else "{--}"
        columns = [name, CASES[v.cell.case].label, published, own, error, v.word.replace("%", r"\%")]
        lines.append("    " + " & ".join(columns) + r" \\")
    lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]
    return "\n".join(lines) + "\n"


def _of(table: str, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """The cells of one table, quantity by quantity."""
    rows = [v for v in verdicts if v.cell.table == table]
    order = list(dict.fromkeys(v.cell.quantity for v in rows))
    return sorted(rows, key=lambda v: order.index(v.cell.quantity))


def _latex_quantity(cell: PublishedCell) -> str:
    kind, _, axis = cell.quantity.partition("_")
    symbol = f"T_{axis[1:]}" if axis[:1] == "T" else rf"\{axis}" if len(axis) > 1 else axis
    name = f"{kind} ${symbol}$" if axis else "Mean"
    return name + (f" ({latex_unit(cell.unit)})" if cell.unit != "1" else "")


def _percent(error: float) -> str:
    return f"{100 * error:+.2f} %" if math.isfinite(error) else "-"
