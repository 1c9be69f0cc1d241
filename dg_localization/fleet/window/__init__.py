# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The window: the observations of the last seconds, carried to now by odometry.

`memory` stores the observations, `carry` carries them to the time of a snapshot, `pose_sets`
places robots among anchors, `shape_headings` narrows the headings of a hypothesis or rules it out,
`recollection` combines these, and `follow` tracks hypotheses from one estimate to the next.
"""
