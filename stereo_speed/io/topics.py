# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Choose the image and calibration topics of a stereo pair by type and name."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional

from ..core.errors import BagError

SIDES = ('left', 'right')
IMAGE_TYPES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
INFO_TYPE = 'sensor_msgs/msg/CameraInfo'
_COMPRESSED = '/compressed'


@dataclass(frozen=True)
class StereoTopics:
    """
    The topics of one camera pair.

    :param images: image topic of the left and of the right camera.
    :param infos: calibration topic of the left and of the right camera.
    """

    images: tuple[str, str]
    infos: tuple[str, str]


def choose_topics(types: Mapping[str, str], given: tuple[Optional[str], Optional[str]],
                  where: object) -> StereoTopics:
    """
    Choose the topics: the given ones, else those named left or right.

    :param types: message type of each topic that holds messages.
    :param given: image topic of each side, or None to find it.
    :param where: the bag, for the error.
    :raises BagError: a side has no topic, or several.
    """
    left, right = (_image_topic(types, side, topic, where)
                   for side, topic in zip(SIDES, given))
    if left == right:
        raise BagError(where, 'topics', f'{left} for both sides', 'two different image topics')
    infos = (_info_topic(types, 'left', left, where), _info_topic(types, 'right', right, where))
    return StereoTopics((left, right), infos)


def side_of(topic: str) -> Optional[str]:
    """Return the side in a topic's name; the last part that names exactly one decides."""
    for part in reversed(topic.lower().split('/')):
        named = [side for side in SIDES if side in part]
        if len(named) == 1:
            return named[0]
    return None


def _listed(types: Mapping[str, str]) -> str:
    return ', '.join(f'{topic} ({kind.rsplit("/", 1)[-1]})'
                     for topic, kind in sorted(types.items())) or 'no messages at all'


def _image_topic(types: Mapping[str, str], side: str, topic: Optional[str],
                 where: object) -> str:
    if topic is not None:
        # users may omit the leading slash
        name = topic if topic in types else '/' + topic
        if types.get(name) not in IMAGE_TYPES:
            raise BagError(where, f'--{side} {topic}', _listed(types),
                           'a topic of images in the bag')
        return name
    found = sorted(t for t, kind in types.items()
                   if kind in IMAGE_TYPES and side_of(t) == side
                   and not t.endswith('/compressedDepth'))
    # of the same images, raw and compressed, take the raw ones, which are lossless
    found = [t for t in found
             if not (t.endswith(_COMPRESSED) and t[:-len(_COMPRESSED)] in found)]
    if not found:
        raise BagError(where, f'{side} image topic', _listed(types),
                       f"one Image or CompressedImage topic with '{side}' in its name, "
                       f'or --{side} TOPIC')
    if len(found) > 1:
        raise BagError(where, f'{side} image topic', ' and '.join(found),
                       f'one only; choose with --{side} TOPIC')
    return found[0]


def _info_topic(types: Mapping[str, str], side: str, image: str, where: object) -> str:
    base = image[:-len(_COMPRESSED)] if image.endswith(_COMPRESSED) else image
    sibling = base.rsplit('/', 1)[0] + '/camera_info'
    if types.get(sibling) == INFO_TYPE:
        return sibling
    found = sorted(t for t, kind in types.items() if kind == INFO_TYPE and side_of(t) == side)
    if len(found) != 1:
        raise BagError(where, f'{side} camera_info', ' and '.join(found) or _listed(types),
                       f'{sibling} (CameraInfo)')
    return found[0]
