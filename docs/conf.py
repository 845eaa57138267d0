"""How the documentation is built: `make docs`. Warnings are errors, and nothing is fetched from the network."""

import os
import shutil
import sys
from pathlib import Path

from sphinx_gallery.sorting import ExplicitOrder

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_extensions"), str(DOCS / "examples")]  # the package as it stands here

import harness  # noqa: E402 - found on the path above

# Commands on the pages run with this interpreter's own `omnirange`, on a terminal of a width that pages can show.
os.environ["PATH"] = str(Path(sys.executable).parent) + os.pathsep + os.environ["PATH"]
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:3])
os.environ |= {"COLUMNS": "100", "NO_COLOR": "1", "MPLBACKEND": "agg"}

project = "omnirange"
author = "the omnirange developers"
version = release = harness.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.programoutput",
    "docstrings",
    "offline_math",
    "settings_page",
]
exclude_patterns = [
    "_build",
    "_extensions",
    "examples",
    "generated/settings.md",
    "generated/work",
    "how-to/files",
    "tutorials",
]
default_role = "code"

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes and units are in the text; `ArrayLike` written out says less
autodoc_default_options = {"exclude-members": "model_config, model_post_init"}
napoleon_google_docstring = False

math_eqref_format = "({number})"
html_math_renderer = "svg"

sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "generated/tutorials",
    "filename_pattern": r"\.py$",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "within_subsection_order": ExplicitOrder(["researcher.py", "engineer.py", "author.py"]),
    "image_srcset": ["2x"],
}
programoutput_prompt_template = "$ {command}\n{output}"

html_theme = "pydata_sphinx_theme"
html_title = "omnirange"
html_context = {"default_mode": "auto"}
html_sidebars = {"quick-start": [], "concepts": []}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copyright = "the omnirange developers; MIT licence"  # noqa: A001 - Sphinx's name
html_last_updated_fmt = None


def prepare(app: object) -> None:  # noqa: ARG001 - Sphinx gives the application
    """Make a fresh folder with the pages' files, where their commands run."""
    work = DOCS / "generated" / "work"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(DOCS / "how-to" / "files", work)


def setup(app: object) -> None:
    """Prepare before pages are read."""
    app.connect("builder-inited", prepare, priority=1)
