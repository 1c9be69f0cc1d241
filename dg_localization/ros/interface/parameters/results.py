# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the table of parameters: answers, wrong readings, and what both may cost."""

from dg_localization.fleet import SuspectKind
from dg_localization.fleet.config import LEAST_MEMORY_S
from dg_localization.ros.interface.parameters.spec import Section, Spec
from dg_localization.ros.interface.poses import LEAST_DEVIATION_M

FLEET = Section(
    'Fleet',
    '',
    {
        'robots': Spec(
            [],
            'names of the robots; their order is the order of all outputs. At least one must '
            'be named.',
            list_of=str,
            shown=['robot_1', 'robot_2', 'robot_3'],
        ),
        'dimension': Spec(2, 'dimension of the space the robots move in', '', 2, 3),
        'fixed_frame': Spec(
            'map',
            'name of the frame of the anchors. Without anchors the frame is named after what '
            'it is tied to: the odometry frame of the reference robot as its messages name '
            'it, `ROBOT/base_link`, or `fleet`.',
        ),
        'reference_robot': Spec(
            '',
            'robot that the frame is tied to when the anchors do not fix it; empty for the '
            'first. In its odometry frame it is at its odometry pose. In other frames it is '
            'at the origin, and the x axis is its heading when its bearings fix that, else it '
            'points towards the next robot of the list.',
        ),
    },
)


NODE = Section(
    'Node',
    '',
    {
        'rate': Spec(5.0, 'how often the fleet is localized', 'Hz', 0.01, 1000.0),
        'autostart': Spec(
            True, 'configure and activate at start. Set it to false under a lifecycle manager.'
        ),
        'publish_tf': Spec(
            False,
            'publish transforms from the frame of the anchors on /tf. They go to the odometry '
            'frame of each robot that has odometry, and to the body of others. It needs the '
            'package tf2_msgs.',
        ),
    },
)


ANSWERS = Section(
    'Answers',
    '',
    {
        'localized_width': Spec(
            1.0,
            'the diagnostics call a fleet localized when no enclosure of a robot is wider',
            'm',
            0.0,
        ),
        'covariance': Spec(
            'estimate',
            "what the covariance of a pose is made from. 'estimate' is that of least squares: "
            "the typical error, without a guarantee. 'enclosure' takes the largest variance "
            'that the bounds allow. The diagnostics and markers have the bounds in any case.',
            choices=('estimate', 'enclosure'),
        ),
        'covariance_floor': Spec(
            LEAST_DEVIATION_M,
            "least standard deviation of a coordinate with covariance 'estimate'",
            'm',
            0.0,
        ),
    },
)


MEMORY = Section(
    'Memory',
    'What robots with odometry measured of each other, and of anchors, is remembered. It '
    'rules out mirror images and other hypotheses, bounds headings, and keeps robots '
    'placed that measure nothing for a moment. With `dimension: 3` it does so for robots '
    'among anchors, where `odometry.tilt` is stated.',
    {
        'memory.seconds': Spec(
            30.0,
            'how long measurements are remembered; 0 remembers nothing',
            's',
            LEAST_MEMORY_S,
            may_be_zero=True,
        ),
        'memory.max_seconds': Spec(
            0.15,
            'longest processor time that an estimate spends on them. `.inf` is refused. When '
            'it is over, or three times as long on the clock, the answer is wider, never '
            'wrong. With `window_outliers` what is left of it goes to the search for '
            'suspects, where a pair contradicts itself.',
            's',
            0.0,
        ),
        'window_outliers': Spec(
            0,
            'so many observations of each pair may be wrong in memory.seconds: of two robots, '
            'or of a robot and all anchors together. The truth is in the answer then, whether '
            'they contradict anything or not. Answers are wider. Of one observer and target '
            'at most one observation counts in memory.seconds/300.',
            '',
            0,
        ),
    },
)


CONTRADICTIONS = Section(
    'Contradictions',
    'An observation is what one sensor says of one target: the range and the ray of one '
    'detection are wrong together or not at all.',
    {
        'max_outliers': Spec(
            0,
            'most contradicting observations that may be dropped to get an answer. The answer '
            'is the union over all smallest ways to drop them. Where so many readings may be '
            'wrong without contradicting anything, `window_outliers` serves.',
            '',
            0,
        ),
        'outlier_unit': Spec(
            'observation',
            'what counts as one of `max_outliers`. A `sensor` is the camera or the range '
            'sensor of a robot, or one mounted sensor, with all that it says; a `robot` is '
            'all that it measures and that is measured of it.',
            choices=tuple(SuspectKind),
        ),
        'conflicts.max_solves': Spec(
            200,
            'most problems solved to explain one contradiction; 0 turns explanations off. For '
            '`window_outliers` the limit applies per pair.',
            '',
            0,
        ),
        'conflicts.max_seconds': Spec(
            2.0,
            'longest time of a search for what explains a contradiction, of which up to three '
            'run. `.inf` for no limit.',
            's',
            0.0,
            finite=False,
        ),
        'stuck.readings': Spec(
            20,
            'a sensor is stuck after this many readings that are identical to the last bit '
            'while a robot moved by 0.5 m; without odometry, ten times as many. 0 for no check.',
            '',
            0,
        ),
        'stuck.drop': Spec(False, 'drop readings that are stuck, besides the warning'),
    },
)


SOLVER = Section(
    'Solver',
    'When a limit is met the answer is wider, never wrong.',
    {
        'max_hypotheses': Spec(
            64,
            'most hypotheses that are published. The diagnostics give the number that there are.',
            '',
            1,
        ),
        'solver.resolution': Spec(
            0.05, 'width of a distance that is not split further', 'm', 1e-06, 1000000.0
        ),
        'solver.max_boxes': Spec(2000, 'most boxes that one solve processes', '', 1),
        'solver.max_seconds': Spec(
            1.0, 'longest time of one solve. `.inf` for no limit.', 's', 0.001, finite=False
        ),
        'solver.tighten_seconds': Spec(
            0.1,
            'time of one solve until which linear programs narrow its bounds; 0 for never. The '
            'node spends less where estimates would be late for `rate`. `.inf` for no limit.',
            's',
            0.0,
            finite=False,
        ),
    },
)
