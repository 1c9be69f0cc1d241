# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `compile_kernels`: compile the solver now, so that no first start waits for it.

All other executables compile missing kernels themselves. Run this after an installation or an
update, or when an image is built. It needs no ROS.
"""

from __future__ import annotations

import argparse
import sys
import time

EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """
    Compile all kernels into the cache, with progress; load them if they are in it.

    Parameters
    ----------
    arguments : list of str, optional
        Command line; by default that of the process.

    Returns
    -------
    int
        Exit code: 0, or 1 if there is no numba or the compiled kernels cannot be kept.

    """
    parser = argparse.ArgumentParser(
        prog='compile_kernels',
        description='Compile the solver now, so that the first start does not take minutes.',
        epilog='Compiled kernels are kept in dg_localization/ below $NUMBA_CACHE_DIR, else below '
        '$XDG_CACHE_HOME, else below ~/.cache.',
    )
    parser.parse_args(arguments)
    try:
        return _compile()
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


def _compile() -> int:
    # Importing numba takes longer than parsing a command line.
    from dg_localization.interval.kernels import cache_folder, why_not_kept, why_slow

    if why_slow():
        print(f'Nothing is compiled: {why_slow()}', file=sys.stderr)
        return 1
    if why_not_kept():
        print(why_not_kept(), file=sys.stderr)
        return 1
    from dg_localization.fleet import warm_up

    began_s = time.monotonic()
    warm_up(_print_progress)
    if why_not_kept():
        print(why_not_kept(), file=sys.stderr)
        return 1
    took_s = time.monotonic() - began_s
    print(f'The kernels are ready after {took_s:.1f} s, in {cache_folder()}')
    return 0


def _print_progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == '__main__':
    sys.exit(main())
