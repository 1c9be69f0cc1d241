# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Ground truths in text: tables of a spreadsheet, and trajectories as those of TUM."""

from collections.abc import Sequence
import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from dg_localization.ros.executables import UsageError

Poses = dict[str, list[tuple[float, Any, Any]]]
"""By robot its stamps in s, positions and quaternions."""

COLUMNS = ('stamp', 'robot', 'x', 'y')
QUATERNION = ('qx', 'qy', 'qz', 'qw')
TUM = ('stamp', 'x', 'y', 'z', *QUATERNION)
"""The columns of a file without a first line that names them."""

SYNONYMS = {'timestamp': 'stamp', 'time': 'stamp', 't': 'stamp', 'name': 'robot'}
SYNONYMS |= {f't{axis}': axis for axis in 'xyz'}

UNITS = (('nanoseconds', 1e-9, 1e17), ('microseconds', 1e-6, 1e14), ('milliseconds', 1e-3, 1e11))
"""What stamps are in that are greater than any time in seconds may be, and from where on."""


def read_table(path: Path, robots: Sequence[str], dimension: int, poses: Poses) -> list[str]:
    """
    Read a ground truth in text.

    Parameters
    ----------
    path : Path
        Columns are parted by commas, semicolons, tabs or blanks; the first line names them:
        stamp (s), robot, x, y (m), and where they are known z (m), and yaw (rad) or the quaternion
        qx, qy, qz, qw. Without names they are those of TUM: stamp, x, y, z, qx, qy, qz, qw. In
        space z has to be known, and a yaw alone is no orientation. NaN stands for what is not
        known.
    robots : sequence of str
        Other names are passed over; a table of one robot needs no names.
    dimension : {2, 3}
    poses : Poses
        Gets what is found.

    Returns
    -------
    list of str
        What there is to say of it.

    Raises
    ------
    UsageError
        If the file is no such table; the message names the line.

    """
    try:
        text = path.read_text(encoding='utf-8-sig')
        lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
        columns, rows = _split(lines)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f'{path} is no table in UTF-8: {error}') from None
    _check_columns(path, columns, robots, dimension)
    found: Poses = {}
    for number, cells in rows:
        try:
            row = {**dict.fromkeys(columns, ''), **dict(zip(columns, cells, strict=False))}
            pose = _pose_of(row, dimension)
            name = row['robot'] if 'robot' in columns else robots[0]
            found.setdefault(name, []).append(pose)
        except (KeyError, ValueError) as error:
            raise UsageError(f'{path}, line {number}: {error}') from None
    if found and found.keys().isdisjoint(robots):
        raise UsageError(
            f'{path} is the truth of {", ".join(found)}; the robots are {", ".join(robots)}'
        )
    unit, notices = _unit_of(path, [stamp_s for kept in found.values() for stamp_s, _, _ in kept])
    for name in filter(found.__contains__, robots):
        poses[name] += [(stamp * unit, place, turn) for stamp, place, turn in found[name]]
    return notices


def _split(
    lines: Sequence[tuple[int, str]],
) -> tuple[Sequence[str], list[tuple[int, list[str]]]]:
    """Return the names of the columns, and the cells of each line with its number."""
    plain = next((line for _, line in lines if line[0] != '#'), '')
    mark = next((mark for mark in ';\t,' if mark in plain), None)
    names: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    is_named = False
    for number, line in lines:
        cells = _cells(line.lstrip('#'), mark)
        # A comment may name the columns, as that of a file of TUM does.
        if not rows and not is_named and not _is_number(cells[0]):
            names = [SYNONYMS.get(cell.lower(), cell.lower()) for cell in cells]
            is_named = line[0] != '#'
        elif line[0] != '#':
            rows.append((number, cells))
    n_cells = len(rows[0][1]) if rows else 0
    return (TUM if n_cells == len(TUM) and 'x' not in names else names), rows


def _cells(line: str, mark: str | None) -> list[str]:
    if mark is None:
        return line.split() or ['']
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark))]
    # Where semicolons part the columns, commas may part the decimals.
    return [cell.replace(',', '.') for cell in cells] if mark == ';' else cells


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_columns(
    path: Path, columns: Sequence[str], robots: Sequence[str], dimension: int
) -> None:
    wanted = [name for name in COLUMNS if name != 'robot' or len(robots) > 1]
    wanted += ['z'] if dimension == 3 else []
    if not set(QUATERNION).isdisjoint(columns):
        wanted += QUATERNION
    missing = [name for name in wanted if name not in columns]
    if missing == ['robot']:
        raise UsageError(
            f'{path} does not say which robot it is of: it needs a column robot, or a name with '
            "{robot} such as 'truth_{robot}.tum' for one file of each"
        )
    if missing:
        raise UsageError(
            f'{path} has no column {", ".join(missing)}; its first line must name stamp, '
            'robot, x, y, in space z, and where they are known z, and yaw or qx, qy, qz and qw'
        )


def _pose_of(row: dict[str, str], dimension: int) -> tuple[float, Any, Any]:
    """Return stamp, position and quaternion of one row; ValueError where one is wrong."""
    flat = '0' if dimension == 2 else ''
    stamp, x, y = (float(row[name]) for name in ('stamp', 'x', 'y'))
    z = float(row.get('z') or flat)
    yaw_rad, *turn = (float(row.get(name) or math.nan) for name in ('yaw', *QUATERNION))
    if row.get('robot') == '':
        raise ValueError('it names no robot')
    if not math.isfinite(stamp):
        raise ValueError(f'stamp {stamp} is not a finite number')
    if any(map(math.isinf, (x, y, z, yaw_rad, *turn))):
        raise ValueError('no position and no orientation is infinite')
    if dimension == 2 and any(map(math.isnan, turn)):
        turn = [0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)]
    return stamp, np.array([x, y, z]), np.array(turn)


def _unit_of(path: Path, stamps: Sequence[float]) -> tuple[float, list[str]]:
    """Return the unit of some stamps in s, and a sentence where it is another one."""
    for name, unit, least in UNITS:
        if stamps and min(stamps) >= least:
            return unit, [
                f'{path}: stamps from {min(stamps):.0f} to {max(stamps):.0f} are no times in '
                f'seconds; they are taken as {name}, {min(stamps) * unit:.3f} to '
                f'{max(stamps) * unit:.3f} s'
            ]
    return 1.0, []


def apart_text(truth_s: Sequence[float], others_s: Sequence[float], what: str) -> str:
    """
    Return how the times of a ground truth and of something else miss each other.

    Parameters
    ----------
    truth_s, others_s : sequence of float
        The stamps of both.
    what : str
        What the others are, in words.

    Returns
    -------
    str
        Both spans, and the unit that the stamps may be in; empty where the spans meet.

    """
    if not (len(truth_s) and len(others_s)):
        return ''
    first_s, last_s = min(truth_s), max(truth_s)
    begin_s, end_s = min(others_s), max(others_s)
    if first_s <= end_s and begin_s <= last_s:
        return ''
    text = (
        f'The ground truth is of {first_s:.3f} to {last_s:.3f} s, {what} are of {begin_s:.3f} to '
        f'{end_s:.3f} s: these times do not meet. Stamps must be in seconds, on the same clock'
    )
    for name, unit in (*((name, unit) for name, unit, _ in UNITS), ('minutes', 60.0)):
        if first_s * unit <= end_s and begin_s <= last_s * unit:
            return f'{text}; those of the ground truth look like {name}.'
    if last_s - first_s < begin_s and first_s < 1e6 < begin_s:
        return f'{text}; those of the ground truth look counted from zero: add {begin_s:.3f}.'
    if end_s - begin_s < first_s and begin_s < 1e6 < first_s:
        return f'{text}; {what} look counted from zero.'
    return f'{text}; they are {min(abs(first_s - end_s), abs(begin_s - last_s)):.1f} s apart.'
