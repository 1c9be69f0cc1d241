# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The other methods. Each module has NAME, ``missing()`` and ``rows(case)``."""
