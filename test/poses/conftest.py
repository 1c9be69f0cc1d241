# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Makes `pair_cases` importable: pytest's importlib mode leaves sys.path alone."""

from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).parent))
