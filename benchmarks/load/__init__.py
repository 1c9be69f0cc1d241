# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The real node under load, over DDS: what it loses, how late it is, and what limits it."""
