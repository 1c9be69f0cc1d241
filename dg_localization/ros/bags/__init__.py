# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bags: localize one, or replay it on live topics."""
