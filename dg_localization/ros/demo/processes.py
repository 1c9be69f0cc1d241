# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executables of the demonstration, each in a process of its own."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
import subprocess
import sys
import tempfile

from dg_localization.ros.demo.compare import DemoError

END_S = 10.0


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
        Its name.
    arguments : str
        Its command line.

    """

    def __init__(self, name: str, *arguments: str) -> None:
        self.name = name
        # The log is read after the process: a pipe that nobody empties would stop it.
        self._log = tempfile.TemporaryFile('w+')
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'dg_localization.ros', name, *arguments],
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

    def wait(self, timeout_s: float) -> int:
        """Wait until the process has ended of its own accord; return its exit code."""
        return self._process.wait(timeout_s)

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
