# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What tests of the solver share."""

import pytest


@pytest.fixture(scope='session')
def paper_fleet(shared):
    from solver_cases import PaperFleet

    return PaperFleet(shared / 'truth/fleet.json')
