"""Render the HTML pages: each is one file that refers to nothing outside itself.

``page.html`` holds the style sheet and the script that all pages share; every other template extends it.
"""

from __future__ import annotations

from importlib import resources
from typing import Any


def render_page(template: str, **values: Any) -> str:
    """Return the page that a template of this folder makes of the values; every value is escaped."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_template),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return environment.get_template(template).render(values)


def _template(name: str) -> str:
    return resources.files("design.output").joinpath(name).read_text("utf-8")
