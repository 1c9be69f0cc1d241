"""Run the demonstration: `python -m dg_localization.ros.demo`."""

import sys

from dg_localization.ros.executables import demo

if __name__ == '__main__':
    sys.exit(demo())
