"""How Sphinx makes a site of the pages of this repository: `make docs`.

The repository itself is the source folder, so that the pages are those that are read
on GitHub, with the same relative links. What only a site has is beside this file:
its front page, the reference, and how docstrings and links to source files are read.
"""

import os
import sys
from pathlib import Path
from unittest.mock import patch

SITE = Path(__file__).resolve().parent
ROOT = SITE.parents[1]
sys.path[:0] = [str(SITE), str(ROOT)]
# A compiled function has neither its signature nor its docstring where Sphinx looks.
# The notebooks, in processes of their own, run as fast as they can.
with patch.dict(os.environ, NUMBA_DISABLE_JIT="1"):
    import crar_drake.equations.compilation

project = "crar_drake"
author = "the authors of crar_drake"
copyright = author
version = release = crar_drake.__version__

extensions = [
    "myst_nb",  # Markdown and notebooks
    "sphinx.ext.autodoc",
    "docstrings",
    "room_reference",
    "source_pages",
]
root_doc = "docs/site/index"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "docs/*.md",
    "docs/*/*.md",
    "docs/site/*.rst",
    "docs/site/rooms/*.rst",
    "diagrams/README.md",
    "models/README.md",
    "models/*/README.md",
    "examples/*.ipynb",
]
exclude_patterns = ["out", "build", "dist", ".venv*", ".git", "**/.ipynb_checkpoints"]

# Headings have the anchors that GitHub gives them.
myst_heading_anchors = 4
# Code that does not say its language is for a shell, or a formula.
highlight_language = "none"
# What nobody here documents: Drake, NumPy, the standard library, and type variables.
nitpick_ignore_regex = [
    ("py:.*", r"(?!crar_drake\.).*"),
    ("py:class", r".*\.T"),
    ("py:class", r"crar_drake\.run\..*"),  # a module of no room
]
# In backticks stands code, which is a link where it is a name of the reference.
default_role = "py:obj"

autodoc_default_options = {"show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_maximum_signature_line_length = 88
add_module_names = False
toc_object_entries_show_parents = "hide"

# Notebooks are kept without outputs, and executed when they have changed, or after
# `make clean`. `-D nb_execution_mode=off` leaves them as they are.
nb_execution_mode = "cache"
nb_execution_in_temp = True  # where the files that they write go, too
nb_execution_cache_path = str(ROOT / "out" / "notebooks")
nb_execution_timeout = 3600  # a slow computer compiles the controller in it
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_output_stderr = "remove"  # where Drake says at which port Meshcat listens

html_theme = "furo"
html_title = "crar_drake"
html_static_path = ["static"]
html_css_files = ["site.css"]
templates_path = ["templates"]
# The address that is opened; the front page is deeper, as is its source.
html_additional_pages = {"index": "to_front_page.html"}
html_copy_source = False
# A page that is opened from disk may not read other files, only run their scripts.
html_show_search_summary = False
html_show_copyright = False
