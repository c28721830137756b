"""Sphinx: MyST pages, the furo theme, equations as MathML.  Built pages make no request to any other host."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import generate  # noqa: E402

import pixelid  # noqa: E402
from pixelid.report.pixel_view import view_page  # noqa: E402

project = "pixelid"
version = release = pixelid.__version__
copyright = "pixelid developers"
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "_generated/*.md", "schemas", "static"]
html_theme = "furo"
html_title = f"pixelid {release}"
html_extra_path = ["schemas"]
html_static_path = ["static"]
html_css_files = ["equations.css", "home.css"]
html_js_files = ["copy.js"]
html_show_sphinx = False
html_math_renderer = "mathml"
pygments_style = "default"

# What would make a reader's browser ask another host for something.  Plain links are not among it.
REQUESTS = re.compile(r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=\"(?:https?:)?//[^\"]+\"")


def write_generated(app: Sphinx) -> None:
    """Write the pages made from code and from benchmark results."""
    generate.write_all(HERE / "_generated")


def write_pixel(app: Sphinx, exception: Exception | None) -> None:
    """Write the page with a pixel to play with, to which the home page links."""
    if exception is None and app.builder.format == "html":
        (Path(app.outdir) / "pixel.html").write_text(view_page(), encoding="utf-8")


def refuse_requests(app: Sphinx, exception: Exception | None) -> None:
    """Fail the build when a page asks another host for a script, a style sheet, a font or a picture."""
    if exception is None and app.builder.format == "html":
        for page in Path(app.outdir).rglob("*.html"):
            for tag in REQUESTS.findall(page.read_text()):
                raise ExtensionError(f"{page.name} makes a request to another host: {tag}")


def visit_inline(self, node: nodes.math) -> None:
    """An equation in running text."""
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_block(self, node: nodes.math_block) -> None:
    """An equation on a line of its own."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    self.body.append(convert(node.astext(), display="block") + "</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer of equations, the generated pages and the check of the built ones."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("builder-inited", write_generated)
    app.connect("build-finished", write_pixel)
    app.connect("build-finished", refuse_requests)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
