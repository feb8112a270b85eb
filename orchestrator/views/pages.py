"""HTML pages from templates: whatever is not markup already is escaped."""

from __future__ import annotations

from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

PACKAGE = "orchestrator"


def render(template: str, **values: Any) -> str:
    """The page of a template, which extends views/base.html.  template: its path in the package."""
    environment = Environment(
        loader=PackageLoader(PACKAGE, "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals["source"] = _source
    return environment.get_template(template).render(values)


def _source(name: str) -> Markup:
    """The text of a style sheet or script, as it is."""
    return Markup(resources.files(PACKAGE).joinpath(name).read_text(encoding="utf-8"))
