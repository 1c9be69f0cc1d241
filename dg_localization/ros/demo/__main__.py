# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Run the demonstration: `python -m dg_localization.ros.demo`."""

import sys

from dg_localization.ros.executables import demo

if __name__ == '__main__':
    sys.exit(demo())
