# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Error bounds learned from recorded readings, and comparison of answers with a ground truth."""
