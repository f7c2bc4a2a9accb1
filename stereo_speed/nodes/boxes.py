# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The message for boxes of vehicles: one ``sensor_msgs/PointCloud2`` for each left image.

Its header has the stamp of that image.  Each point is a box in the raw image.  The fields ``x``
and ``y`` are its left and its upper edge, ``width`` and ``height`` its size, all in pixels.  The
optional field ``score`` is its confidence between 0 and 1.  A message without points means that
there is no vehicle.
"""
from __future__ import annotations

from typing import Sequence

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from ..core.errors import InputError
from ..detection.protocol import ImageBox

BOXES_TOPIC = 'boxes'
_NEEDED = ('x', 'y', 'width', 'height')
_FIELDS = (*_NEEDED, 'score')
_KINDS = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8', PointField.INT32: 'i4',
          PointField.UINT32: 'u4', PointField.INT16: 'i2', PointField.UINT16: 'u2',
          PointField.INT8: 'i1', PointField.UINT8: 'u1'}


def boxes_from_message(msg: PointCloud2) -> list[ImageBox]:
    """
    Return the boxes of a message.

    :raises InputError: a field is missing or lies beyond its point, the data are too short for
        their sizes, or a box is not finite.
    """
    if not msg.width * msg.height:
        return []
    order = '>' if msg.is_bigendian else '<'
    kinds = {f.name: (order + _KINDS[f.datatype], f.offset) for f in msg.fields
             if f.name in _FIELDS and f.datatype in _KINDS}
    for name in _NEEDED:
        if name not in kinds:
            given = ', '.join(f.name for f in msg.fields) or 'none'
            raise InputError(BOXES_TOPIC, 'fields', given, ', '.join(_NEEDED))
    end = max(at + np.dtype(kind).itemsize for kind, at in kinds.values())
    if msg.point_step < end:
        raise InputError(BOXES_TOPIC, 'point_step', msg.point_step, f'{end}, where the fields end')
    count, data = msg.width * msg.height, bytes(msg.data)
    if msg.height > 1 and msg.row_step != msg.width * msg.point_step:
        raise InputError(BOXES_TOPIC, 'row_step', msg.row_step, msg.width * msg.point_step)
    if len(data) < count * msg.point_step:
        raise InputError(BOXES_TOPIC, 'data', f'{len(data)} bytes',
                         f'{count * msg.point_step} for {count} points')
    record = np.dtype({'names': list(kinds), 'formats': [k for k, _ in kinds.values()],
                       'offsets': [at for _, at in kinds.values()],
                       'itemsize': msg.point_step})
    points = np.frombuffer(data, record, count)
    values = np.stack([points[name].astype(float) if name in kinds else np.ones(count)
                       for name in _FIELDS], axis=-1)
    if not np.isfinite(values).all():
        raise InputError(BOXES_TOPIC, 'boxes', 'a number that is not finite', 'finite pixels')
    return [ImageBox(left_px=x, top_px=y, width_px=w, height_px=h, score=score)
            for x, y, w, h, score in values.tolist()]


def boxes_message(boxes: Sequence[ImageBox], header: Header) -> PointCloud2:
    """
    Return the message for boxes.

    :param boxes: all boxes of an image.
    :param header: header of the left image.
    """
    rows = np.array([[b.left_px, b.top_px, b.width_px, b.height_px, b.score] for b in boxes],
                    np.float32).reshape(-1, len(_FIELDS))
    fields = [PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
              for k, name in enumerate(_FIELDS)]
    return PointCloud2(header=header, height=1, width=len(rows), fields=fields,
                       is_bigendian=False, point_step=4 * len(_FIELDS),
                       row_step=4 * len(_FIELDS) * len(rows), is_dense=True, data=rows.tobytes())
