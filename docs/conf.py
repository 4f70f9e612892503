"""The site of the manual, built by ./run docs: Sphinx reads the Markdown pages as GitHub does.

The pages hold no directives, so that they read well everywhere. The order of the pages, the
objects of the API reference and the plots of the notebooks are added here while Sphinx reads them.
"""

from __future__ import annotations

import re
import tempfile
import textwrap
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from matplotlib.sphinxext.plot_directive import PlotDirective

import dfm_stage
from dfm_stage.reporting.table import LONG_TEXT, MOST_ON_PHONE

project = "dfm_stage"
version = release = dfm_stage.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
nitpicky = False        # types of the standard library and of NumPy are not linked
default_role = "code"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_custom_sections = [("Parameters common to the methods", "params_style")]
highlight_language = "none"
autodoc_class_signature = "separated"
autodoc_default_options = {"members": True, "undoc-members": True, "member-order": "bysource",
                           "exclude-members": "__init__, __new__"}
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "FloatArray", "Ints")}
_work = tempfile.TemporaryDirectory()       # the notebooks write here; it goes with the process
plot_working_directory = _work.name
plot_pre_code = "pass"      # a notebook imports what it uses
plot_formats = [("png", 110)]
plot_html_show_formats = plot_html_show_source_link = False
html_theme = "furo"
html_static_path = html_css_files = ["site.css"]
html_title = f"dfm_stage {version}"
html_show_copyright = html_show_sphinx = html_copy_source = False
html_math_renderer = "mathml"

ORDER = {
    "Tutorial": ["start", "csv_to_effect", "graph_to_model"],
    "How to: analyse records": ["diagnose", "identify", "simulate", "matlab", "library"],
    "How to: run the stage": ["nodes", "live", "control", "hardware", "trust", "ros2"],
    "How to: repeat the paper": ["characterize", "paper"],
    "How to: add your own": ["add_effect", "formulas", "add_controller", "add_device"],
    "Explanation": ["stage", "diagnosis_explained", "identification_explained", "middleware",
                    "flexure", "architecture"],
    "Reference": ["glossary", "model", "effects", "records", "trajectories", "diagnosis_reference",
                  "decisions", "reference", "api"],
    "Benchmarks": ["benchmarks", "benchmarks_diagnosis", "benchmarks_faults", "measured_stages"],
}
SHORT_CODE = 14
"""Characters up to which a word of code is kept whole: no line ends within `--split`."""
PARAGRAPH = 120
"""Characters of a cell from which a table of three columns is too wide for a phone."""
UNIT = re.compile(r"(?<=\d) (?=(?:%|[nµmk]?(?:m|s|Hz|N|V))(?!\w))")


def add_order(_app: Any, name: str, source: list[str]) -> None:
    """Give the first page the order of all pages, the API page its objects, notebooks figures."""
    if name == root_doc:
        source[0] += "".join(
            f"\n```{{toctree}}\n:hidden:\n:caption: '{title}'\n\n" + "\n".join(pages) + "\n```\n"
            for title, pages in ORDER.items())
    if name == "api":
        source[0] += "".join(
            f"\n```{{eval-rst}}\n.. auto{_kind(each)}:: dfm_stage.{each}\n```\n"
            for each in sorted(dfm_stage.__all__, key=str.lower))
    if source[0].startswith("---\njupyter:"):
        source[0] = with_plots(source[0])
    # in a narrow column a number stays with its unit
    source[0] = re.sub(r"^\|.*$", lambda row: UNIT.sub("\u00a0", row[0]), source[0],
                       flags=re.MULTILINE)


def name_cells(_app: Any, doctree: Any) -> None:
    """Put its column's head into each cell of a wide table, for phones: they show a row as a card.

    The style sheet hides these heads on a desk.
    """
    from docutils.nodes import entry, inline, row, table, tbody, thead

    for each in doctree.findall(table):
        head = next(iter(each.findall(thead)), None)
        names = [cell.astext() for cell in head.findall(entry)] if head is not None else []
        longest = max((len(cell.astext()) for cell in each.findall(entry)), default=0)
        limit = LONG_TEXT if len(names) > MOST_ON_PHONE else PARAGRAPH
        if len(names) < MOST_ON_PHONE or longest <= limit:
            continue
        each["classes"].append("cards")
        for line in next(iter(each.findall(tbody))).findall(row):
            for name, cell in zip(names, line.children, strict=True):
                cell.insert(0, inline("", name, classes=["named"]))


def keep_short_code(_app: Any, doctree: Any) -> None:
    """Mark code whose words are short: the style sheet keeps each of them on one line."""
    from docutils.nodes import literal

    for each in doctree.findall(literal):
        if max(map(len, each.astext().split()), default=0) <= SHORT_CODE:
            each["classes"].append("short")


def with_plots(notebook: str) -> str:
    """Have the cells of a notebook run, one after the other, and show the figure of each below it.

    Where ROS is not installed, a notebook that starts nodes keeps its code and has no figures.
    """
    if "dfm_stage.harness" in notebook and find_spec("rclpy") is None:
        return notebook

    def cell(found: re.Match[str]) -> str:
        plot = ".. plot::\n   :context: close-figs\n   :include-source:\n\n"
        return f"```{{eval-rst}}\n{plot}{textwrap.indent(found[1], '   ')}```\n"

    return re.sub(r"^```python\n(.*?)^```\n", cell, notebook, flags=re.DOTALL | re.MULTILINE)


class NumberedPlot(PlotDirective):
    """A plot whose file has a number of its own.

    matplotlib counts the plots of a document, and to MyST each block of reStructuredText is one.
    """

    def run(self) -> list[Any]:
        """Go on counting over the whole page."""
        document = self.state_machine.document
        document.attributes["_plot_counter"] = document.settings.env.new_serialno("plot")
        return super().run()


def _kind(name: str) -> str:
    found = getattr(dfm_stage, name)
    if not isinstance(found, type):
        return "function"
    return "exception" if issubclass(found, Exception) else "class"


def name_aliases(_app: Any, _what: str, _name: str, _found: Any, _options: Any,
                 signature: str | None, returns: str | None) -> tuple[str | None, str | None]:
    """Write an alias within a union by its name, as autodoc does elsewhere."""
    def named(text: str | None) -> str | None:
        return text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)

    return named(signature), named(returns)


def show_equation(writer: Any, node: Any) -> None:
    """Write an equation as MathML, which browsers show without a script."""
    from docutils.nodes import SkipNode

    block = node.tagname == "math_block"
    shown = convert(node.astext().strip(), display="block" if block else "inline")
    writer.body.append(f'<div class="equation">{shown}</div>' if block else shown)
    raise SkipNode


def setup(app: Any) -> None:
    """Sphinx calls this once."""
    app.connect("source-read", add_order)
    app.connect("doctree-read", name_cells)
    app.connect("doctree-read", keep_short_code)
    app.connect("autodoc-process-signature", name_aliases)
    app.setup_extension("matplotlib.sphinxext.plot_directive")
    app.add_directive("plot", NumberedPlot, override=True)
    app.add_html_math_renderer("mathml", (show_equation, None), (show_equation, None))


assert {page for pages in ORDER.values() for page in pages} == {
    page.stem for page in Path(__file__).parent.glob("*.md") if page.stem != root_doc}, (
    "give every page its place in ORDER")
