# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The files of one record: pictures, images for measuring again, ``record.json``, a page."""
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import datetime, timezone
import json
from typing import Any, Mapping, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .config import EnforcementConfig
from .decision import Decision
from .fingerprint import Approved, sha256
from .instrument import Instrument
from .recompute import CALIBRATION, SITE, TRACE
from .schema import SCHEMA, schema_fault
from ..core.passes import PassResult, SecondEstimate
from ..core.records import Array, TrackUpdate
from ..core.sampling import evenly
from ..core.trace import PassTrace, TracePair
from ..core.units import SpeedUnit
from ..io.source_image import png, SourceImage
from ..io.topics import SIDES
from ..io.trace_json import trace_record
from ..pipeline.assembly import MeasuringSite
from ..report.evidence_pictures import close_up, jpeg, marked, speed_plot, window

FORMAT = 1
Views = tuple[SourceImage, SourceImage]
Shown = Sequence[tuple[int, TrackUpdate]]  # index and update of the pairs in the pictures


@dataclass(frozen=True)
class Setting:
    """
    What all records of a run have in common.

    :param instrument: state of the measuring instrument.
    :param place: the site as used for measuring.
    :param config: parameters of enforcement.
    :param approved: approved fingerprints.
    :param source: where the stamps come from.
    :param recording: identity of the replayed bag; None when live.
    """

    instrument: Instrument
    place: MeasuringSite
    config: EnforcementConfig
    approved: Approved
    source: str
    recording: Optional[Mapping[str, Any]] = None


@dataclass(frozen=True, eq=False)
class Violation:
    """
    One violation and its images.

    :param record_id: id of the pass.
    :param result: the measured pass, with its trace.
    :param trace: trace of the pass.
    :param decision: figures of the decision.
    :param images: left and right images of each pair of the trace, as received.
    :param clock: state of the system's clock; None where it is not available.
    """

    record_id: str
    result: PassResult
    trace: PassTrace
    decision: Decision
    images: Sequence[Views]
    clock: Optional[Mapping[str, Any]] = None


def record_files(case: Violation, number: int, setting: Setting, *, whole: bool
                 ) -> tuple[dict[str, bytes], bytes]:
    """
    Return the files of a record, and the bytes of its ``record.json``.

    :param case: the violation.
    :param number: number of its entry in the chain.
    :param setting: what all records have in common.
    :param whole: whether to keep whole images of every pair instead of crops.
    :raises InputError: an image cannot be decoded.
    """
    files = {SITE: setting.instrument.site_yaml.encode(),
             CALIBRATION: _json(setting.instrument.calibration),
             TRACE: _json(trace_record(case.trace)),
             SCHEMA.name: SCHEMA.read_bytes(),
             'speed.png': _plot(case, setting)}
    from .page import page_html, page_pdf, PageFacts  # reportlab and matplotlib are slow to load
    shown = _shown(case, setting)
    raw = _raw(case, setting, whole, files)
    pictures = _pictures(case, setting, shown, files)
    record = _record(case, number, setting, raw, pictures, shown)
    facts = PageFacts(record, [files[p['left_marked']] for p in pictures]
                      + [files[pictures[-1]['right_marked']]],
                      files['close_up.jpg'], files['speed.png'])
    files['page.html'], files['page.pdf'] = page_html(facts), page_pdf(facts)
    record['files'] = {name: {'sha256': sha256(data), 'bytes': len(data)}
                       for name, data in sorted(files.items())}
    fault = schema_fault(record)
    if fault:
        raise ValueError(f'record.json breaks its schema: {fault}')
    return files, _json(record)


def violation_text(record: Mapping[str, Any], folder: str, record_sha256: str) -> str:
    """
    Return a violation as one line of JSON, for a topic.

    :param record: content of its ``record.json``.
    :param folder: folder of the record.
    :param record_sha256: SHA-256 of ``record.json``.
    """
    speed, place = record['speed'], record['place']
    figures = ('measured_mps', 'measured_std_mps', 'limit_mps', 'unit', 'measured', 'considered',
               'limit')
    return json.dumps({
        'stereo_speed_violation': FORMAT, **{key: record[key] for key in (
            'id', 'number', 'run', 'track', 'direction')},
        'lane': place['lane'], 'first_stamp_ns': record['time']['first_stamp_ns'],
        'last_stamp_ns': record['time']['last_stamp_ns'],
        **{key: speed[key] for key in figures},
        'folder': folder, 'record_sha256': record_sha256}, allow_nan=False)


def _json(data: Any) -> bytes:
    return (json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + '\n').encode()


# -- record.json ------------------------------------------------------------------------------


def _record(case: Violation, number: int, setting: Setting, raw: dict[str, Any],
            pictures: list[dict[str, Any]], shown: Shown) -> dict[str, Any]:
    result, instrument = case.result, setting.instrument
    evidence = setting.config.evidence
    unknown = setting.approved.unknown(instrument.fingerprints)
    calibrated = setting.place.site.calibrated
    return {
        'stereo_speed_evidence': FORMAT, 'id': case.record_id, 'number': number,
        'run': instrument.run, 'track': result.track,
        'time': {'first_stamp_ns': result.first_ns, 'last_stamp_ns': result.last_ns,
                 'first_utc': utc(result.first_ns), 'last_utc': utc(result.last_ns),
                 'source': setting.source,
                 'clock': None if case.clock is None else dict(case.clock)},
        'place': {'site': instrument.site_name, 'place': evidence.place, 'lane': result.lane,
                  'lane_to': result.lane_to},
        'direction': 'not known' if result.direction is None else str(result.direction),
        'speed': _speeds(case), 'vehicle': _vehicle(case, setting, shown),
        'instrument': {
            'name': evidence.instrument_name,
            'calibrated': None if calibrated is None else calibrated.isoformat(),
            'self_test': None if instrument.self_test is None else dict(instrument.self_test),
            'versions': dict(instrument.versions),
            'fingerprints': instrument.fingerprints, 'not_approved': unknown,
            'approved': 'no' if unknown else 'yes' if setting.approved.of else 'not asked'},
        'parameters': {'measuring': dict(instrument.parameters),
                       'enforcement': dataclasses.asdict(setting.config)},
        'input': None if setting.recording is None else dict(setting.recording),
        'pictures': pictures, 'close_up': 'close_up.jpg', 'plot': 'speed.png',
        'page': 'page.html', 'page_pdf': 'page.pdf', 'raw': raw, 'files': {}}


def _speeds(case: Violation) -> dict[str, Any]:
    result, decision = case.result, case.decision
    assert result.speed_mps is not None and result.speed_std_mps is not None  # noqa: S101
    budget = None if result.budget is None else dataclasses.asdict(result.budget)
    return {
        'measured_mps': result.speed_mps, 'measured_std_mps': result.speed_std_mps,
        'std_parts_mps': budget,
        'first': dataclasses.asdict(SecondEstimate(
            result.speed_mps, result.speed_std_mps, result.pairs)),
        'second': None if result.second is None else dataclasses.asdict(result.second),
        'decisive_mps': decision.speed_mps, 'tolerance_mps': decision.tolerance_mps,
        'margin_mps': decision.margin_mps, 'limit_mps': decision.limit_mps,
        'unit': decision.unit, 'measured': decision.measured,
        'considered': decision.considered, 'limit': decision.limit,
        'profile': [_profile_row(pair, result) for pair in case.trace.pairs]}


def _profile_row(pair: TracePair, result: PassResult) -> dict[str, Any]:
    update = pair.update
    return {'stamp_ns': pair.stamp_ns, 'state': str(update.state) if update else 'not seen',
            'live_mps': update.speed_mps if update else None,
            'live_std_mps': update.speed_std_mps if update else None,
            'smoothed_mps': result.smoothed.get(pair.stamp_ns),
            's_m': update.s_m if update else None,
            'lateral_m': update.lateral_m if update else None,
            'position_m': update.position_m.tolist() if update else []}


def _vehicle(case: Violation, setting: Setting, shown: Shown) -> dict[str, Any]:
    last = shown[-1][1]
    size_m = np.ptp(last.quad_left_px, axis=0) * setting.place.rig.left.metres_per_px(
        float(last.position_m[2]))
    others = sorted({o.track for pair in case.trace.pairs for o in pair.others})
    kind = case.result.vehicle
    return {'class': None if kind is None else str(kind.name),
            'class_probability': None if kind is None else kind.probability,
            'front_width_m': round(float(size_m[0]), 3),
            'front_height_m': round(float(size_m[1]), 3), 'others': others,
            'identified_by': 'its front, marked in both views of each picture; what can be read '
                             'of its plate is in the close-up'}


def utc(stamp_ns: int) -> str:
    """Return a stamp as date and time in UTC, to the ns."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f'{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z'


# -- pictures ---------------------------------------------------------------------------------


def _shown(case: Violation, setting: Setting) -> Shown:
    """Return index and update of the pairs to show, evenly spread over the pass."""
    shown = set(case.trace.shown(case.result.smoothed))
    return evenly([(k, pair.update) for k, pair in enumerate(case.trace.pairs)
                   if pair in shown and pair.update is not None],
                  setting.config.evidence.pictures)


def _pictures(case: Violation, setting: Setting, shown: Shown, files: dict[str, bytes]
              ) -> list[dict[str, Any]]:
    """Add whole pairs, plain and marked, and the close-up to ``files``; return their list."""
    place, out = setting.place, []
    widest = max(shown, key=lambda one: float(np.ptp(one[1].quad_left_px[:, 0])))[0]
    for number, (index, update) in enumerate(shown, 1):
        where = f'pair at {update.stamp_ns} ns'
        pair = case.trace.pairs[index]
        views = tuple(image.colours(where) for image in case.images[index])
        quads = update.quad_left_px, update.quad_right_px
        caption = f'{case.record_id}  {utc(update.stamp_ns)}  {case.result.lane}'
        drawn = marked((views[0], views[1]), quads, place.lanes[case.trace.lane],
                       place.rig.as_taken(pair.motion), caption)
        row: dict[str, Any] = {'stamp_ns': update.stamp_ns}
        for side, image, view, quad in zip(SIDES, case.images[index], drawn, quads):
            ending, data = image.file(where)
            row[side] = f'pictures/{number}_{side}{ending}'
            row[f'{side}_marked'] = f'pictures/{number}_{side}_marked.jpg'
            row[f'{side}_front_px'] = np.round(quad, 3).tolist()
            files[row[side]], files[row[f'{side}_marked']] = data, jpeg(view)
        out.append(row)
        if index == widest:
            files['close_up.jpg'] = jpeg(close_up(views[0], update.quad_left_px))
    return out


def _plot(case: Violation, setting: Setting) -> bytes:
    updates = [pair.update for pair in case.trace.pairs if pair.update is not None]
    return speed_plot(updates, case.result, setting.place.lanes, SpeedUnit(case.decision.unit))


# -- images for measuring again ---------------------------------------------------------------


def _raw(case: Violation, setting: Setting, whole: bool, files: dict[str, bytes]
         ) -> dict[str, Any]:
    """Add the image regions that the tracker used to ``files``; return names and origins."""
    names, origins = [], []
    for index, (pair, images) in enumerate(zip(case.trace.pairs, case.images)):
        row, origin = {}, {}
        for side, image in zip(SIDES, images):
            grey = image.grey(f'pair at {pair.stamp_ns} ns')
            quad = None if pair.update is None else getattr(pair.update, f'quad_{side}_px')
            part, at = (grey, (0, 0)) if whole or quad is None else _crop(
                grey, quad, setting.config.evidence.crop_margin)
            row[side], origin[side] = f'raw/{index:04d}_{side}.png', list(at)
            files[row[side]] = png(part)
        names.append(row)
        origins.append(origin)
    return {'kind': 'whole' if whole else 'crops', 'files': names, 'origins_px': origins}


def _crop(grey: NDArray[Any], quad_px: Array, margin: float
          ) -> tuple[NDArray[Any], tuple[int, int]]:
    """Return a crop around a front and its origin; the whole image where there is no front."""
    if not np.isfinite(quad_px).all():
        return grey, (0, 0)
    part = window(grey, quad_px, margin)
    if any(side.stop - side.start < 2 for side in part):
        return grey, (0, 0)
    return np.ascontiguousarray(grey[part]), (part[1].start, part[0].start)
