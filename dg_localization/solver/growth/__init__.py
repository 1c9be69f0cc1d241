# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid pieces in space, placed point by point."""
