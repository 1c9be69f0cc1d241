# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Settings of Sphinx, for `make docs` and rosdoc2."""

import re
from typing import Any

project = 'dg_localization'
author = 'dg_localization contributors'
extensions = ['myst_parser']
exclude_patterns = ['_build']
myst_heading_anchors = 3
html_theme = 'alabaster'


def name_files_outside(app: Any, page: str, source: list[str]) -> None:
    """Replace links that lead out of this folder by the path: the built pages are without it."""
    link = r'\[([^\]]+)\]\(\.\./([^)#\s]+)[^)]*\)'
    source[0] = re.sub(
        link, lambda m: f'`{m[2]}`' if m[1] in m[2] else f'{m[1]} (`{m[2]}`)', source[0]
    )


def setup(app: Any) -> None:
    """Connect the change of links."""
    app.connect('source-read', name_files_outside)
