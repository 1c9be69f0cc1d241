# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The log says once what the state of the fleet is, when that lasts."""

from unittest.mock import Mock, call

from dg_localization.ros.node.lifecycle import LOOKS_BETWEEN, FleetLog
from msg_adapters import Level, Status


def look(fleet_log, *seen):
    for level, message in seen:
        fleet_log.look(Status(level, 'localizer: fleet', message, 'fleet', {}))


def test_what_lasts_is_said_once_with_its_severity():
    logger = Mock()
    fleet_log = FleetLog(logger)
    stale = [(Level.WARN, f'all measurements are stale: the youngest is {s} s old') for s in '234']
    wrong = (Level.ERROR, 'contradiction: a - b')
    good = (Level.OK, 'localized: one hypothesis')
    for seen in (stale, [good], [wrong], [good]):
        look(fleet_log, *seen, *[seen[-1]] * LOOKS_BETWEEN)
    assert logger.method_calls == [
        call.warning('fleet: all measurements are stale: the youngest is 3 s old'),
        call.info('fleet: localized: one hypothesis'),
        call.error('fleet: contradiction: a - b'),
        call.info('fleet: localized: one hypothesis'),
    ]


def test_what_comes_and_goes_slowly_is_said_at_times():
    logger = Mock()
    good, wide = (Level.OK, 'localized'), (Level.WARN, 'one hypothesis, 6.2 m wide')
    look(FleetLog(logger), *[good, good, wide, wide] * 10 * LOOKS_BETWEEN)
    assert 10 <= len(logger.method_calls) <= 40
