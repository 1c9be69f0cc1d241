# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The cloud of peers: layouts that are understood, and those that are refused by name."""

from types import SimpleNamespace

import numpy as np
import pytest

from msg_adapters.peers import peers_from_message

DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}
ROWS = {'peer': [2, 0, 5], 'range': [1.5, np.nan, 2.5], 'x': [np.nan, 1.0, 0.0]}
ROWS.update(y=ROWS['x'], z=ROWS['x'], reference=[5, 2, 0], range_difference=[-0.5, np.nan, 8.0])


RANGES = {'peer': 'u4', 'range': 'f4'}


def cloud(formats, order='<', **changes):
    """Return a message of {column: numpy type}, or of a dtype, some of whose fields are others."""
    if isinstance(formats, dict):
        formats = np.dtype([(name, order + kind) for name, kind in formats.items()])
    table = np.zeros(3, formats)
    for name in formats.names:
        is_real = formats[name].kind == 'f'
        table[name] = ROWS.get(name, 0) if is_real else np.nan_to_num(ROWS.get(name, 0))
    stamp = SimpleNamespace(sec=7, nanosec=0)
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id='r'),
        height=1,
        width=3,
        fields=[
            SimpleNamespace(name=name, offset=at, datatype=DATATYPES.get(kind.str[1:], 0), count=1)
            for name, (kind, at, *_) in formats.fields.items()
        ],
        is_bigendian=order == '>',
        point_step=formats.itemsize,
        row_step=table.nbytes,
        data=table.tobytes(),
    )
    vars(message).update(changes)
    return message


def assert_rows(reading, ranges=True, rays=True):
    unknown = np.full(3, np.nan)
    assert reading.stamp_s == 7.0 and reading.frame_id == 'r'
    assert reading.peers.tolist() == ROWS['peer'] and reading.peers.dtype == np.int64
    np.testing.assert_array_equal(reading.ranges_m, ROWS['range'] if ranges else unknown)
    expected = np.column_stack([ROWS['x'] if rays else unknown] * 3)
    np.testing.assert_array_equal(reading.rays_xyz, expected)


@pytest.mark.parametrize('order', ['<', '>'], ids=['little', 'big'])
@pytest.mark.parametrize('real', ['f4', 'f8'])
@pytest.mark.parametrize('whole', ['i1', 'u1', 'i2', 'u2', 'i4', 'u4'])
def test_every_type_and_byte_order_is_understood(whole, real, order):
    formats = {'peer': whole, 'range': real, 'x': real, 'y': real, 'z': real}
    assert_rows(peers_from_message(cloud(formats, order)))


def test_fields_may_be_in_any_order_with_gaps_and_others_between():
    dtype = np.dtype(
        {
            'names': ['z', 'intensity', 'range', 'y', 'peer', 'x'],
            'formats': ['<f4', '<f4', '<f8', '<f4', '<u2', '<f8'],
            'offsets': [2, 6, 12, 20, 30, 33],
            'itemsize': 48,
        }
    )
    assert_rows(peers_from_message(cloud(dtype)))


def test_ranges_alone_and_rays_alone_are_enough():
    assert_rows(peers_from_message(cloud(RANGES)), rays=False)
    rays = {'peer': 'u4', 'x': 'f4', 'y': 'f4', 'z': 'f4'}
    assert_rows(peers_from_message(cloud(rays)), ranges=False)


@pytest.mark.parametrize('others', [{}, {'range': 'f8'}])
def test_other_measures_alone_are_enough(others):
    formats = {'peer': 'u2', 'reference': 'u1', 'range_difference': 'f4', **others}
    reading = peers_from_message(cloud(formats))
    assert_rows(reading, ranges=bool(others), rays=False)
    assert reading.references.tolist() == ROWS['reference']
    np.testing.assert_array_equal(reading.differences_m, ROWS['range_difference'])
    reading = peers_from_message(cloud(RANGES))
    assert reading.references is None and reading.differences_m is None


def test_organized_cloud_with_padded_rows_is_read_row_by_row():
    data = cloud(RANGES).data
    padded = b''.join(data[begin : begin + 8] + bytes(5) for begin in (0, 8, 16))
    message = cloud(RANGES, height=3, width=1, row_step=13, data=padded)
    assert_rows(peers_from_message(message), rays=False)


def test_a_cloud_without_peers_is_no_fault():
    reading = peers_from_message(cloud(RANGES, width=0, row_step=0, data=b''))
    assert reading.peers.shape == (0,) and reading.ranges_m.shape == (0,)
    assert reading.rays_xyz.shape == (0, 3)


@pytest.mark.parametrize(
    'formats, changes, wanted',
    [
        ({'range': 'f4'}, {}, r"fields \['range'\] are not enough, there must be 'peer'"),
        ({'peer': 'u4'}, {}, r"fields \['peer'\] are not enough"),
        ({'peer': 'u4', 'x': 'f4', 'y': 'f4'}, {}, 'not enough'),
        ({'peer': 'u4', 'range': 'f4', 'reference': 'u4'}, {}, 'not enough'),
        ({'peer': 'u4', 'range_difference': 'f4'}, {}, "'reference' and 'range_difference'"),
        ({'peer': 'f4', 'range': 'f4'}, {}, "field 'peer' has datatype 7 and count 1"),
        ({'peer': 'u4', 'range': 'i4'}, {}, "field 'range' has datatype 5"),
        ({'peer': 'u8', 'range': 'f4'}, {}, "field 'peer' has datatype 0"),
        (RANGES, {'data': b'123'}, '3 bytes of data and a row_step of 24 do not hold height 1'),
        (RANGES, {'width': 4}, 'row_step of 24 do not hold height 1 times width 4'),
        (RANGES, {'height': 2}, '24 bytes of data'),
        (RANGES, {'point_step': 0}, "'peer' ends at byte 4, it must lie within point_step 0"),
    ],
)
def test_cloud_that_does_not_hold_what_it_says_is_refused(formats, changes, wanted):
    with pytest.raises(ValueError, match=wanted):
        peers_from_message(cloud(formats, **changes))


def test_field_of_several_numbers_or_named_twice_is_refused():
    message = cloud(RANGES)
    message.fields[1].count = 2
    with pytest.raises(ValueError, match="field 'range' has datatype 7 and count 2"):
        peers_from_message(message)
    message.fields[1].count = 0
    assert_rows(peers_from_message(message), rays=False)
    message.fields.append(message.fields[1])
    with pytest.raises(ValueError, match="field 'range' is there 2 times, not once"):
        peers_from_message(message)
