# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Makes `solver_cases` importable: pytest's importlib mode leaves sys.path alone."""

from pathlib import Path
import sys

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope='session')
def paper_fleet(shared):
    from solver_cases import PaperFleet

    return PaperFleet(shared / 'truth/fleet.json')
