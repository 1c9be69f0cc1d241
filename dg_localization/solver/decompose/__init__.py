# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid pieces and joints of a fleet, from the graph of measured pairs alone."""
