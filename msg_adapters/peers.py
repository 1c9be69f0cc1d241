# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
sensor_msgs/PointCloud2 <-> `PeersReading`: all measurements of one robot in one message.

The cloud is a table with a header and a row for each peer. Its columns are fields with these
names, in any order, at any offset; other fields are ignored:

- `peer`, an integer: which peer;
- `range`, a float in m: its distance;
- `x`, `y`, `z`, floats: the ray to it in the observer's body frame;
- `reference`, an integer, and `range_difference`, a float in m: the distance to the peer minus the
  distance to another peer.

A cloud has `range`, or `x`, `y` and `z`, or the last two, or several of these. NaN means not
measured.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import CdrWriter, header_of
from msg_adapters.registry import register_cdr

TYPE_NAME = 'sensor_msgs/msg/PointCloud2'
RAY = ('x', 'y', 'z')

# The types of sensor_msgs/PointField that a column may have, as numpy names them.
INTEGERS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4'}
FLOATS = {7: 'f4', 8: 'f8'}
COLUMNS = {'peer': INTEGERS, 'range': FLOATS, 'x': FLOATS, 'y': FLOATS, 'z': FLOATS}
DIFFERENCE = {'reference': INTEGERS, 'range_difference': FLOATS}
COLUMNS |= DIFFERENCE

# Datatype and numpy type of written integers and floats.
UINT32, FLOAT64 = (6, '<u4'), (8, '<f8')


@dataclass(frozen=True, eq=False)
class PeersReading:
    """
    The measurements of k peers by one robot at one time.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 if the header was left empty.
    peers : ndarray of int64, shape (k,)
        Index of each peer in a list that sender and receiver share.
    ranges_m : ndarray, shape (k,)
        Distances in m, with the sentinels of REP-117; NaN is no reading.
    rays_xyz : ndarray, shape (k, 3)
        Directions in the observer's body frame (x forward, y left, z up, REP-103), of any
        length; NaN is no reading.
    frame_id : str
        Frame of the rays.
    references : ndarray of int64, shape (k,), or None
        The reference peer of each; None if no difference was measured.
    differences_m : ndarray, shape (k,), or None
        The distance to the peer minus the distance to its reference in m; NaN is no reading.

    """

    stamp_s: float
    peers: NDArray[np.int64]
    ranges_m: NDArray[np.float64]
    rays_xyz: NDArray[np.float64]
    frame_id: str = ''
    references: NDArray[np.int64] | None = None
    differences_m: NDArray[np.float64] | None = None


def peers_from_message(message: Any) -> PeersReading:
    """
    Read a `sensor_msgs/PointCloud2`.

    Raises
    ------
    ValueError
        If a column is missing, has a type that is not allowed, or does not fit in the cloud.

    """
    table = _table(message)
    unknown = np.full(len(table), np.nan)
    columns = {
        name: table[name].astype(np.float64) if name in (table.dtype.names or ()) else unknown
        for name in ('range', *RAY, 'range_difference')
    }
    has_differences = 'reference' in (table.dtype.names or ())
    return PeersReading(
        **header_of(message),
        peers=table['peer'].astype(np.int64),
        ranges_m=columns['range'],
        rays_xyz=np.column_stack([columns[name] for name in RAY]),
        references=table['reference'].astype(np.int64) if has_differences else None,
        differences_m=columns['range_difference'] if has_differences else None,
    )


def _table(message: Any) -> NDArray[Any]:
    """Return the rows of a cloud as a structured array."""
    dtype = _row_type(message)
    shape, row_step = (message.height, message.width), message.row_step
    if row_step < message.width * dtype.itemsize or len(message.data) < message.height * row_step:
        raise ValueError(
            f'{len(message.data)} bytes of data and a row_step of {row_step} do not hold height '
            f'{message.height} times width {message.width} times point_step {dtype.itemsize}'
        )
    if 0 in shape:
        return np.empty(0, dtype)
    strides = row_step, dtype.itemsize
    return np.ndarray(shape, dtype, bytes(message.data), strides=strides).reshape(-1)


def _row_type(message: Any) -> np.dtype[Any]:
    """Return the numpy type of one point of a cloud; refuse fields that do not fit in it."""
    fields = [field for field in message.fields if field.name in COLUMNS]
    names = [field.name for field in fields]
    rays = [name for name in RAY if name in names]
    referred = [name for name in DIFFERENCE if name in names]
    whole = 'peer' in names and len(rays) in (0, 3) and len(referred) in (0, 2)
    if not whole or not ('range' in names or rays or referred):
        raise ValueError(
            f"fields {names} are not enough, there must be 'peer', and 'range' or 'x', 'y' and "
            "'z' or 'reference' and 'range_difference' or all of them"
        )
    for field in fields:
        if names.count(field.name) > 1:
            times = names.count(field.name)
            raise ValueError(f"field '{field.name}' is there {times} times, not once")
        # Some publishers leave the count of a single number at zero.
        if field.datatype not in COLUMNS[field.name] or field.count > 1:
            raise ValueError(
                f"field '{field.name}' has datatype {field.datatype} and count {field.count}, it "
                f'must be one number of a datatype of {list(COLUMNS[field.name])}'
            )
        end = field.offset + np.dtype(COLUMNS[field.name][field.datatype]).itemsize
        if end > message.point_step:
            raise ValueError(
                f"field '{field.name}' ends at byte {end}, it must lie within point_step "
                f'{message.point_step}'
            )
    order = '>' if message.is_bigendian else '<'
    return np.dtype(
        {
            'names': names,
            'formats': [order + COLUMNS[field.name][field.datatype] for field in fields],
            'offsets': [field.offset for field in fields],
            'itemsize': message.point_step,
        }
    )


def peers_to_cdr(reading: PeersReading) -> bytes:
    """Write a serialized `sensor_msgs/PointCloud2` of all columns, in double precision."""
    columns = {'peer': reading.peers, 'range': reading.ranges_m}
    columns |= dict(zip(RAY, reading.rays_xyz.T, strict=True))
    if reading.references is not None and reading.differences_m is not None:
        columns |= {'reference': reading.references, 'range_difference': reading.differences_m}
    types = {name: UINT32 if COLUMNS[name] is INTEGERS else FLOAT64 for name in columns}
    table = np.empty(len(reading.peers), [(name, kind) for name, (_, kind) in types.items()])
    header = reading.stamp_s, reading.frame_id
    writer = CdrWriter('hIII', header, 1, len(table), len(columns))
    offset, is_dense = 0, True
    for name, (datatype, kind) in types.items():
        table[name] = columns[name]
        is_dense &= bool(np.isfinite(columns[name]).all())
        writer.write('sIBI', name, offset, datatype, 1)  # the last is its count
        offset += np.dtype(kind).itemsize
    # The first is is_bigendian.
    sizes = offset, table.nbytes, table.nbytes
    writer.write('BIIIbB', False, *sizes, table.tobytes(), is_dense)
    return writer.to_bytes()


peers_to_message = register_cdr(TYPE_NAME, PeersReading, peers_from_message, peers_to_cdr)
