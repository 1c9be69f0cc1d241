# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localizer`: the node in a process of its own."""

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
import gc

from dg_localization.fleet import warm_up
from dg_localization.ros.node.localizer import LocalizerNode
from dg_localization.ros.node.worker import exit_code_despite_worker
from dg_localization.ros.spinning import spin

USAGE = 'usage: localizer --ros-args --params-file FILE [-p NAME:=VALUE] [-r FROM:=TO]'


def main(args: Sequence[str]) -> int:
    """Run the node until a signal; return the exit code."""
    # A second signal does not wait for a clean end, and must not wait for the worker either.
    with suppress(KeyboardInterrupt):
        spin(partial(LocalizerNode, load=load_for_good), args, USAGE)
    return exit_code_despite_worker(0)


def load_for_good() -> None:
    """
    Load the kernels, and leave all there is then out of collections of garbage.

    A collection looks at everything that numba has made, every few seconds for about 0.1 s in
    which no answer goes on. Nothing of it ends before the process.
    """
    warm_up()
    gc.collect()
    gc.freeze()
