# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of wrong readings."""

from dg_localization.fleet import SuspectKind
from dg_localization.ros.interface.parameters.spec import (
    BOOL,
    DOUBLE,
    INTEGER,
    STRING,
    Section,
    Spec,
)

CONTRADICTIONS = Section(
    'Contradictions',
    'An observation is what one sensor says of one target: the range and the ray of one detection '
    'are wrong together or not at all.',
    (
        Spec(
            'max_outliers',
            INTEGER,
            0,
            'most contradicting observations that may be dropped to get an answer',
            at_least=0,
            details='The answer is the union over all smallest ways to drop them. Where so many '
            'readings may be wrong without contradicting anything, `window_outliers` serves.',
        ),
        Spec(
            'outlier_unit',
            STRING,
            'observation',
            'what counts as one of `max_outliers`',
            choices=tuple(kind.value for kind in SuspectKind),
            details='A `sensor` is the camera or the range sensor of a robot, or one mounted '
            'sensor, with all that it says; a `robot` is all that it measures and that is '
            'measured of it.',
        ),
        Spec(
            'conflicts.max_solves',
            INTEGER,
            200,
            'most problems solved to explain one contradiction; 0 turns explanations off',
            at_least=0,
            details='For `window_outliers` the limit applies per pair.',
        ),
        Spec(
            'conflicts.max_seconds',
            DOUBLE,
            2.0,
            'longest time of a search for what explains a contradiction',
            's',
            0.0,
            finite=False,
            details='In rare cases the first result proves insufficient, and up to three searches '
            'run. `.inf` for no limit.',
        ),
        Spec(
            'stuck.readings',
            INTEGER,
            20,
            'a sensor is stuck after this many identical readings while robots move; 0 disables '
            'the check',
            at_least=0,
            details='Identical to the last bit, while odometry says that a robot moved by 0.5 m. '
            'Where there is no odometry, ten times as many.',
        ),
        Spec(
            'stuck.drop',
            BOOL,
            False,
            'drop readings that are stuck, besides the warning',
        ),
    ),
)
