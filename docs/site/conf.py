"""How Sphinx makes a site of the pages of this repository: `make docs`.

The repository itself is the source folder, so that the pages are those that are read
on GitHub, with the same relative links.
"""

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import crar_drake  # noqa: E402

project = "crar_drake"
author = copyright = "the authors of crar_drake"
version = release = crar_drake.__version__

extensions = [
    "myst_parser",  # Markdown
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",  # headed lists in docstrings
    "sphinx.ext.viewcode",
]
root_doc = "docs/site/index"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "docs/*.md",
    "docs/*/*.md",
    "docs/site/*.rst",
    "diagrams/README.md",
    "models/README.md",
    "models/*/README.md",
]

myst_heading_anchors = 4  # as GitHub gives them
# Links to folders work on GitHub alone; tests/test_pages.py looks at all links.
suppress_warnings = ["myst.xref_missing"]
# Code that does not say its language is for a shell, or a formula.
highlight_language = "none"
default_role = "code"  # in backticks stands code

autodoc_member_order = "bysource"
napoleon_use_ivar = True
napoleon_custom_sections = [
    (name, "params_style")
    for name in ("Input ports", "Output ports", "Parts of diagnostics")
]
python_maximum_signature_line_length = 88
add_module_names = False

html_theme = "furo"
html_title = "crar_drake"
html_copy_source = False
html_show_copyright = False


def show_formulas(app: Sphinx, what, name, thing, options, lines: list[str]) -> None:
    """Marks indented blocks of a docstring as code: formulas, drawings, programs."""
    text = re.sub(r"(?m)^(?! )(.*\S)\n\n(?=    )", r"\1\n\n::\n\n", "\n".join(lines))
    lines[:] = text.split("\n")


def setup(app: Sphinx) -> None:
    """Called by Sphinx; napoleon reads docstrings after this."""
    app.connect("autodoc-process-docstring", show_formulas, priority=400)
