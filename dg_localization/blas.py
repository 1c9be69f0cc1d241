# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One thread for OpenBLAS, where NumPy is not loaded yet and the environment says nothing else.

Matrices here have at most some hundred rows. Several threads gain little on them, and where
another process keeps one of the threads waiting they take a hundred times as long: 120 equations
124 ms in place of 0.8 ms.
"""

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
