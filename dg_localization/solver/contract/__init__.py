# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The contractors of the paper, and their fixed point (Section 4)."""
