# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The parameters of the node, all defined in one table.

`table` has the rows. `spec` checks and declares one parameter, and `settings` converts their
values to the settings of the node. `config/localizer.yaml` documents them.
"""
