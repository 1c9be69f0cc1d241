# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Interval distance geometry without ROS and without I/O.

``problem``, ``options``, ``result``, ``solve``: what a user states and gets. ``box``: the one data
structure of a search. ``decompose``: the rigid pieces of a fleet. ``contract``: the contractors,
and their fixed point. ``search``: branch and prune, splitting, tightening. ``place``: placements,
their proofs, hypotheses. ``assemble``: from the answers of the pieces to that of the fleet.
"""
