# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of the tests of the solver."""

import pytest


@pytest.fixture(scope='session')
def paper_fleet(shared):
    from solver_cases import PaperFleet

    return PaperFleet(shared / 'truth/fleet.json')
