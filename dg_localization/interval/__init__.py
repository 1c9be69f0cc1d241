# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Interval arithmetic: the only package that rounds outward."""
