# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers in pieces: rigid pieces solved one by one, and their combinations."""
