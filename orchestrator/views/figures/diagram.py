"""The system as a diagram: components in columns from references to vehicles, connections as arrows.

As SVG, inside a page or as a file of its own, and as Mermaid.  In SVG an arrow to the next column runs straight; every
other one, feedback above all, leaves to the right, runs in a lane above or below all components, and comes in from the
left: so no arrow crosses a component.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...files import write_text
from ...names import split_axis

if TYPE_CHECKING:
    from ...plan.plan import Plan

WIDTH, HEIGHT = 148, 50  # px, of a component
GUTTER, GAP = 112, 34  # px, between columns, between the components of one
LANE, LINE = 20, 13  # px, between lanes, between lines of a label
STYLE = """
svg { font-family: system-ui, "Segoe UI", "DejaVu Sans", sans-serif; font-size: 13px; background: #fff; }
#tip path { fill: #5c6b73; } .component rect { fill: #f4f7f8; stroke: #0b7285; stroke-width: 1.4; }
.component text { text-anchor: middle; fill: #1c2529; font-weight: 600; }
.component .fmu { fill: #5c6b73; font-weight: 400; font-size: 11.5px; }
.arrow { fill: none; stroke: #5c6b73; stroke-width: 1.3; } .arrow.back { stroke-dasharray: 5 3; }
.vector { text-anchor: middle; fill: #1c2529; font-size: 11.5px; stroke: #fff; stroke-width: 4px; paint-order: stroke; }
"""
RESERVED = {
    "end",
    "graph",
    "subgraph",
    "flowchart",
    "default",
    "class",
    "classDef",
    "style",
    "click",
    "linkStyle",
    "direction",
}  # what Mermaid does not take as a node's name
Arrows = dict[tuple[str, str], list[str]]  # {(source, sink): names of the vectors}


def diagram(resolved: Mapping[str, Any], vehicles: Iterable[str]) -> str:
    """An inline SVG of a resolved experiment.  vehicles: components whose outputs are feedback."""
    fmus = {str(component["name"]): str(component["fmu"]) for component in resolved.get("components", [])}
    arrows = _arrows(resolved.get("connections", []))
    columns = _columns(list(fmus), list(arrows), set(vehicles))
    if not fmus:
        return ""
    return _Drawing(fmus, arrows, columns).svg()


def draw(plan: Plan, target: Path) -> Path:
    """Draw a plan into a file whose suffix is in FORMS.  Raises StoreError where it cannot be written."""
    return write_text(target, FORMS[target.suffix.lower()](plan.resolved, feedback(plan)))


def feedback(plan: Plan) -> set[str]:
    """Components with inputs whose outputs are states only: no output depends directly on an input."""
    fed = {connection.sink for connection in plan.connections}
    direct = {connection.source for connection in plan.connections if connection.output.feedthrough}
    return fed & {connection.source for connection in plan.connections} - direct


def mermaid(resolved: Mapping[str, Any], vehicles: Iterable[str]) -> str:
    """A Mermaid flowchart; feedback is dotted.  Arguments as of `diagram`."""
    back = set(vehicles)
    lines = ["flowchart LR"]
    for component in resolved["components"]:
        fmu = _fmu_name(str(component["fmu"]))
        lines.append(f'    {_node(component["name"])}["{_quoted(component["name"])}<br/>{_quoted(fmu)}"]')
    for (source, sink), names in _arrows(resolved["connections"]).items():
        arrow = "-.->" if source in back else "-->"
        lines.append(f'    {_node(source)} {arrow}|"{_quoted(", ".join(names))}"| {_node(sink)}')
    return "\n".join(lines) + "\n"


def _standalone(resolved: Mapping[str, Any], vehicles: Iterable[str]) -> str:
    svg = diagram(resolved, vehicles)
    head, _, rest = svg.partition(">")
    return f'{head} xmlns="http://www.w3.org/2000/svg"><style>{STYLE}</style>{rest}\n'


def _fenced(resolved: Mapping[str, Any], vehicles: Iterable[str]) -> str:
    return f"```mermaid\n{mermaid(resolved, vehicles)}```\n"


FORMS = {".svg": _standalone, ".mmd": mermaid, ".md": _fenced}


def _node(name: str) -> str:
    return f"{name}_" if name in RESERVED else name


def _quoted(text: str) -> str:
    return text.replace("#", "#35;").replace('"', "#quot;").replace("<", "#lt;").replace(">", "#gt;")


def _fmu_name(fmu: str) -> str:
    return fmu.replace("\\", "/").rpartition("/")[2]


def _arrows(connections: Iterable[Sequence[Any]]) -> Arrows:
    """Scalar connections (input, output, what lies between), gathered: "eta", or "u to command" where names differ."""
    arrows: Arrows = {}
    for sink, source, *between in connections:
        (source_component, _, source_name), (sink_component, _, sink_name) = source.partition("."), sink.partition(".")
        names = split_axis(source_name)[0], split_axis(sink_name)[0]
        label = names[0] if names[0] == names[1] else f"{names[0]} → {names[1]}"
        label += " (scaled)" if between else ""
        labels = arrows.setdefault((source_component, sink_component), [])
        if label not in labels:
            labels.append(label)

    def order(label: str) -> tuple[str, int]:  # eta_d before eta_d_dot before eta_d_ddot
        return label.partition("_")[0], len(label)

    return {pair: sorted(labels, key=order) for pair, labels in arrows.items()}


def _columns(names: Sequence[str], pairs: Sequence[tuple[str, str]], vehicles: set[str]) -> list[list[str]]:
    """Components by the longest path to them, then moved towards what they feed; rows ordered for few crossings."""
    onward: dict[str, list[str]] = {name: [] for name in names}
    for source, sink in pairs:
        if source not in vehicles and source != sink and not _reaches(onward, sink, source):
            onward[source].append(sink)
    rank = dict.fromkeys(names, 0)
    for _ in names:
        for source, sinks in onward.items():
            for sink in sinks:
                rank[sink] = max(rank[sink], rank[source] + 1)
    for name in sorted(names, key=lambda n: -rank[n]):
        if onward[name]:
            rank[name] = min(rank[sink] for sink in onward[name]) - 1
    columns: list[list[str]] = [[n for n in names if rank[n] == r] for r in range(max(rank.values(), default=0) + 1)]
    for left, right in reversed(list(pairwise(columns))):
        place = {name: i / len(right) for i, name in enumerate(right)}
        means = {n: [place[s] for s in onward[n] if s in place] or [0.5] for n in left}
        left.sort(key=lambda n: sum(means[n]) / len(means[n]))
    return columns


def _reaches(onward: Mapping[str, Sequence[str]], start: str, goal: str) -> bool:
    seen, stack = {start}, [start]
    while stack:
        name = stack.pop()
        if name == goal:
            return True
        new = [sink for sink in onward.get(name, []) if sink not in seen]
        seen.update(new)
        stack += new
    return False


class _Drawing:
    def __init__(self, fmus: Mapping[str, str], arrows: Arrows, columns: Sequence[Sequence[str]]):
        self.fmus, self.arrows = fmus, arrows
        self.column = {name: i for i, names in enumerate(columns) for name in names}
        around = [pair for pair in arrows if self.column[pair[1]] != self.column[pair[0]] + 1]
        self.inner = max(len(names) * (HEIGHT + GAP) for names in columns)
        self.y = {
            name: (k + 0.5) * self.inner / len(names) for names in columns for k, name in enumerate(names)
        }  # middles, of what lies between the lanes
        above = [pair for pair in around if self.y[pair[0]] <= self.inner / 2]
        below = [pair for pair in around if pair not in above]
        self.lane = {pair: -LANE * (i + 0.4) for i, pair in enumerate(sorted(above, key=lambda p: self.y[p[0]]))}
        self.lane |= {
            pair: self.inner + LANE * (i + 0.4) for i, pair in enumerate(sorted(below, key=lambda p: -self.y[p[0]]))
        }
        self.top = LANE * len(above) + 16
        self.height = self.inner + self.top + LANE * len(below) + 16
        self.edge = 14 + 8 * len(around)  # px, left and right of all columns: the way up and down
        self.width = len(columns) * WIDTH + (len(columns) - 1) * GUTTER + 2 * self.edge

    def svg(self) -> str:
        parts = [
            f'<svg class="diagram" viewBox="0 0 {self.width} {self.height:.0f}" '
            f'width="{self.width}" height="{self.height:.0f}" role="img" '
            f'style="min-width:{self.width * 0.8:.0f}px;max-width:{self.width}px" '
            f'aria-label="{escape(self._words())}">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="7.5" refY="4" markerWidth="8" markerHeight="8" '
            'orient="auto" markerUnits="userSpaceOnUse"><path d="M0 0.5 8 4 0 7.5z"/></marker></defs>',
        ]
        drawn = [self._around(*pair) if pair in self.lane else self._onward(*pair) for pair in self.arrows]
        parts += [f'<path class="arrow{kind}" d="{path}" marker-end="url(#tip)"/>' for path, kind, _ in drawn]
        parts += [self._component(name) for name in self.fmus]
        parts += [label for _, _, label in drawn]
        return "\n".join([*parts, "</svg>"])

    def _left(self, name: str) -> float:
        return self.edge + self.column[name] * (WIDTH + GUTTER)

    def _middle(self, name: str) -> float:
        return self.top + self.y[name]

    def _port(self, pair: tuple[str, str], end: int) -> float:
        """Where an arrow leaves (end 0) or enters (end 1), spread over the side in the order of the other ends."""
        name = pair[end]

        def other(p: tuple[str, str]) -> float:
            return self.lane.get(p, self.y[p[1 - end]])

        beside = sorted((p for p in self.arrows if p[end] == name), key=other)
        spread = min(14.0, (HEIGHT - 14) / max(1, len(beside) - 1))
        return self._middle(name) + (beside.index(pair) - (len(beside) - 1) / 2) * spread

    def _onward(self, source: str, sink: str) -> tuple[str, str, str]:
        x, end = self._left(source) + WIDTH, self._left(sink)
        y, to = self._port((source, sink), 0), self._port((source, sink), 1)
        bend = GUTTER * 0.45
        path = f"M{x} {y:.1f}C{x + bend} {y:.1f} {end - bend} {to:.1f} {end} {to:.1f}"
        return path, "", self._label(self.arrows[source, sink], (x + end) / 2, (y + to) / 2)

    def _around(self, source: str, sink: str) -> tuple[str, str, str]:
        pair = (source, sink)
        lane, out = self.top + self.lane[pair], 12 + 8 * (list(self.lane).index(pair))
        x, end = self._left(source) + WIDTH, self._left(sink)
        path = f"M{x} {self._port(pair, 0):.1f}h{out}V{lane:.1f}H{end - out}V{self._port(pair, 1):.1f}H{end}"
        return path, " back", self._label([", ".join(self.arrows[pair])], (x + end) / 2, lane)

    def _label(self, lines: Sequence[str], x: float, y: float) -> str:
        """Lines above a point of an arrow."""
        first = y - (len(lines) - 1) * LINE - 5
        spans = [
            f'<tspan x="{x:.1f}" y="{first + i * LINE:.1f}">{escape(line)}</tspan>' for i, line in enumerate(lines)
        ]
        return f'<text class="vector">{"".join(spans)}</text>'

    def _component(self, name: str) -> str:
        x, y = self._left(name), self._middle(name) - HEIGHT / 2
        middle = x + WIDTH / 2
        fmu = _fmu_name(self.fmus[name])
        return (
            f'<g class="component"><title>{escape(name)}: {escape(self.fmus[name])}</title>'
            f'<rect x="{x}" y="{y:.1f}" width="{WIDTH}" height="{HEIGHT}" rx="7"/>'
            f'<text x="{middle}" y="{y + 21:.1f}">{escape(_short(name, 19))}</text>'
            f'<text class="fmu" x="{middle}" y="{y + 37:.1f}">{escape(_short(fmu, 22))}</text></g>'
        )

    def _words(self) -> str:
        """The diagram in words, for screen readers."""
        words = [f"{source} gives {sink} {', '.join(names)}" for (source, sink), names in self.arrows.items()]
        return f"System of {len(self.fmus)} components. " + "; ".join(words)


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
