# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The parameters of the node: one table, from which everything about them is made.

`table` has the rows. `spec` checks and declares one of them, and `settings` turns their values
into the settings of the node. `config/localizer.yaml` says what they mean.
"""
