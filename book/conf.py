"""Sphinx's configuration of the book; `make book` builds it from pages that `book/pages.py` puts together."""

from __future__ import annotations

import base64
import io
from typing import Any

from docutils import nodes

import sfglab

project, author, release = "sfglab", "The sfglab authors", sfglab.__version__
copyright = author  # noqa: A001 - Sphinx's name
extensions = ["myst_nb", "sphinx_copybutton"]
html_theme = "sphinx_book_theme"
html_title = "sfglab"
html_theme_options = {
    "show_navbar_depth": 1,
    "use_download_button": False,
    "use_fullscreen_button": False,
}
html_static_path = ["_static"]
html_extra_path = ["extra"]
html_css_files = ["book.css"]
html_js_files = ["ledger.js"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "drawn"

nb_execution_mode = "off"  # the committed outputs are what was measured
# A widget's still stands beside it in the same output; without a kernel only that is shown.
nb_mime_priority_overrides = [
    ("html", "application/vnd.jupyter.widget-view+json", None),
    ("html", "image/png", 5),
]
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 4
smartquotes = False  # an option such as --profile keeps both dashes
suppress_warnings = ["mystnb.mime_priority"]
copybutton_prompt_text = "$ "


def _drawn(formula: str) -> str:
    """Return a formula as an SVG image by Matplotlib, so that no page needs a script for it."""
    from matplotlib import mathtext  # heavy

    made = io.BytesIO()
    mathtext.math_to_image(f"${formula.strip()}$", made, format="svg", dpi=96)
    data = base64.b64encode(made.getvalue()).decode()
    alt = nodes.unescape(formula).replace('"', "&quot;").replace("<", "&lt;")
    return f'<img class="formula" alt="{alt}" src="data:image/svg+xml;base64,{data}">'


def _inline(visitor: Any, node: nodes.Node) -> None:
    visitor.body.append(_drawn(node.astext()))
    raise nodes.SkipNode


def _block(visitor: Any, node: nodes.Node) -> None:
    visitor.body.append(f'<div class="math">{_drawn(node.astext())}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Draw formulas."""
    app.add_html_math_renderer("drawn", (_inline, None), (_block, None))
