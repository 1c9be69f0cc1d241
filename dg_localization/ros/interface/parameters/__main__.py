# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Write the commented file of parameters and their documentation into a repository.

    python -m dg_localization.ros.interface.parameters [REPOSITORY]
"""

from pathlib import Path
import sys

from dg_localization.ros.interface.parameters.document import as_markdown, as_yaml


def main() -> None:
    """Write both files."""
    repository = Path(sys.argv[1] if len(sys.argv) > 1 else '.')
    (repository / 'config/localizer.yaml').write_text(as_yaml(), encoding='utf-8')
    (repository / 'docs/parameters.md').write_text(as_markdown(), encoding='utf-8')


if __name__ == '__main__':
    main()
