# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Install hints for missing optional Python packages."""

from importlib.metadata import version
import sys


def install_hint(package: str) -> str:
    """
    Return the command that installs an optional Python package here.

    The pip of Debian and Ubuntu refuses to install beside the packages of the system (PEP 668), so
    outside of a virtual environment the command makes one that sees the sourced ROS. If the ROS of
    the system was compiled against numpy 1, a newer numpy must not hide it.

    Parameters
    ----------
    package : str
        Name of the package on PyPI.

    Returns
    -------
    str
        One line for a message.

    """
    install = f'pip install {package}'
    if sys.prefix != sys.base_prefix:
        return install
    if version('numpy').startswith('1.'):
        install += " 'numpy<2'"
    return f'python3 -m venv --system-site-packages .venv && . .venv/bin/activate && {install}'
