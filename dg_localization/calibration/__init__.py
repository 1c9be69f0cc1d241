# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Error bounds learned from recorded readings, and answers beside a ground truth."""
