# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The best point of a hypothesis: least squares over the readings, within its enclosure."""
