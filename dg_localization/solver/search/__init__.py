# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Branch and prune, and the tightening of kept boxes."""
