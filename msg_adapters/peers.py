# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
sensor_msgs/PointCloud2 <-> `PeersReading`: all that one robot measured of others, in one message.

The cloud is taken as a table with a header, a row for each peer. Its columns are fields of these
names, in any order, at any offset; other fields are passed over:

- `peer`, an integer: which peer;
- `range`, a float in m: its distance;
- `x`, `y`, `z`, floats: the ray to it in the observer's body frame.

A cloud has `range`, or `x`, `y` and `z`, or all four. NaN stands for what was not measured.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import header_to_message, stamp_from_message
from msg_adapters.registry import Adapter, register

TYPE_NAME = 'sensor_msgs/msg/PointCloud2'
RAY = ('x', 'y', 'z')

# The types of sensor_msgs/PointField that a column may have, as numpy names them.
INTEGERS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4'}
FLOATS = {7: 'f4', 8: 'f8'}
COLUMNS = {'peer': INTEGERS, 'range': FLOATS, 'x': FLOATS, 'y': FLOATS, 'z': FLOATS}

# What is written: one point after the other, without gaps.
WRITTEN = np.dtype([('peer', '<u4'), *((name, '<f8') for name in ('range', *RAY))])
OFFSETS = {'peer': 0, 'range': 4, 'x': 12, 'y': 20, 'z': 28}
UINT32 = 6
FLOAT64 = 8


@dataclass(frozen=True, eq=False)
class PeersReading:
    """
    What one robot measured of k peers at one time.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    peers : ndarray of int64, shape (k,)
        Index of each peer in a list that both sides know.
    ranges_m : ndarray, shape (k,)
        Distances in m, with the sentinels of REP-117; NaN is no reading.
    rays_xyz : ndarray, shape (k, 3)
        Directions in the observer's body frame (x forward, y left, z up, REP-103), of any
        length; NaN is no reading.
    frame_id : str
        Frame of the rays.

    """

    stamp_s: float
    peers: NDArray[np.int64]
    ranges_m: NDArray[np.float64]
    rays_xyz: NDArray[np.float64]
    frame_id: str = ''


def peers_from_message(message: Any) -> PeersReading:
    """
    Read a `sensor_msgs/PointCloud2`.

    Raises
    ------
    ValueError
        If a column is missing, has a type that is not allowed, or is not where the cloud says.

    """
    table = _table(message)
    unknown = np.full(len(table), np.nan)
    columns = {
        name: table[name].astype(np.float64) if name in (table.dtype.names or ()) else unknown
        for name in ('range', *RAY)
    }
    return PeersReading(
        stamp_s=stamp_from_message(message.header.stamp),
        peers=table['peer'].astype(np.int64),
        ranges_m=columns['range'],
        rays_xyz=np.column_stack([columns[name] for name in RAY]),
        frame_id=message.header.frame_id,
    )


def _table(message: Any) -> NDArray[Any]:
    """Return the rows of a cloud as a structured array."""
    dtype = _row_type(message)
    height, width, row_step = message.height, message.width, message.row_step
    data = bytes(message.data)
    if row_step < width * dtype.itemsize:
        raise ValueError(
            f'row_step is {row_step} bytes, it must hold width {width} times point_step '
            f'{dtype.itemsize}'
        )
    if len(data) < height * row_step:
        raise ValueError(
            f'data is {len(data)} bytes long, it must hold height {height} times row_step '
            f'{row_step}'
        )
    if height * width == 0:
        return np.empty(0, dtype)
    rows = np.ndarray((height, width), dtype, data, strides=(row_step, dtype.itemsize))
    return rows.reshape(-1)


def _row_type(message: Any) -> np.dtype[Any]:
    """Return the numpy type of one point of a cloud."""
    fields = [field for field in message.fields if field.name in COLUMNS]
    _check_names([field.name for field in fields])
    for field in fields:
        _check_field(field, message.point_step)
    order = '>' if message.is_bigendian else '<'
    return np.dtype(
        {
            'names': [field.name for field in fields],
            'formats': [order + COLUMNS[field.name][field.datatype] for field in fields],
            'offsets': [field.offset for field in fields],
            'itemsize': message.point_step,
        }
    )


def _check_names(names: list[str]) -> None:
    for name in COLUMNS:
        if names.count(name) > 1:
            raise ValueError(f"field '{name}' is there {names.count(name)} times, not once")
    rays = [name for name in RAY if name in names]
    if 'peer' not in names or not ('range' in names or rays) or len(rays) not in (0, 3):
        raise ValueError(
            f"fields {names} are not enough, there must be 'peer', and 'range' or 'x', 'y' and "
            "'z' or all of them"
        )


def _check_field(field: Any, point_step: int) -> None:
    formats = COLUMNS[field.name]
    if field.datatype not in formats:
        kind = 'an integer' if formats is INTEGERS else 'a float'
        raise ValueError(
            f"field '{field.name}' has datatype {field.datatype}, it must be {kind}: one of "
            f'{list(formats)}'
        )
    # Some writers leave the count of a single number at zero.
    if field.count > 1:
        raise ValueError(f"field '{field.name}' has count {field.count}, it must be 1")
    size = np.dtype(formats[field.datatype]).itemsize
    if field.offset + size > point_step:
        raise ValueError(
            f"field '{field.name}' ends at byte {field.offset + size}, it must lie within "
            f'point_step {point_step}'
        )


def peers_to_message(reading: PeersReading) -> Any:
    """Write a `sensor_msgs/PointCloud2` with all five columns, the numbers in double precision."""
    from sensor_msgs.msg import PointCloud2, PointField

    table = np.empty(len(reading.peers), WRITTEN)
    table['peer'] = reading.peers
    table['range'] = reading.ranges_m
    for axis, name in enumerate(RAY):
        table[name] = reading.rays_xyz[:, axis]
    return PointCloud2(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        height=1,
        width=len(table),
        fields=[
            PointField(
                name=name,
                offset=offset,
                datatype=UINT32 if name == 'peer' else FLOAT64,
                count=1,
            )
            for name, offset in OFFSETS.items()
        ],
        is_bigendian=False,
        point_step=WRITTEN.itemsize,
        row_step=WRITTEN.itemsize * len(table),
        data=table.tobytes(),
        # Whether all numbers are finite.
        is_dense=bool(np.isfinite([*reading.ranges_m, *reading.rays_xyz.ravel()]).all()),
    )


register(Adapter(TYPE_NAME, PeersReading, peers_from_message, peers_to_message))
