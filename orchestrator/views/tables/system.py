"""The system that an experiment is, as tables: its components, and what is connected to what."""

from __future__ import annotations

from collections.abc import Sequence

from ...fmu.variables import split_axis
from ...plan.plan import Link, Plan

Rows = list[tuple[str, ...]]


def components(plan: Plan) -> Rows:
    """A row a component, in the order of stepping, below a row of titles."""
    rows: Rows = [("component", "fmu", "version", "packaging", "steps every")]
    for part in plan.parts:
        step = plan.experiment.grid.time(part.period)
        rows.append((part.name, part.fmu_name, f"FMI {part.fmu.fmi_version}", part.fmu.packaging, f"{step:g} s"))
    return rows


def connections(plan: Plan) -> Rows:
    """A row for what goes together from one component to another: a scalar, or axes of a vector."""
    rows: Rows = [("input", "output", "axes", "unit", "conversion")]
    groups: dict[tuple[str, str], list[Link]] = {}
    for link in plan.links:
        ends = (link.sink, link.input.name), (link.source, link.output.name)
        sink, source = (f"{component}.{split_axis(name)[0]}" for component, name in ends)
        alone = bool(split_axis(link.input.name)[1]) != bool(split_axis(link.output.name)[1])
        key = tuple(f"{component}.{name}" for component, name in ends) if alone else (sink, source)
        groups.setdefault((key[0], key[1]), []).append(link)
    for (sink, source), links in groups.items():
        conversion = ", ".join(dict.fromkeys(map(_conversion, links)))
        rows.append((sink, source, _axes(links), _each([link.input.unit for link in links]), conversion))
    return rows


def _axes(links: Sequence[Link]) -> str:
    """ "x y z"; "T1 <- 1" where the two ends call an axis by different names."""
    pairs = [(split_axis(link.input.name)[1], split_axis(link.output.name)[1]) for link in links]
    if not all(pair[0] and pair[1] for pair in pairs):
        return "-"
    return " ".join(a if a == b else f"{a}<-{b}" for a, b in pairs)


def _conversion(link: Link) -> str:
    """From the output to the input: " x 0.0174533 (deg to rad)"."""
    scale = f"x {link.factor:g}" * (link.factor != 1.0) + f" {link.offset:+g}" * (link.offset != 0.0)
    ends = [variable.unit or variable.type for variable in (link.output, link.input)]
    if ends[0] != ends[1] and ((link.output.unit and link.input.unit) or link.output.kind != link.input.kind):
        return f"{scale} ({ends[0]} to {ends[1]})".strip()
    return scale.strip() or "-"


def _each(units: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(unit or "-" for unit in units))
