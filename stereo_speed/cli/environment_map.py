# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``map``: draw the map of a scene from polygons: 255 pathway, 128 accessible, 0 inaccessible.

An overlay with contours of the distance field is written beside it.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import re
from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .options import number_in
from ..core.errors import InputError
from ..io.atomic import write_whole
from ..io.decoding import read_image
from ..io.scene_map import load_regions
from ..io.video import IMAGE_SUFFIXES, read_frames
from ..monocular.distance import DistanceField
from ..monocular.regions import draw_map
from ..report.targets import draw_field

_LARGEST = 16384  # px, side of a map; a larger number is taken for a typing error


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``map``."""
    add = parser.add_argument
    add('polygons', metavar='POLYGONS', type=Path, help='polygons file (YAML)')
    add('--size', type=_size, metavar='WxH', help="size, px (default: the image's)")
    add('--out', required=True, type=Path, metavar='PNG', help='map to write')
    add('--image', type=Path, metavar='IMAGE',
        help='image, video, folder or bag on whose first frame the overlay is drawn')
    add('--overlay', type=Path, metavar='PNG', help='overlay (default: OUT_overlay.png)')
    add('--step', type=number_in(float, 1, 10000), default=20.0, metavar='PX',
        help='distance between the contours of the overlay (default: 20)')


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r'(\d{1,5})x(\d{1,5})', text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (1 <= width <= _LARGEST and 1 <= height <= _LARGEST):
        raise argparse.ArgumentTypeError(f'found {text!r}, wanted WIDTHxHEIGHT in px')
    return width, height


def run(args: argparse.Namespace) -> int:
    """Draw the map and the overlay."""
    overlay = args.overlay or args.out.with_name(f'{args.out.stem}_overlay.png')
    if overlay.resolve() == args.out.resolve():
        raise InputError('map', '--overlay', overlay, 'another file than --out')
    regions, background = load_regions(args.polygons)
    image = None if args.image is None else _first_image(args.image)
    width, height = _map_size(args, image)
    labels = draw_map(regions, width, height, background)
    field = DistanceField(labels)
    _write(args.out, labels)
    _write(overlay, draw_field(field, image, args.step))
    for kind, level in (('pathway', 255), ('accessible', 128), ('inaccessible', 0)):
        print(f'{kind}: {100 * np.mean(labels == level):.1f} %')
    print(f'map in {args.out}, overlay in {overlay}')
    return 0


def _map_size(args: argparse.Namespace, image: Optional[NDArray[np.uint8]]) -> tuple[int, int]:
    """Return width and height of the map; ``--size`` must equal the size of an image."""
    given: Optional[tuple[int, int]] = args.size
    if image is None:
        if given is None:
            raise InputError('map', '--size', 'nothing', 'WIDTHxHEIGHT in px, or --image')
        return given
    height, width = image.shape[:2]
    if given not in (None, (width, height)):
        raise InputError(args.image, 'size', f'{width}x{height} px',
                         f'{args.size[0]}x{args.size[1]} px as given by --size')
    return width, height


def _first_image(path: Path) -> NDArray[np.uint8]:
    """Read an image, or the first frame of a video."""
    if path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES:
        return np.asarray(read_image(path, cv2.IMREAD_COLOR, 'a complete image'), np.uint8)
    return next(read_frames(path)).image


def _write(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a PNG, completely or not at all."""
    write_whole(path.parent, {path.name: cv2.imencode('.png', image)[1].tobytes()})
