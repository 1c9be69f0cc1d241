# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Wrong readings: conflicts between observations, suspects, and the answers without them.

`suspects` defines what can be wrong and counts suspects over time, `conflicts` searches for
minimal sets, `explanation` decides whether observations contradict each other and explains why.
`stuck` watches for readings and odometry that never change.
"""
