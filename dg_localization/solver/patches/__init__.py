# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Large rigid pieces, solved in overlapping patches of neighbors."""
