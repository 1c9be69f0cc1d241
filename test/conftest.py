# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What all tests share: recordings beside the repository, and a ROS 2 graph of their own."""

import os
from pathlib import Path
import runpy
import tempfile

from hypothesis import settings
import pytest

REPOSITORY = Path(__file__).parents[1]
REQUIRE_SHARED_DATA = 'DG_REQUIRE_SHARED_DATA'

# A law is tried on the same examples each time, unless its test says otherwise.
settings.register_profile('laws', derandomize=True, deadline=None, max_examples=300)
settings.load_profile('laws')


class SharedData:
    """
    The folder of recordings and exact truths beside the repository.

    `shared / 'truth/fleet.json'` is the path of that file. Where it is absent the test is
    skipped, or fails when the environment sets DG_REQUIRE_SHARED_DATA=1.
    """

    def __init__(self, root):
        self.root = root

    def __truediv__(self, relative):
        path = self.root / relative
        if path.exists():
            return path
        reason = f'{path} is absent: this test needs the recordings beside the repository'
        if os.environ.get(REQUIRE_SHARED_DATA) == '1':
            pytest.fail(f'{reason}, and {REQUIRE_SHARED_DATA}=1', pytrace=False)
        pytest.skip(reason)


@pytest.fixture
def third_party_messages(monkeypatch):
    """Make stand-ins of the message packages of others importable."""
    from message_stand_ins import install

    install(monkeypatch)


@pytest.fixture(scope='session')
def shared():
    return SharedData(REPOSITORY.parent / 'shared')


def pytest_configure(config):
    """Give each test process a ROS 2 domain that no other on this machine uses."""
    # rclpy checks the type of every message field only where this is set at its import.
    os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
    os.environ.setdefault('ROS_LOG_DIR', tempfile.mkdtemp(prefix='dg_localization_log_'))
    # By its file: a package that does not import must be a failed test, not no tests at all.
    # Kept for the life of the process: the claim ends with it.
    config.ros_domain = runpy.run_path(str(REPOSITORY / 'dg_localization/ros/domain.py'))
    config.ros_domain['claim_domain']()
