# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Entry point of the executables if their scripts are not installed.

    python -m dg_localization.ros NAME [ARGUMENT ...]
"""

import sys

from dg_localization.ros.executables import EXECUTABLES, EXIT_WRONG_USAGE, print_line


def main() -> int:
    """Run the executable that the command line names; return the exit code."""
    name = sys.argv[1] if len(sys.argv) > 1 else ''
    if name not in EXECUTABLES:
        print_line(f"'{name}' is no executable; there are {', '.join(EXECUTABLES)}")
        return EXIT_WRONG_USAGE
    return EXECUTABLES[name](sys.argv[2:])


if __name__ == '__main__':
    sys.exit(main())
