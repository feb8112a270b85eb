"""Who depends on whom: inputs on the outputs they are connected to, outputs on inputs of the same instant."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from ..fmu.variables import Variable
from .plan import Component, Connection, Plan

Port = tuple[str, str]  # component, variable
Graph = dict[Port, list[Port]]
Node = TypeVar("Node", bound=Hashable)


@dataclass(frozen=True)
class Cycle:
    """Outputs that depend on themselves at once.  `path`: ports, each of which depends on the next, the last on the
    first; `ports`: all that hang together; `delayed`: the connections that are a step late because of it."""

    path: tuple[Port, ...]
    ports: frozenset[Port]
    delayed: tuple[Connection, ...]

    def __str__(self) -> str:
        return " <- ".join(f"{component}.{name}" for component, name in (*self.path, self.path[0]))


def dependencies(plan: Plan, initial: bool = False) -> Graph:
    """{port: those it depends on} of everything connected, while stepping or in initialization."""
    inputs: dict[str, list[Variable]] = {}
    outputs: dict[Port, tuple[Component, Variable]] = {}
    components = {component.name: component for component in plan.components}
    graph: Graph = {}
    for connection in plan.connections:
        inputs.setdefault(connection.sink, []).append(connection.input)
        outputs[connection.source, connection.output.name] = components[connection.source], connection.output
        graph[connection.sink, connection.input.name] = [(connection.source, connection.output.name)]
    for port, (component, output) in outputs.items():
        depends = output.depends
        if initial and output.array in component.fmu.initial_dependencies:
            depends = component.fmu.initial_dependencies[output.array]
        graph[port] = [
            (component.name, v.name) for v in inputs.get(component.name, []) if depends is None or v.array in depends
        ]
    return graph


def cycles(plan: Plan, initial: bool = False) -> list[Cycle]:
    """The cycles of direct feedthrough, one for each set of ports that hang together."""
    graph = dependencies(plan, initial)
    order = {component.name: i for i, component in enumerate(plan.components)}
    jacobi = plan.experiment.master.algorithm == "jacobi"
    loops = []
    for ports in components(graph):
        if len(ports) > 1 or ports[0] in graph.get(ports[0], []):
            within = frozenset(ports)
            delayed = tuple(
                connection
                for connection in plan.connections
                if {(connection.sink, connection.input.name), (connection.source, connection.output.name)} <= within
                and (jacobi or order[connection.source] >= order[connection.sink])
            )
            loops.append(Cycle(_path(graph, within), within, delayed))
    return loops


def components(graph: Mapping[Node, Iterable[Node]]) -> list[list[Node]]:
    """Strongly connected components, what is depended on first (Tarjan 1972, without recursion)."""
    index: dict[Node, int] = {}
    low: dict[Node, int] = {}
    stack: list[Node] = []
    on_stack: set[Node] = set()
    result: list[list[Node]] = []
    for root in graph:
        if root in index:
            continue
        work = [(root, iter(graph[root]))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            node, rest = work[-1]
            for below in rest:
                if below not in index:
                    index[below] = low[below] = len(index)
                    stack.append(below)
                    on_stack.add(below)
                    work.append((below, iter(graph.get(below, ()))))
                    break
                if below in on_stack:
                    low[node] = min(low[node], index[below])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    cut = stack.index(node)
                    result.append(stack[cut:])
                    on_stack -= set(stack[cut:])
                    del stack[cut:]
    return result


def _path(graph: Graph, within: frozenset[Port]) -> tuple[Port, ...]:
    """A shortest cycle from the first of the ports, in the order of the graph."""
    start = next(port for port in graph if port in within)
    came_from: dict[Port, Port] = {}
    queue = [start]
    for port in queue:
        for below in graph[port]:
            if below == start:
                path = [port]
                while path[-1] != start:
                    path.append(came_from[path[-1]])
                return tuple(reversed(path))
            if below in within and below not in came_from:
                came_from[below] = port
                queue.append(below)
    raise AssertionError("a strongly connected component has a cycle")
