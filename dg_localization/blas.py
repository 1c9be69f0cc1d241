# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One thread for OpenBLAS, unless NumPy is loaded already or the environment sets another number.

Matrices here have at most a few hundred rows. Several threads gain little on them, and take a
hundred times as long if another process delays one of the threads: 124 ms instead of 0.8 ms for
120 equations.
"""

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
