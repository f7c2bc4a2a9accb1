# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Measure a pass again from its record: images, site, rig and parameters."""
from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any, Mapping, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .instrument import config_of, place_of
from .verify import RECORD_FILE
from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import StereoPair
from ..core.trace import PassTrace, TracePair
from ..io.decoding import read_image
from ..io.trace_json import trace_of
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig
from ..pipeline.registry import TRACKERS
from ..pipeline.track import start_of
from ..site.file import load_site
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import CanHurry, DoubtsStamps, Refusal, SharesParticles

SITE, CALIBRATION, TRACE = 'site.yaml', 'calibration.json', 'trace.json'
PICTURE = 'a whole JPEG or PNG image'


@dataclass(frozen=True)
class Recomputed:
    """
    A pass, measured again.

    :param stored_mps: speed in the record, m/s.
    :param speed_mps: speed measured again from the stored images, m/s; None where there is none.
    :param reason: why there is none; empty otherwise.
    :param within_mps: greatest allowed difference of the two, m/s.
    """

    stored_mps: float
    speed_mps: Optional[float]
    reason: str
    within_mps: float

    @property
    def agrees(self) -> bool:
        """Return whether the two speeds agree."""
        return self.speed_mps is not None and \
            abs(self.speed_mps - self.stored_mps) <= self.within_mps


def recompute(folder: Path, within_mps: float = 0.01) -> Recomputed:
    """
    Measure the pass of a record again from the files in its folder alone.

    :param folder: folder with ``record.json``.
    :param within_mps: greatest allowed difference of the speeds, m/s.
    :raises InputError: a file is missing or cannot be read.
    """
    record = read_json(folder / RECORD_FILE)
    try:
        raw, stored = record['raw'], float(record['speed']['measured_mps'])
        config = config_of(record['parameters']['measuring'], folder / RECORD_FILE)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(folder / RECORD_FILE, 'record', f'{type(error).__name__}: {error}',
                         'a whole record') from None
    trace = trace_of(read_json(folder / TRACE), folder / TRACE)
    place = place_of(load_site(folder / SITE), read_json(folder / CALIBRATION), config,
                     folder / CALIBRATION)
    pairs = [_stored_pair(folder, raw, pair, k, place) for k, pair in enumerate(trace.pairs)]
    result = measure_again(trace, pairs, place, config)
    return Recomputed(stored, result.speed_mps, result.reason, within_mps)


def measure_again(trace: PassTrace, pairs: list[StereoPair], place: MeasuringSite,
                  config: PipelineConfig) -> PassResult:
    """
    Measure a pass exactly as before: same start, same pairs, same random stream.

    :param trace: trace of the pass.
    :param pairs: the pairs that the tracker was given.
    :param place: the site as used for measuring.
    :param config: the parameters.
    :raises InputError: the images do not show the first front.
    """
    shared = config.with_tolerances(place.site.tolerances).shared
    if trace.lane not in place.lanes:
        raise InputError('trace', 'lane', trace.lane, 'one of ' + ', '.join(place.lanes))
    start = start_of(trace, place.rig, place.lanes[trace.lane], shared, pairs[0])
    tracker = TRACKERS.load(config.tracker).start(start, config.tracker_settings)
    if isinstance(tracker, Refusal):
        raise tracker.error()
    lanes = LaneAssigner(place.lanes, shared.verdict)
    for pair, fed in zip(pairs, trace.pairs):
        if fed.particles is not None and isinstance(tracker, SharesParticles):
            tracker.share(fed.particles)
        if isinstance(tracker, CanHurry):
            tracker.hurry(fed.hurried)
        if fed.stamp_std_s is not None and isinstance(tracker, DoubtsStamps):
            tracker.doubt_stamps(fed.stamp_std_s)
        update = tracker.update(pair)
        if update is not None:
            lanes.place(update)
    return lanes.conclude(tracker.result())


def _stored_pair(folder: Path, raw: Mapping[str, Any], pair: TracePair, index: int,
                 place: MeasuringSite) -> StereoPair:
    """Return a pair of the pass, filled with grey outside its crops."""
    images = []
    for side, camera in (('left', place.rig.left), ('right', place.rig.right)):
        try:
            x, y = (int(v) for v in raw['origins_px'][index][side])
            path = folder / str(raw['files'][index][side])
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(folder / RECORD_FILE, f'raw.files[{index}]',
                             f'{type(error).__name__}: {error}', 'the images of a pair') from None
        grey = read_image(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH, PICTURE)
        images.append(_pasted(grey, (x, y), (camera.height_px, camera.width_px), path))
    return StereoPair(index, pair.stamp_ns, pair.right_stamp_ns, images[0], images[1],
                      stamp_error_s=pair.stamp_error_s, motion=pair.motion)


def _pasted(crop: NDArray[Any], at: tuple[int, int], shape: tuple[int, int], path: Path
            ) -> NDArray[Any]:
    """Return an image of the camera's size with a crop pasted into it."""
    (x, y), (height, width) = at, crop.shape
    if not (0 <= x <= shape[1] - width and 0 <= y <= shape[0] - height):
        raise InputError(path, 'crop', f'{width}x{height} px at {x}, {y}',
                         f'a part of a {shape[1]}x{shape[0]} px image')
    image = np.full(shape, int(crop.mean()), crop.dtype)
    image[y:y + height, x:x + width] = crop
    return image


def read_json(path: Path) -> Any:
    """
    Read a JSON file.

    :raises InputError: the file cannot be read, or is no JSON.
    """
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise InputError(path, 'file', error, 'readable JSON') from None
