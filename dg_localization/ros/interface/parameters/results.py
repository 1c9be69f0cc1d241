# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the table of parameters: answers, wrong readings, and what both may cost."""

from dg_localization.fleet import SuspectKind
from dg_localization.ros.interface.parameters.spec import (
    BOOL,
    DOUBLE,
    INTEGER,
    STRING,
    Section,
    Spec,
)

ANSWERS = Section(
    'Answers',
    '',
    (
        Spec(
            'localized_width',
            DOUBLE,
            1.0,
            'the diagnostics call a fleet localized when no enclosure of a robot is wider',
            'm',
            0.0,
        ),
        Spec(
            'covariance',
            STRING,
            'estimate',
            'what the covariance of a pose is made from',
            choices=('enclosure', 'estimate'),
            details="'estimate' is that of least squares, for readings whose errors are "
            'independent and anywhere in their bounds: the typical error, without a guarantee. '
            "'enclosure' takes the largest variance that the bounds allow. The guaranteed bounds "
            'are in the diagnostics and the markers in any case.',
        ),
        Spec(
            'covariance_floor',
            DOUBLE,
            0.05,
            "least standard deviation of a coordinate with covariance 'estimate'",
            'm',
            0.0,
        ),
    ),
)

SOLVER = Section(
    'Solver',
    'When a limit is met the answer is wider, never wrong.',
    (
        Spec(
            'max_hypotheses',
            INTEGER,
            64,
            'most hypotheses that are published',
            at_least=1,
            details='The diagnostics give the number that there are.',
        ),
        Spec(
            'solver.resolution',
            DOUBLE,
            0.05,
            'width of a distance that is not split further',
            'm',
            1e-6,
            1e6,
        ),
        Spec('solver.max_boxes', INTEGER, 2000, 'most boxes that one solve processes', at_least=1),
        Spec(
            'solver.max_seconds',
            DOUBLE,
            1.0,
            'longest time of one solve',
            's',
            0.001,
            finite=False,
            details='`.inf` for no limit.',
        ),
        Spec(
            'solver.tighten_slices',
            INTEGER,
            20,
            'most slices examined of each finished box, to tighten it',
            at_least=0,
            details='More slices give narrower bounds and take longer; 0 skips the tightening.',
        ),
        Spec(
            'solver.tighten_seconds',
            DOUBLE,
            0.1,
            'time of one solve from which on nothing is tightened any more',
            's',
            0.001,
            finite=False,
            details='When it is over bounds are wider, never wrong. The node spends less where '
            'estimates would be late for `rate`. `.inf` for no limit.',
        ),
    ),
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
