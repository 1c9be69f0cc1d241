# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The node whose solver is slow while a file exists: ``python -m benchmarks.chaos.node FILE``."""

from __future__ import annotations

from pathlib import Path
import sys
import time

from dg_localization.fleet import Estimate, Localizer, Snapshot
from dg_localization.ros.node.localizer import LocalizerNode
from dg_localization.ros.node.worker import exit_code_despite_worker
from dg_localization.ros.spinning import spin
from dg_localization.solver.options import Cancel

SLOW = Path(sys.argv[1])
LOOK_S = 0.02


class SlowLocalizer(Localizer):
    """A localizer that keeps its answer back while the file exists."""

    def estimate(self, snapshot: Snapshot, cancel: Cancel | None = None) -> Estimate:
        """Return the estimate, late."""
        estimate = super().estimate(snapshot, cancel)
        while SLOW.exists() and not (cancel is not None and cancel.is_set()):
            time.sleep(LOOK_S)
        return estimate


if __name__ == '__main__':
    spin(lambda: LocalizerNode(make_localizer=SlowLocalizer), sys.argv[2:], __doc__ or '')
    sys.exit(exit_code_despite_worker(0))
