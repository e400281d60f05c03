"""Sphinx reads this for `make docs`, and so does rosdoc2: the pages are those of the repository."""

project = "magcal_ros"
author = "magcal_ros contributors"

extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# Pages link to files of the repository, which are no pages of the site.
suppress_warnings = ["myst.xref_missing"]
exclude_patterns = ["_build"]
html_theme = "alabaster"
html_theme_options = {"page_width": "1100px"}
