# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the table of parameters: what is said of an answer, and what it may cost."""

from dg_localization.ros.interface.parameters.spec import DOUBLE, INTEGER, STRING, Section, Spec

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
