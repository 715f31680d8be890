"""The documentation site: Sphinx over the same Markdown files that are read in the repository.

`make site` builds it into site/; warnings are errors. The API reference is made from the front door's docstrings;
notebooks run while the site is built.
"""

import os
import re
import shutil
from pathlib import Path

import beamfield

HERE = Path(__file__).parent
API = HERE / "api"

project = "beamfield"
author = "The beamfield developers"
copyright = "the beamfield developers, Apache-2.0"  # noqa: A001  # Sphinx's name
version = release = beamfield.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["make_*.py"]
templates_path = ["templates"]
suppress_warnings = ["myst.header"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# A notebook without a result, or with an assertion that fails, is no page.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 300
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autosummary_generate = True
# Most blocks without a language are commands and what they print.
highlight_language = "none"
# Names in backticks that the reference has become links; others stay as they are.
default_role = "py:obj"

html_theme = "pydata_sphinx_theme"
html_title = "beamfield"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_context = {"default_mode": "auto"}
# No pages stand below it.
html_sidebars = {"choose": []}
html_theme_options = {
    "navbar_align": "left",
    "navbar_persistent": ["search-button"],
    "navbar_end": ["versions", "theme-switcher"],
    "header_links_before_dropdown": 8,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}

# Real data beside the checkout for the notebook that asks for them.
WEAN_HALL = HERE.parent.parent / "shared/data/wean_hall"
if WEAN_HALL.is_dir():
    os.environ.setdefault("WEAN_HALL", str(WEAN_HALL))

GROUP = re.compile(r"\n    # (.+)\n")
NAMES = re.compile(r'"([A-Za-z_]\w*)"')


def write_reference(*_: object) -> None:
    """Write a page with the names of each group of the front door, in the groups of its source."""
    shutil.rmtree(API, ignore_errors=True)
    API.mkdir()
    source = Path(beamfield.__file__).read_text().split("_NAMES = {")[1].split("\n}")[0]
    parts = GROUP.split(source)[1:]
    text = "# API reference\n\nWhat `import beamfield as bf` offers; sub-packages hold the rest.\n"
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        # Homes come before the colon, names after it.
        names = [name for line in body.split("\n") for name in NAMES.findall(line.partition(":")[2])]
        listed = "\n".join(f"   beamfield.{name}" for name in names)
        text += f"\n## {title}\n\n```{{eval-rst}}\n.. autosummary::\n   :toctree:\n\n{listed}\n```\n"
    (API / "index.md").write_text(text)


def setup(app: object) -> None:
    """Let Sphinx make the reference before it looks for pages."""
    app.connect("config-inited", write_reference)  # type: ignore[attr-defined]
