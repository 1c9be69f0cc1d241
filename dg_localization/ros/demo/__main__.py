"""
The demonstration: `simulate_fleet` and `localizer` as two processes, looked at as a user would.

First the robots measure ranges only, then they also see each other. For both, every feasible
placement that arrives on the topics of the localizer is held against the simulated truth; the last
ones are printed and drawn. The exit code is 1 when the truth was in no hypothesis of some answer.
"""

import argparse
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from dg_localization.ros.demo.compare import (
    Answer,
    Compared,
    DemoError,
    Scenario,
    Truth,
    count_text,
    summary,
    truth_at,
    yaws_of,
)
from dg_localization.ros.demo.domain import claim_domain
from dg_localization.ros.demo.picture import draw
from dg_localization.ros.optional import install_hint
from dg_localization.simulation.moving_fleet import ROBOTS
from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.markers import marker_scene_from_message
from msg_adapters.poses import pose_array_from_message

LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# Without compiled kernels in its cache the localizer compiles them before its first answer.
FIRST_ANSWER_S = 600.0
END_S = 10.0
# As a shell reports a program that SIGINT ended.
INTERRUPTED = 130
POINTS_PER_BOX = 8


class Spectator(Node):
    """Listens to the localizer, and to the simulation for the truth, and compares the two."""

    def __init__(self) -> None:
        super().__init__('demo')
        self.compared: list[Compared] = []
        self.status = 'waiting for the localizer'
        self._frame = ''
        self._truths: deque[Truth] = deque(maxlen=200)
        self._poses: dict[float, Any] = {}
        self._boxes: dict[float, NDArray[np.float64]] = {}
        self._waiting: deque[Answer] = deque(maxlen=50)
        for message_class, topic, callback, qos in (
            (PoseArray, '/simulate_fleet/ground_truth', self._on_truth, LATCHED),
            (PoseArray, '/localizer/feasible_poses', self._on_poses, LATCHED),
            (MarkerArray, '/localizer/markers', self._on_markers, LATCHED),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics, 10),
        ):
            self.create_subscription(message_class, topic, callback, qos)

    def _on_truth(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        yaws_rad = yaws_of(poses.orientations_xyzw)
        self._truths.append(Truth(poses.stamp_s, poses.positions_m[:, :2], yaws_rad))
        self._compare()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in diagnostics_from_message(message).statuses:
            if status.name == 'localizer: fleet':
                self.status = status.message
                self._frame = status.values.get('frame', '')

    def _on_poses(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        self._poses = {poses.stamp_s: poses}
        self._join(poses.stamp_s)

    def _on_markers(self, message: MarkerArray) -> None:
        scene = marker_scene_from_message(message)
        corners = [m.points_m for m in scene.markers if m.namespace == 'enclosures']
        self._boxes = {scene.stamp_s: np.concatenate([np.zeros((0, 3)), *corners])}
        self._join(scene.stamp_s)

    def _join(self, stamp_s: float) -> None:
        """Make an answer of the poses and markers of one time, once both are there."""
        if stamp_s not in self._poses or stamp_s not in self._boxes:
            return
        poses, corners = self._poses.pop(stamp_s), self._boxes.pop(stamp_s)
        n_poses = len(poses.positions_m)
        # While inputs are missing some robots are not bounded and have no enclosure to draw.
        if n_poses == 0 or len(corners) != POINTS_PER_BOX * n_poses:
            return
        by_box = corners[:, :2].reshape(-1, len(ROBOTS), POINTS_PER_BOX, 2)
        self._waiting.append(
            Answer(
                stamp_s,
                poses.positions_m[:, :2].reshape(-1, len(ROBOTS), 2),
                yaws_of(poses.orientations_xyzw).reshape(-1, len(ROBOTS)),
                np.stack([by_box.min(axis=2), by_box.max(axis=2)], axis=2),
            )
        )
        self._compare()

    def _compare(self) -> None:
        """Compare every answer whose truth has arrived."""
        while self._frame and self._waiting and self._truths:
            if self._truths[-1].stamp_s < self._waiting[0].stamp_s:
                return
            answer = self._waiting.popleft()
            truth = truth_at(self._truths, answer.stamp_s)
            if truth is not None:
                self.compared.append(Compared(answer, truth.in_frame(self._frame), self._frame))


def find_config() -> Path:
    """
    Return the parameters of the paper's fleet, from the repository or where they are installed.

    Raises
    ------
    DemoError
        If they are in neither place.

    """
    places = (
        Path(__file__).parents[3] / 'config',
        Path(sys.prefix) / 'share/dg_localization/config',
    )
    for place in places:
        if (place / 'paper_fleet.yaml').exists():
            return place / 'paper_fleet.yaml'
    raise DemoError(f'paper_fleet.yaml is neither in {places[0]} nor in {places[1]}')


class Executable:
    """
    An executable of this package in a process of its own.

    Parameters
    ----------
    name : str
        Its module.
    arguments : str
        Its command line.

    """

    def __init__(self, name: str, *arguments: str) -> None:
        self.name = name
        # The log is read after the process: a pipe that nobody empties would stop it.
        self._log = tempfile.TemporaryFile('w+')
        self._process = subprocess.Popen(
            [sys.executable, '-m', f'dg_localization.ros.{name}', *arguments],
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    def check(self) -> None:
        """
        Make sure that the process is running.

        Raises
        ------
        DemoError
            If it has ended, with what it wrote.

        """
        if self._process.poll() is not None:
            raise DemoError(
                f'{self.name} ended with exit code {self._process.returncode}:\n{self._written()}'
            )

    def _written(self) -> str:
        self._log.seek(0)
        return self._log.read()

    def end(self) -> None:
        """End the process as `ros2 run` and systemd do, and make sure that it ends well."""
        self._process.terminate()
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        written = self._written()
        self._log.close()
        if code != 0 and sys.exc_info()[0] is None:
            raise DemoError(f'{self.name} ended with exit code {code}:\n{written}')


@contextmanager
def running(*executables: Executable) -> Iterator[None]:
    """Keep executables running for a while, and end them in the opposite order."""
    with ExitStack() as stack:
        for executable in executables:
            stack.callback(executable.end)
        yield


class ProgressLine:
    """One line that is written again and again; where it cannot be, every few seconds."""

    PERIOD_S = 5.0

    def __init__(self) -> None:
        self._start_s = time.monotonic()
        self._live = sys.stdout.isatty()
        self._told_s = 0.0
        self._width = 0

    def tell(self, share: float, text: str, *, last: bool = False) -> None:
        """Show how much is done, from 0 to 1, and a text."""
        now_s = time.monotonic()
        if not (self._live or last or now_s - self._told_s >= self.PERIOD_S):
            return
        self._told_s = now_s
        filled = round(20 * min(1.0, share))
        bar = '#' * filled + '.' * (20 - filled)
        line = f'  [{bar}] {now_s - self._start_s:5.1f} s  {text}'
        padded = line.ljust(self._width)
        self._width = len(line)
        if self._live:
            print(f'\r{padded}', end='\n' if last else '', flush=True)
        else:
            print(line, flush=True)


def run(scenario: Scenario, seconds: float) -> None:
    """
    Run a scenario and fill in what came out of it.

    Parameters
    ----------
    scenario : Scenario
        What to run.
    seconds : float
        How long, from the first answer.

    Raises
    ------
    DemoError
        If a process ends or no answer comes.

    """
    print(f'{scenario.title}:')
    spectator = Spectator()
    executables = (
        Executable(
            'simulate_fleet', '--ros-args', '-p', f'cameras:={str(scenario.cameras).lower()}'
        ),
        Executable('localizer', '--ros-args', '--params-file', str(find_config())),
    )
    scenario.compared = spectator.compared
    line = ProgressLine()
    try:
        with running(*executables):
            first_s = _spin_until(
                spectator, executables, lambda: bool(spectator.compared), FIRST_ANSWER_S, line
            )
            if not spectator.compared:
                raise DemoError(f'no answer within {first_s:.0f} s: {spectator.status}')
            spectator.compared.clear()
            _spin_until(spectator, executables, lambda: False, seconds, line)
            line.tell(1.0, _state(spectator), last=True)
    finally:
        spectator.destroy_node()


def _spin_until(
    spectator: Spectator,
    executables: Sequence[Executable],
    done: Callable[[], bool],
    limit_s: float,
    line: ProgressLine,
) -> float:
    """Spin, with a live line, until it is done or time is up; return the time it took."""
    start_s = time.monotonic()
    while (passed_s := time.monotonic() - start_s) < limit_s and not done():
        rclpy.spin_once(spectator, timeout_sec=0.1)
        for executable in executables:
            executable.check()
        line.tell(passed_s / limit_s if spectator.compared else 0.0, _state(spectator))
    return passed_s


def _state(spectator: Spectator) -> str:
    """Return the newest answer in a few words."""
    if not spectator.compared:
        return 'waiting for the first answer (the very first run compiles the solver: a minute)'
    held = sum(len(compared.held_by) > 0 for compared in spectator.compared)
    return (
        f'{count_text(spectator.compared[-1].answer)}; '
        f'truth held in {held} of {len(spectator.compared)} answers'
    )


def main(args: list[str] | None = None) -> int:
    """
    Run both scenarios.

    Parameters
    ----------
    args : list of str, optional
        Command line; that of the process by default.

    Returns
    -------
    int
        Exit code: 0, 1 when something failed or an answer did not hold the truth, or 130 when
        it was interrupted.

    """
    parser = argparse.ArgumentParser(prog='demo', description='Localize a simulated fleet.')
    parser.add_argument('--seconds', type=float, default=8.0, help='length of each of two runs')
    parser.add_argument('--picture', type=Path, default=Path('demo.png'), help='file to write')
    options = parser.parse_args(args)
    claim = claim_domain()
    os.environ['ROS_DOMAIN_ID'] = str(claim.domain_id)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'Six robots measure nine ranges to +-3 % (ROS_DOMAIN_ID={claim.domain_id}).')
    rclpy.init(args=[])
    try:
        return demonstrate(options.seconds, options.picture)
    except DemoError as error:
        print(f'\n{error}', file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        print('\ninterrupted', file=sys.stderr)
        return INTERRUPTED
    finally:
        rclpy.try_shutdown()
        claim.release()


def demonstrate(seconds: float, picture: Path) -> int:
    """
    Run both scenarios, print what came out, and draw it.

    Parameters
    ----------
    seconds : float
        Length of each.
    picture : Path
        The picture to write.

    Returns
    -------
    int
        0, or 1 when an answer did not hold the truth.

    Raises
    ------
    DemoError
        If a process ends or no answer comes.

    """
    scenarios = [Scenario('Without cameras', False), Scenario('With cameras', True)]
    for scenario in scenarios:
        run(scenario, seconds)
        print(summary(scenario), flush=True)
    if find_spec('matplotlib') is None:
        print(f'No picture without matplotlib: {install_hint("matplotlib")}')
    else:
        draw(scenarios, picture)
        print(f'All feasible placements next to the truth: {picture}')
    return int(any(scenario.n_held < len(scenario.compared) for scenario in scenarios))


if __name__ == '__main__':
    raise SystemExit(main())
