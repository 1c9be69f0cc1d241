# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Wrong readings: what contradicts what, whom to suspect, and what remains without them.

`suspects` says who can be wrong, `conflicts` searches for minimal sets, `oracle` decides whether
observations contradict each other, `explanation` puts these together. `offenders` counts who was
suspected over time.
"""
