# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The demonstration: a simulated fleet, localized over DDS."""
