"""The reference of the experiment file: its JSON Schema, for editors, and the tables of docs/experiment.md.

python -m orchestrator.experiment.schema.reference docs/experiment.md    writes the schema and the page's tables again
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from .. import toml
from .sections import EXPERIMENT, SECTIONS
from .value_types import Key, Section

SCHEMA = Path(__file__).parent / "experiment.schema.json"
TABLE_OF = re.compile(r"(<!-- keys of (.+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def json_schema() -> str:
    """The text of the JSON Schema: what an editor can know of a file; what hangs together, `orch check` judges."""
    about = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Experiment of orch",
        "description": "A co-simulation of FMUs: orch run EXPERIMENT.toml",
    }
    return json.dumps(about | EXPERIMENT.json, indent=1, ensure_ascii=False) + "\n"


def with_tables(page: str) -> str:
    """A page with the tables between its marks, <!-- keys of HEADING --> and <!-- end -->, as they are today.

    Raises KeyError where a mark names no section, or a section has no mark.
    """
    sections = {section.heading: section for section in SECTIONS}
    marked = [heading for _, heading, _ in TABLE_OF.findall(page)]
    if missing := sections.keys() - set(marked):
        raise KeyError(f"no table of {', '.join(sorted(missing))}")
    return TABLE_OF.sub(lambda mark: f"{mark[1]}{table(sections[mark[2]])}{mark[3]}", page)


def table(section: Section) -> str:
    """The keys of a section as Markdown, and what its variants need."""
    rows = [["key", "type", "unit", "default", "meaning", "example"]]
    rows += [
        [f"`{key.name}`", key.type.words, key.unit, _default(key), key.meaning, f"`{key.example}`"]
        for key in section.keys
    ]
    text = _markdown(rows)
    if section.variants:
        rows = [[f"`{section.by}`", "needs", "takes", "meaning", "unit"]]
        for name, variant in section.variants.items():
            needs, takes = (", ".join(f"`{key}`" for key in keys) for keys in (variant.needs, variant.takes))
            rows.append([f"`{name}`", needs, takes, variant.meaning, variant.unit])
        used = [column for column in zip(*rows, strict=True) if any(column[1:])]
        text += "\n" + _markdown([list(row) for row in zip(*used, strict=True)])
    return text


def _default(key: Key) -> str:
    if key.required:
        return "**required**"
    return key.absent if key.default is None else f"`{_toml(key.default)}`"


def _toml(value: Any) -> str:
    return toml.write({"key": value}).removeprefix("key = ").strip()


def _markdown(rows: list[list[str]]) -> str:
    head, *body = [[cell.replace("|", r"\|") for cell in row] for row in rows]
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main(page: Path) -> None:
    page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")
    SCHEMA.write_text(json_schema(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
