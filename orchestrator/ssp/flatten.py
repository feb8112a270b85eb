"""Nested systems as one: every FMU input with the output that drives it, every FMU with its parameter values.

A connector of a system is a node that signals pass through; the way back from an FMU's input through such nodes ends at
an FMU's output, or at the border of the whole, where nothing drives it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ..errors import Problem
from .archive import Unreadable
from .parameters import Value
from .structure import Element, SsdConnection, Structure

ElementPath = tuple[str, ...]  # names of elements, from the outermost system's elements down; () is that system
Node = tuple[ElementPath, str]  # an element and a connector of it
GIVES, TAKES = {"output", "calculatedParameter"}, {"input", "parameter"}


@dataclass(frozen=True, kw_only=True)
class Drive:
    """What drives an input: factor * source + offset, units converted before unless `convert` is false."""

    source: Node
    factor: float = 1.0
    offset: float = 0.0
    scaled: bool = False  # factor and offset are given
    convert: bool = True


@dataclass
class Flat:
    components: dict[ElementPath, Element] = field(default_factory=dict)
    drives: dict[Node, Drive] = field(default_factory=dict)  # of inputs of components
    values: dict[ElementPath, dict[str, Value]] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)  # parameters that name nothing: the standard ignores them


def flatten(structure: Structure) -> Flat:
    """Adds to the structure's problems what cannot be flattened."""
    return _Flattener(structure).flat()


class _Flattener:
    def __init__(self, structure: Structure):
        self.structure, self.result = structure, Flat()
        self.elements: dict[ElementPath, Element] = {}
        self.incoming: dict[Node, tuple[Node, SsdConnection]] = {}
        self.outgoing: dict[Node, list[tuple[Node, SsdConnection]]] = {}

    def problem(self, key: str, sentence: str) -> None:
        self.structure.problems.append(Problem(key, sentence))

    def flat(self) -> Flat:
        self.collect((), self.structure.system)
        for path, element in self.elements.items():
            for connection in element.connections:
                self.connect(path, element, connection)
        for node in self.incoming:
            if node[0] in self.result.components:
                self.drive(node)
        self.bind((), self.structure.system)
        return self.result

    def collect(self, path: ElementPath, element: Element) -> None:
        if path in self.elements:
            self.problem(".".join(path), "is the name of two elements")
            return
        self.elements[path] = element
        if element.leaf:
            self.result.components[path] = element
        for below in element.elements:
            self.collect((*path, below.name), below)

    def connect(self, path: ElementPath, system: Element, connection: SsdConnection) -> None:
        where = self.where(path, connection)
        nodes, gives = [], []
        for element, connector in (connection.start, connection.end):
            node: Node = ((*path, element) if element else path, connector)
            if node[0] not in self.elements:
                self.problem(where, f"there is no element {element!r}")
                return
            declared = self.elements[node[0]].connectors.get(connector)
            kind = declared.kind if declared is not None else ""
            if declared is None and not self.elements[node[0]].leaf:
                self.problem(where, f"{element or 'the system'} has no connector {connector!r}")
                return
            if kind and kind not in GIVES | TAKES:
                self.problem(where, f"{connector} is of kind {kind!r}, which orch does not connect")
                return
            nodes.append(node)
            gives.append(None if not kind else (kind in GIVES) == bool(element))
        # Start and end say nothing of the direction; the kinds do, where they are given.
        forward = gives[0] if gives[0] is not None else not gives[1] if gives[1] is not None else True
        if None not in gives and gives[0] == gives[1]:
            self.problem(where, "both ends are sources, or both are sinks")
            return
        source, sink = nodes if forward else reversed(nodes)
        if sink in self.incoming:
            self.problem(where, f"{self.name(sink)} has two drivers; keep one")
            return
        self.incoming[sink] = (source, connection)
        self.outgoing.setdefault(source, []).append((sink, connection))

    def drive(self, sink: Node) -> None:
        """Follow the way back to the FMU that drives an input."""
        node, factor, offset, scaled, convert, seen = sink, 1.0, 0.0, False, True, {sink}
        ways: list[tuple[Node, SsdConnection]] = []
        while node in self.incoming:
            node, connection = self.incoming[node]
            ways.append((node, connection))
            factor, offset = factor * connection.factor, factor * connection.offset + offset
            scaled, convert = scaled or connection.scaled, convert and connection.convert
            if node in seen:
                self.problem(self.name(sink), "is driven by a circle of connections")
                return
            seen.add(node)
        if node[0] not in self.result.components:
            return  # the border of the whole: nothing drives it
        units = {c.unit for at, _ in ways[:-1] if (c := self.elements[at[0]].connectors.get(at[1])) and c.unit}
        ends = {c.unit for at in (sink, node) if (c := self.elements[at[0]].connectors.get(at[1])) and c.unit}
        if len(ways) > 1 and (scaled or not convert) and len(units | ends) > 1:
            self.problem(
                self.name(sink),
                "gets its signal through systems that change both unit and scale; connect it in one step",
            )
            return
        kinds = {c.kind for at in (sink, node) if (c := self.elements[at[0]].connectors.get(at[1]))}
        if kinds & {"parameter", "calculatedParameter"}:
            self.problem(self.name(sink), f"is a parameter connected to {self.name(node)}; give its value instead")
            return
        self.result.drives[sink] = Drive(source=node, factor=factor, offset=offset, scaled=scaled, convert=convert)

    def bind(self, path: ElementPath, element: Element) -> None:
        """Parameter values: of the innermost elements first, since those further out take precedence."""
        for below in element.elements:
            self.bind((*path, below.name), below)
        for binding in element.bindings:
            for name, value in binding.items():
                targets = list(self.targets(path, element, name))
                for target, connections in targets:
                    try:
                        for connection in connections:
                            value = value.transformed(connection.factor, connection.offset)
                    except Unreadable as error:
                        self.problem(self.name((path, name)), f"cannot be passed on: {error}")
                        continue
                    self.result.values.setdefault(target[0], {})[target[1]] = value
                if not targets:
                    self.result.unused.append(self.name((path, name)))

    def targets(
        self, path: ElementPath, element: Element, name: str
    ) -> Iterator[tuple[Node, tuple[SsdConnection, ...]]]:
        """The FMU variables that a parameter of an element means, and the connections on the way there."""
        if element.leaf:
            yield (path, name), ()
            return
        if name in element.connectors:
            stack: list[tuple[Node, tuple[SsdConnection, ...]]] = [((path, name), ())]
            seen = set()
            while stack:
                node, way = stack.pop()
                if node in seen:
                    continue
                seen.add(node)
                if node[0] in self.result.components:
                    yield node, way
                else:
                    stack += [(sink, (*way, connection)) for sink, connection in self.outgoing.get(node, ())]
            return
        for below in element.elements:
            if name.startswith(f"{below.name}."):
                yield from self.targets((*path, below.name), below, name.removeprefix(f"{below.name}."))

    def where(self, path: ElementPath, connection: SsdConnection) -> str:
        ends = [".".join(filter(None, (*path, *end))) for end in (connection.start, connection.end)]
        return f"connection {ends[0]} to {ends[1]}"

    def name(self, node: Node) -> str:
        return ".".join((*node[0], node[1]))
