"""Configuration of the documentation: `python -m sphinx -W -b html docs docs/_build`."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
sys.path.insert(0, str(HERE))
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(HERE.parent), str(HERE)]
)  # for the processes that make figures
os.environ.setdefault("CLACAD_THREADS", "2")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads of BLAS cost more than they give

import clacad  # noqa: E402

project = "clacad"
author = "the clacad authors"
copyright = "the clacad authors, MIT licence"
version = release = clacad.__version__

extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "sphinx_design", "sphinx_copybutton", "pages"
]  # fmt: skip
exclude_patterns = ["_build", "_made", "_templates", "Thumbs.db", ".DS_Store"]
templates_path = ["_templates"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True
smartquotes = False  # keys, options and quoted values are written as the program takes them
autosummary_generate = True
default_role = "literal"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = False
html_theme = "furo"
html_title = f"clacad {release}"
html_static_path = ["_static"]
html_css_files = ["clacad.css"]
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
suppress_warnings = ["config.cache"]
