# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The simulated fleet on real topics."""
