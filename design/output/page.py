"""Render the HTML pages: each is one file that refers to nothing outside itself.

``page.html`` holds the script that all pages share; every other template extends it. The style sheet is that
of all reports of the product, ``hil/host/page_style.html``.
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


STYLE_SHEET = "page_style.html"


def _template(name: str) -> str:
    folder = "hil.host" if name == STYLE_SHEET else "design.output"
    return resources.files(folder).joinpath(name).read_text("utf-8")
