"""HTML pages from templates; text is escaped, unless it is marked as markup."""

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
    """A style sheet or script, unescaped."""
    return Markup(resources.files(PACKAGE).joinpath(name).read_text(encoding="utf-8"))
