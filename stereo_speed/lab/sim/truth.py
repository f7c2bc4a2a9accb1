# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write ``truth.csv``."""
from __future__ import annotations

import csv
from pathlib import Path
from typing import Iterable, Mapping, Sequence

TRUTH_COLUMNS = ('stamp', 'vehicle', 'speed', 'path_speed', 'lateral', 'x', 'y', 'z', 'width_px')
TRAFFIC_COLUMNS = (*TRUTH_COLUMNS, 'lane', 'visible', 'in_view')
_FORMATS = {'speed': '.5f', 'path_speed': '.5f', 'lateral': '.4f', 'x': '.4f', 'y': '.4f',
            'z': '.4f', 'width_px': '.1f', 'visible': '.3f', 'in_view': 'd'}


def write_truth(rows: Iterable[Mapping[str, object]], path: Path,
                columns: Sequence[str] = TRUTH_COLUMNS) -> None:
    """
    Write the rows of a simulation.

    :param rows: rows in the order of the file.
    :param path: path of the file.
    :param columns: columns to write.
    """
    with path.open('w', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(columns)
        for row in rows:
            writer.writerow([format(row[key], _FORMATS.get(key, '')) for key in columns])
