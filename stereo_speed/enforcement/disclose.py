# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A copy of a record to be handed out: of others in its pictures nothing can be recognised.

All but the front of the vehicle that was measured is blurred: other vehicles, plates and people
are hidden wherever they are, and no detector can miss one. Of the vehicle itself the part where
people sit is blurred too, and its plate where that is asked for.
"""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from .fingerprint import sha256
from .page import DISCLOSED_NOTE, page_html, page_pdf, PageFacts
from .recompute import PICTURE, read_json
from .verify import RECORD_FILE, SEAL_FILE, verify
from ..core.errors import InputError
from ..core.records import Array
from ..io.atomic import staged
from ..io.decoding import read_image
from ..io.topics import SIDES
from ..report.evidence_pictures import close_up, jpeg, window

Image = NDArray[np.uint8]

DISCLOSURE = 'disclosure.json'
_KEPT = ('speed.png',)  # of the files, those that show nobody
_WINDSCREEN_SHARE = 0.45  # upper part of a front, where people are seen
_CELLS = 24  # across a blurred picture: a cell of it is wider than a far vehicle
_FRONT_CELLS = 4  # across a blurred part of the front: no digit and no face is left


def disclose(folder: Path, out: Path, *, hide_plate: bool = False) -> Path:
    """
    Write a copy of a record whose pictures show the vehicle alone.

    :param folder: of the record, which must be as it was written.
    :param out: folder for the copy; made when it is not there.
    :param hide_plate: whether the whole front is blurred as well.
    :return: the copy's folder.
    :raises InputError: a record that is not sound, or a folder that cannot be written.
    """
    found = verify(folder)
    if not found.sound or not (folder / RECORD_FILE).exists():
        raise InputError(folder, 'record', found.faults[0] if found.faults else 'several records',
                         'one record as it was written')
    record = read_json(folder / RECORD_FILE)
    target = out / f'{record["id"]}-disclosed'
    files: dict[str, bytes] = {name: (folder / name).read_bytes() for name in _KEPT}
    pictures, widest_px = [], 0.0
    for number, picture in enumerate(record['pictures'], 1):
        row: dict[str, Any] = {'stamp_ns': picture['stamp_ns']}
        for side in SIDES:
            front_px = np.array(picture[f'{side}_front_px'])
            image = _hidden(_read(folder / picture[side]), front_px, hide_plate)
            row[side] = f'{number}_{side}.jpg'
            files[row[side]] = jpeg(image)
            width_px = float(np.ptp(front_px[:, 0]))
            if side == 'left' and width_px > widest_px:
                widest_px, files['close_up.jpg'] = width_px, jpeg(close_up(image, front_px))
        pictures.append(row)
    told = _told(record, pictures, folder, hide_plate)
    facts = PageFacts({**record, 'pictures': pictures},
                      [files[row['left']] for row in pictures] + [files[pictures[-1]['right']]],
                      files['close_up.jpg'], files['speed.png'], DISCLOSED_NOTE)
    files['page.html'], files['page.pdf'] = page_html(facts), page_pdf(facts)
    told['files'] = {name: sha256(data) for name, data in sorted(files.items())}
    files[DISCLOSURE] = (json.dumps(told, indent=1, sort_keys=True) + '\n').encode()
    with staged(target, (DISCLOSURE, *files)) as aside:
        for name, data in files.items():
            (aside / name).write_bytes(data)
    return target


def _told(record: Mapping[str, Any], pictures: list[dict[str, Any]], folder: Path,
          hide_plate: bool) -> dict[str, Any]:
    """Return what the copy says of itself, and of the record that it is from."""
    kept = ('id', 'number', 'time', 'place', 'direction', 'speed', 'instrument')
    return {'stereo_speed_disclosure': 1, **{key: record[key] for key in kept},
            'pictures': pictures, 'plate_hidden': hide_plate,
            'hidden': 'all but the front of the vehicle, and the upper part of that front',
            'record_sha256': sha256((folder / RECORD_FILE).read_bytes()),
            'seal': json.loads((folder / SEAL_FILE).read_text(encoding='utf-8'))}


def _hidden(image: Image, front_px: Array, hide_plate: bool) -> Image:
    """
    Return an image with all hidden but the lower part of a front.

    :param image: (H, W, 3) uint8.
    :param front_px: (4, 2) corners of the front.
    :param hide_plate: whether that is hidden as well.
    """
    out = _coarse(image, _CELLS)
    rows, columns = window(image, front_px)
    middle = rows.start + round((rows.stop - rows.start) * _WINDSCREEN_SHARE)
    people, plate = (slice(rows.start, middle), columns), (slice(middle, rows.stop), columns)
    out[people] = _coarse(image[people], _FRONT_CELLS)
    out[plate] = _coarse(image[plate], _FRONT_CELLS) if hide_plate else image[plate]
    return out


def _coarse(image: Image, cells: int) -> Image:
    """Return an image of which only the mean of each of some cells across is left."""
    height, width = image.shape[:2]
    if not (height and width):
        return image
    across = min(cells, width)
    down = max(round(across * height / width), 1)
    small = cv2.resize(image, (across, down), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR),
                      np.uint8)


def _read(path: Path) -> Image:
    image = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, PICTURE)
    return np.asarray(image, np.uint8)
