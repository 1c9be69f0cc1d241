# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
MRCLAM to a rosbag2: five robots with cameras among fifteen landmarks, with ground truth.

The dataset (K. Leung et al., "The UTIAS multi-robot cooperative localization and mapping dataset",
IJRR 30(8), 2011) is text, a line for each reading. What a robot saw is a range and a bearing of a
barcode; its odometry is the velocity it was told to drive with, which is integrated here::

    python docs/convert_mrclam.py MRCLAM_Dataset7 mrclam_7
    localize_bag mrclam_7 -o answers --params mrclam_7.yaml

It writes the bag `mrclam_7` and the parameters `mrclam_7.yaml`, and takes numpy and rosbags.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from recorder import Recorder, anchors_yaml

FloatArray = NDArray[np.float64]

ROBOTS = range(1, 6)

LATE_S = 0.05
"""The stamps of the measurements are late by about this much."""

PARAMETERS = """\
/**:
  ros__parameters:
    robots: ['r1', 'r2', 'r3', 'r4', 'r5']
    rate: 1.0
    # What a camera sees stays useful while the odometry tells how the robot went on.
    max_age: 2.0
    max_speed: 0.2
    max_turn_rate: 0.6
    # Velocities that were commanded, as fit_bounds finds them: the robots follow late.
    odometry:
      translation_per_m: 0.2
      rotation_per_m: 0.0
      rotation_per_rad: 0.2
      constant_translation: 0.1
      constant_rotation: 0.2
    # These hold all but gross errors, misread barcodes for one.
    range: {min_error_relative: -0.15, max_error_relative: 0.15}
    bearing: {half_width: 0.12}
    max_outliers: 1
    solver: {resolution: 0.1, max_boxes: 200}
"""


def read_table(path: Path) -> FloatArray:
    """Return the numbers of one file; lines that begin with # are comments."""
    lines = path.read_text(encoding='utf-8').splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.startswith('#')]
    return np.array(rows, dtype=float)


def dead_reckoning(commands: FloatArray) -> Iterator[tuple[float, float, float, float]]:
    """
    Yield stamp (s), x, y (m) and yaw (rad) from stamps, speeds (m/s) and turn rates (rad/s).

    A command holds until the next one. Within a step the robot drives in the direction that it has
    in the middle of it.
    """
    x = y = yaw = 0.0
    yield float(commands[0, 0]), x, y, yaw
    for (before_s, speed, rate), (stamp_s, *_) in zip(commands[:-1], commands[1:], strict=True):
        step_s = stamp_s - before_s
        middle = yaw + rate * step_s / 2.0
        x += speed * step_s * math.cos(middle)
        y += speed * step_s * math.sin(middle)
        yaw += rate * step_s
        yield float(stamp_s), x, y, yaw


def name_of(subject: int) -> str:
    """Return the name of a robot or a landmark: r1 to r5, m6 to m20."""
    return f'r{subject}' if subject in ROBOTS else f'm{subject}'


def convert(folder: Path, output: Path) -> int:
    """
    Convert one recording.

    Parameters
    ----------
    folder : Path
        With Barcodes.dat, Landmark_Groundtruth.dat, and three files for each robot.
    output : Path
        The bag, a folder that does not exist; the parameters go beside it, with .yaml added.

    Returns
    -------
    int
        How many measurements were of barcodes that belong to nobody, or to the robot itself.

    """
    subjects = {int(code): int(subject) for subject, code in read_table(folder / 'Barcodes.dat')}
    landmarks = read_table(folder / 'Landmark_Groundtruth.dat')
    recorder, unknown = Recorder(), 0
    for number in ROBOTS:
        robot = name_of(number)
        for stamp_s, x, y, yaw in read_table(folder / f'Robot{number}_Groundtruth.dat'):
            recorder.add_truth(robot, (x, y), yaw, stamp_s)
        for stamp_s, x, y, yaw in dead_reckoning(
            read_table(folder / f'Robot{number}_Odometry.dat')
        ):
            recorder.add_odometry(robot, (x, y), yaw, stamp_s)
        for row in read_table(folder / f'Robot{number}_Measurement.dat'):
            received_s, code, range_m, bearing_rad = row.tolist()
            subject = subjects.get(int(code), number)
            if subject == number:
                unknown += 1
                continue
            ends, stamp_s = (robot, name_of(subject)), received_s - LATE_S
            recorder.add_range(*ends, range_m, stamp_s, received_s)
            recorder.add_bearing(*ends, bearing_rad, stamp_s, received_s)
    recorder.write(output)
    anchors = [(name_of(int(subject)), (x, y)) for subject, x, y, *_ in landmarks]
    # The survey is good to a few millimeters.
    text = PARAMETERS + anchors_yaml(anchors, bound_m=0.01)
    output.with_name(output.name + '.yaml').write_text(text, encoding='utf-8')
    return unknown


def main() -> None:
    """Convert what the command line names."""
    parser = argparse.ArgumentParser(description='Convert MRCLAM to a rosbag2.')
    parser.add_argument('folder', type=Path, help='with Barcodes.dat and the other files')
    parser.add_argument('output', type=Path, help='the bag to write')
    options = parser.parse_args()
    if not (options.folder / 'Barcodes.dat').is_file():
        parser.error(f"'{options.folder}' has no Barcodes.dat")
    if options.output.exists():
        parser.error(f"'{options.output}' exists; name a folder that does not")
    parameters = options.output.with_name(options.output.name + '.yaml')
    if parameters.exists():
        parser.error(f"'{parameters}' exists; move it, or name another folder")
    unknown = convert(options.folder, options.output)
    print(f'{options.output} and {parameters} are written; {unknown} barcodes unknown')


if __name__ == '__main__':
    main()
