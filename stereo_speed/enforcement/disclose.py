# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Make a copy of a record for disclosure, in whose pictures no one else is recognisable.

Everything but the front of the measured vehicle is blurred: other vehicles, plates and people are
hidden wherever they are, without depending on a detector. Of the vehicle itself, the part where
people sit is blurred too, and its plate on request.
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
_KEPT = ('speed.png',)  # files that show no people or plates
_WINDSCREEN_SHARE = 0.45  # upper part of a front, where people are visible
_CELLS = 24  # cells across a blurred picture; a cell is wider than a distant vehicle
_FRONT_CELLS = 4  # cells across a blurred part of the front; no digit or face remains


def disclose(folder: Path, out: Path, *, hide_plate: bool = False) -> Path:
    """
    Write a copy of a record whose pictures show only the vehicle.

    :param folder: folder of the record, which must verify.
    :param out: folder for the copy; made where it is missing.
    :param hide_plate: whether the whole front is blurred as well.
    :return: the copy's folder.
    :raises InputError: the record does not verify, or the folder cannot be written.
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
    """Return the metadata of the copy, with the identity of the original record."""
    kept = ('id', 'number', 'time', 'place', 'direction', 'speed', 'instrument')
    return {'stereo_speed_disclosure': 1, **{key: record[key] for key in kept},
            'pictures': pictures, 'plate_hidden': hide_plate,
            'hidden': 'all but the front of the vehicle, and the upper part of that front',
            'record_sha256': sha256((folder / RECORD_FILE).read_bytes()),
            'seal': json.loads((folder / SEAL_FILE).read_text(encoding='utf-8'))}


def _hidden(image: Image, front_px: Array, hide_plate: bool) -> Image:
    """
    Return an image in which only the lower part of a front is visible.

    :param image: (H, W, 3) uint8.
    :param front_px: (4, 2), corners of the front.
    :param hide_plate: whether that part is hidden as well.
    """
    out = _coarse(image, _CELLS)
    rows, columns = window(image, front_px)
    middle = rows.start + round((rows.stop - rows.start) * _WINDSCREEN_SHARE)
    people, plate = (slice(rows.start, middle), columns), (slice(middle, rows.stop), columns)
    out[people] = _coarse(image[people], _FRONT_CELLS)
    out[plate] = _coarse(image[plate], _FRONT_CELLS) if hide_plate else image[plate]
    return out


def _coarse(image: Image, cells: int) -> Image:
    """Return an image reduced to the means of cells, with a given number across."""
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
