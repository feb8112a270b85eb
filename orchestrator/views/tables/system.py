"""The system of an experiment as tables: its components and its connections."""

from __future__ import annotations

from collections.abc import Sequence

from ...names import split_axis
from ...plan.plan import Connection, Plan

Rows = list[tuple[str, ...]]


def components(plan: Plan) -> Rows:
    """A row for each component, in the order of stepping, below a row of titles."""
    rows: Rows = [("component", "fmu", "version", "packaging", "steps every")]
    for component in plan.components:
        step = plan.experiment.grid.time(component.period)
        rows.append(
            (
                component.name,
                component.fmu_name,
                f"FMI {component.fmu.fmi_version}",
                component.fmu.packaging,
                f"{step:g} s",
            )
        )
    return rows


def connections(plan: Plan) -> Rows:
    """A row for each connected scalar or vector, below a row of titles."""
    rows: Rows = [("input", "output", "axes", "unit", "conversion")]
    groups: dict[tuple[str, str], list[Connection]] = {}
    for connection in plan.connections:
        ends = (connection.sink, connection.input.name), (connection.source, connection.output.name)
        sink, source = (f"{component}.{split_axis(name)[0]}" for component, name in ends)
        alone = bool(split_axis(connection.input.name)[1]) != bool(split_axis(connection.output.name)[1])
        key = tuple(f"{component}.{name}" for component, name in ends) if alone else (sink, source)
        groups.setdefault((key[0], key[1]), []).append(connection)
    for (sink, source), connections in groups.items():
        conversion = ", ".join(dict.fromkeys(map(_conversion, connections)))
        units = ", ".join(dict.fromkeys(map(_unit, connections)))
        rows.append((sink, source, _axes(connections), units, conversion))
    return rows


def _axes(connections: Sequence[Connection]) -> str:
    """ "x y z"; "T1 <- 1" where the two ends name an axis differently."""
    pairs = [
        (split_axis(connection.input.name)[1], split_axis(connection.output.name)[1]) for connection in connections
    ]
    if not all(pair[0] and pair[1] for pair in pairs):
        return "-"
    return " ".join(a if a == b else f"{a}<-{b}" for a, b in pairs)


def _conversion(connection: Connection) -> str:
    """From the output to the input: " x 0.0174533 (deg to rad)"."""
    scale = f"x {connection.factor:g}" * (connection.factor != 1.0) + f" {connection.offset:+g}" * (
        connection.offset != 0.0
    )
    ends = [variable.unit or variable.type for variable in (connection.output, connection.input)]
    if ends[0] != ends[1] and (
        (connection.output.unit and connection.input.unit) or connection.output.kind != connection.input.kind
    ):
        return f"{scale} ({ends[0]} to {ends[1]})".strip()
    return scale.strip() or "-"


def _unit(connection: Connection) -> str:
    """The input's unit; where one end states none, nothing says that the other end's is meant."""
    given, wanted = connection.output.unit, connection.input.unit
    if bool(given) == bool(wanted):
        return wanted or "-"
    return f"{wanted} (output: no unit)" if wanted else f"{given} (input: no unit)"
