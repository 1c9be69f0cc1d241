# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The window: what was measured lately, carried to now by odometry.

`memory` keeps it, `carry` brings it to the time of a snapshot, `pose_sets` places robots among
anchors by it, `shape_headings` finds headings in a hypothesis or rules it out, `recollection` puts
these together, and `follow` follows hypotheses from one estimate to the next.
"""
