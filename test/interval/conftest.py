# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Makes `solver_cases` importable here too: the guard of the environment is tested on solves."""

from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).parents[1] / 'solver'))
