# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Interval distance geometry without ROS and without I/O.

``problem``, ``options``, ``result``, ``solve``: the public interface. ``box``: the data structure
of a search. ``decompose``: the rigid pieces of a fleet. ``contract``: the contractors and their
fixed point. ``search``: branch and prune, splitting, tightening. ``place``: placements, proofs,
hypotheses. ``assemble``: the answer of a fleet from the answers of its pieces.
"""
