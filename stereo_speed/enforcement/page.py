# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One page on a record, readable by a judge, as self-contained HTML and PDF."""
from __future__ import annotations

from dataclasses import dataclass
from html import escape
import io
from typing import Any, Mapping, Optional, Sequence

from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import getSampleStyleSheet
from reportlab.lib.units import mm
from reportlab.lib.utils import ImageReader
from reportlab.platypus import (
    Flowable, Image, Paragraph, SimpleDocTemplate, Spacer, Table, TableStyle)

from ..core.units import SpeedUnit
from ..report.page import page_html as report_html, Picture, Section

_TITLE = 'Record of a speed above the limit'
_COUNTS = ('The speed that counts is the considered speed: the measured speed less its tolerance, '
           'rounded down. ')
NOTE = _COUNTS + (
    'The pictures show the vehicle, marked by a frame, at different instants. The unmarked '
    'originals, all figures and the images from which the speed can be measured again are stored '
    'beside this page and covered by the seal of the record.')
DISCLOSED_NOTE = _COUNTS + (
    'This is a copy for disclosure: the pictures show the vehicle at different instants, and '
    'everything else in them is blurred. The record that it was made from contains the originals '
    'and is covered by the seal beside this page.')


@dataclass(frozen=True)
class PageFacts:
    """
    The content of the page.

    :param record: content of ``record.json``.
    :param marked: JPEG files of the marked left views, and the last right one.
    :param close_up: a JPEG file.
    :param plot: a PNG file.
    :param note: explanation of the speeds and the pictures for the reader.
    """

    record: Mapping[str, Any]
    marked: Sequence[bytes]
    close_up: bytes
    plot: bytes
    note: str = NOTE

    def captions(self) -> list[str]:
        """Return the caption of each marked view."""
        stamps = [picture['stamp_ns'] for picture in self.record['pictures']]
        first = stamps[0]
        texts = [f'left camera, {(ns - first) * 1e-9:.3f} s after the first picture'
                 for ns in stamps]
        return [*texts, f'right camera, {(stamps[-1] - first) * 1e-9:.3f} s after the first '
                        'picture']


def speeds(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the three figures of a decision, with their names."""
    s = record['speed']
    return [('measured', f'{s["measured"]} {s["unit"]}'),
            ('considered', f'{s["considered"]} {s["unit"]}'),
            ('limit', f'{s["limit"]:.4g} {s["unit"]}')]


def rows(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the page's table: name and value."""
    s, place, instrument = record['speed'], record['place'], record['instrument']
    unit = SpeedUnit(s['unit']).mps
    lane = place['lane'] if place['lane'] == place['lane_to'] else \
        f'{place["lane"]} to {place["lane_to"]}'
    second = s['second']
    estimates = f'{s["measured_mps"] / unit:.2f} ± {s["measured_std_mps"] / unit:.2f} {s["unit"]}'
    clock = record['time']['clock']
    approved = {'yes': 'as approved', 'not asked': 'approved fingerprints not given',
                'no': 'NOT as approved: ' + ', '.join(instrument['not_approved'])}
    return [
        ('record', f'{record["id"]}, number {record["number"]}'),
        ('time (UTC)', f'{record["time"]["first_utc"]} to {record["time"]["last_utc"]}'),
        ('clock', f'{record["time"]["source"]}; ' + (
            'state unknown' if clock is None else
            ', '.join(f'{key}: {value}' for key, value in clock.items()))),
        ('place', f'{place["place"]}; site {place["site"]}, {lane}'),
        ('direction', record['direction']),
        ('first estimate', f'{estimates} (1 sigma), {s["first"]["pairs"]} pairs'),
        ('second estimate', 'none' if second is None or second['speed_mps'] is None else
         f'{second["speed_mps"] / unit:.2f} ± {(second["speed_std_mps"] or 0) / unit:.2f} '
         f'{s["unit"]}, {second["pairs"]} pairs'),
        ('tolerance, margin', f'{s["tolerance_mps"] / unit:.2f} and {s["margin_mps"] / unit:.2f} '
         f'{s["unit"]}'),
        ('vehicle', f'{_class(record["vehicle"])}track {record["track"]}, '
         f'front {record["vehicle"]["front_width_m"]:.2f} m '
         f'wide; {len(record["vehicle"]["others"])} other vehicles in view, none near it'),
        ('instrument', f'{instrument["name"]}; stereo_speed '
         f'{instrument["versions"]["stereo_speed"]}; {approved[instrument["approved"]]}'),
        ('calibrated', instrument['calibrated'] or 'date unknown'),
        ('self-test', _self_test(instrument.get('self_test'))),
        *((f'fingerprint, {kind}', value)
          for kind, value in sorted(instrument['fingerprints'].items()))]


def _self_test(passed: Optional[Mapping[str, Any]]) -> str:
    """Return when the last self-test was passed, and its error."""
    if passed is None:
        return 'none required'
    off = passed['off_percent']
    return f'passed {passed["passed_utc"]}' + ('' if off is None else f', {off:+.2f} % off')


def _class(vehicle: Mapping[str, Any]) -> str:
    """Return the class of a vehicle and a comma; empty where it is unknown."""
    if vehicle['class'] in (None, 'unknown'):
        return ''
    return f'{vehicle["class"].replace("_", " ")} ({100 * vehicle["class_probability"]:.0f} %), '


def page_html(facts: PageFacts) -> bytes:
    """Return the page as one self-contained HTML file."""
    names, values = zip(*speeds(facts.record))
    pictures = [Picture('close-up', facts.close_up, 'jpeg'), *(
        Picture(text, data, 'jpeg') for text, data in zip(facts.captions(), facts.marked)),
        Picture('speed over the pass', facts.plot)]
    return report_html(f'{_TITLE} {facts.record["id"]}', [
        Section('Speeds', text=[facts.note], columns=names, rows=[values],
                large=True),
        Section('Figures', columns=('', ''), rows=rows(facts.record)),
        Section('Pictures', pictures=pictures)]).encode()


def page_pdf(facts: PageFacts) -> bytes:
    """Return the page as a PDF file; the same facts give the same bytes."""
    styles, out = getSampleStyleSheet(), io.BytesIO()
    small = styles['BodyText'].clone('small', fontSize=8, leading=9.5)
    figures = speeds(facts.record)
    boxes = Table([[name for name, _ in figures], [value for _, value in figures]],
                  colWidths=58 * mm, style=TableStyle([
                      ('ALIGN', (0, 0), (-1, -1), 'CENTER'),
                      ('BOX', (0, 0), (-1, -1), 0.6, colors.grey),
                      ('INNERGRID', (0, 0), (-1, -1), 0.3, colors.lightgrey),
                      ('FONTSIZE', (0, 1), (-1, 1), 18), ('BOTTOMPADDING', (0, 1), (-1, 1), 10)]))
    table = Table([[Paragraph(escape(name), small), Paragraph(escape(value), small)]
                   for name, value in rows(facts.record)], colWidths=(34 * mm, 140 * mm),
                  style=TableStyle([('LINEABOVE', (0, 0), (-1, -1), 0.3, colors.lightgrey),
                                    ('VALIGN', (0, 0), (-1, -1), 'TOP'),
                                    ('TOPPADDING', (0, 0), (-1, -1), 1),
                                    ('BOTTOMPADDING', (0, 0), (-1, -1), 1)]))
    pictures = [[_fitted(data, 86 * mm), Paragraph(escape(text), small)]
                for text, data in zip(facts.captions(), facts.marked)]
    pictures.append([_fitted(facts.close_up, 60 * mm), Paragraph('close-up', small)])
    cells = [pictures[k:k + 2] for k in range(0, len(pictures), 2)]
    parts: list[Flowable] = [
        Paragraph(_TITLE, styles['Title']), boxes, Spacer(1, 3 * mm),
        Paragraph(escape(facts.note), small),
        Spacer(1, 2 * mm), table, Spacer(1, 3 * mm),
        Table([[row[0], row[1] if len(row) > 1 else ''] for row in cells]),
        _fitted(facts.plot, 150 * mm)]
    SimpleDocTemplate(
        out, pagesize=A4, leftMargin=18 * mm, rightMargin=18 * mm, topMargin=12 * mm,
        bottomMargin=12 * mm, title=f'{_TITLE} {facts.record["id"]}', author='stereo_speed',
        invariant=1).build(parts)
    return out.getvalue()


def _fitted(data: bytes, width: float) -> Image:
    """Return a picture scaled to a width, in points."""
    across, down = ImageReader(io.BytesIO(data)).getSize()
    return Image(io.BytesIO(data), width=width, height=width * down / across)
