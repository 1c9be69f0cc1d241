# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The node, watched: ``python -m benchmarks.load.node RESULT [ROS arguments]``."""

from __future__ import annotations

from array import array
import json
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np

from benchmarks.load.sensors import STAMP, STAMP_OFFSET
from dg_localization.ros.interface.links import Link
from dg_localization.ros.node.localizer import LocalizerNode, TimedEstimate
from dg_localization.ros.node.worker import exit_code_despite_worker
from dg_localization.ros.spinning import spin


class WatchedNode(LocalizerNode):
    """The node, which writes down when each message and each answer came."""

    def __init__(self, result: Path, **kwargs: Any) -> None:
        self._result = result
        # Plain numbers: a soak counts the memory of this too.
        self._messages = array('d')
        self._answers: list[tuple[float, float, float, float, float]] = []
        self._resources: list[tuple[float, float, int, int, float]] = []
        super().__init__(**kwargs)
        self.create_timer(1.0, self._note_resources)

    def _on_message(self, link: Link, data: bytes, waited_s: float) -> None:
        begin_s = time.thread_time()
        sec, nanosec = STAMP.unpack_from(data, STAMP_OFFSET)
        super()._on_message(link, data, waited_s)
        end_s = time.thread_time()
        self._messages.extend((self._clock_s(), sec + 1e-9 * nanosec, end_s - begin_s, end_s))

    def _publish(self, answer: TimedEstimate) -> None:
        begin_s = time.thread_time()
        super()._publish(answer)
        estimate = answer.estimate
        solve_s = estimate.statistics.seconds if estimate.statistics else np.nan
        cost_s = time.thread_time() - begin_s
        self._answers.append(
            (self._clock_s(), estimate.stamp_s, float(estimate.n_hypotheses), solve_s, cost_s)
        )

    def _note_resources(self) -> None:
        pages = int(Path('/proc/self/statm').read_text().split()[1])
        descriptors = len(list(Path('/proc/self/fd').iterdir()))
        threads = len(list(Path('/proc/self/task').iterdir()))
        self._resources.append(
            (time.time(), pages * 4096 / 2**20, descriptors, threads, time.process_time())
        )

    def destroy_node(self) -> None:
        """Write down what was noted, and destroy the node."""
        super().destroy_node()
        np.savez(
            self._result,
            messages=np.array(self._messages).reshape(-1, 4),
            answers=np.array(self._answers).reshape(-1, 5),
            resources=np.array(self._resources).reshape(-1, 5),
            counts=json.dumps(self._counts()),
        )

    def _counts(self) -> dict[str, int]:
        states = self._intake.states(time.time()).values()
        return {
            'rejected': sum(sum(state.rejected.values()) for state in states),
            'malformed': sum(wrong.count for wrong in self._intake.malformed.values()),
        }


def main() -> int:
    """Run the node until SIGINT."""
    result = Path(sys.argv[1])
    spin(lambda: WatchedNode(result), sys.argv[2:], __doc__ or '')
    return exit_code_despite_worker(0)


if __name__ == '__main__':
    sys.exit(main())
