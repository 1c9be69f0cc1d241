# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fleets whose true placement is known."""
