# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From the hypotheses of the solver to placements in the fixed frame."""
