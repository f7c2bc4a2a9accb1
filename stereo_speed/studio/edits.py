# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Changes of a draft, as small steps that a page requests by name.

A step refers to items by their numbers, so that steps from two pages that draw at once combine.
"""
from __future__ import annotations

from dataclasses import replace
from datetime import date
from typing import Any, Callable, Iterable, Mapping, Optional, Protocol, TypeVar

import numpy as np

from .draft import (
    CORNERS, Draft, DraftFront, DraftLane, DraftLength, DraftLine, Drawn, ENDS, pixels_of,
    Point, VIEWS, with_view)
from ..core.errors import InputError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping

WHERE = 'page'  # source of a fault, in messages
MOST_POINTS, MOST_THINGS, MOST_TEXT = 2000, 200, 80
KINDS = ('between', 'dashes', 'points')
MOST_LENGTH_M = 1000.0
_LARGEST_PX = 1e5
_MOST_FRAME = 10**9

Thing = TypeVar('Thing', DraftLine, DraftLane, DraftLength, DraftFront)


class Snapper(Protocol):
    """Moves a point onto a marking nearby."""

    def __call__(self, view: str, at_px: Array, way: Optional[Array]) -> Optional[Point]:
        """Return the moved point; None where there is no marking."""


class Step(StrictMapping):
    """
    One step as received from a page.

    :param data: its fields.
    :param known: allowed names of fields.
    """

    def __init__(self, data: object, known: Iterable[str]) -> None:
        super().__init__(WHERE, '', data, tuple(known))

    def line_text(self, key: str) -> str:
        """Return a text as one line; refuse one that is too long or not printable."""
        text = ' '.join(self.text(key).split())
        if len(text) > MOST_TEXT or not text.isprintable():
            raise self.error(key, repr(text[:MOST_TEXT]), f'at most {MOST_TEXT} printed letters')
        return text

    def pixel(self, key: str = 'at') -> Array:
        """Return the raw pixel, (2,), in a field."""
        value = self.data.get(key)
        if not isinstance(value, list) or len(value) != 2:
            raise self.error(key, repr(value), 'a pixel [u, v]')
        at = {'u': value[0], 'v': value[1]}
        inner = StrictMapping(WHERE, key, at, ('u', 'v'))
        return np.array([inner.number(axis, -_LARGEST_PX, _LARGEST_PX, 'px') for axis in at])

    def flag(self, key: str) -> bool:
        """Return a boolean field; False where it is missing."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, repr(value), 'true or false')
        return value

    def line_or_none(self, key: str, draft: Draft) -> Optional[int]:
        """Return the number of an existing line; None where the field is empty."""
        value = self.data.get(key)
        if value is None:
            return None
        return found(draft.lines, self.integer(key), 'line').number


def found(things: Iterable[Thing], number: int, what: str) -> Thing:
    """Return the item with a number."""
    for thing in things:
        if thing.number == number:
            return thing
    raise InputError(WHERE, what, f'number {number}', f'a {what} of this site')


def replaced(things: tuple[Thing, ...], thing: Thing) -> tuple[Thing, ...]:
    """Return items with one of them replaced."""
    return tuple(thing if other.number == thing.number else other for other in things)


def place_for(points: tuple[Point, ...], at: Array) -> int:
    """
    Return the index at which a new point belongs: between two points, or at an end.

    :param points: points of the line, in order.
    :param at: (2,), the new point.
    """
    uv = pixels_of(points)
    if len(uv) < 2:
        return len(uv)
    way = np.diff(uv, axis=0)
    share = np.sum((at - uv[:-1]) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-12)
    gap = np.linalg.norm(at - uv[:-1] - np.clip(share, 0, 1)[:, None] * way, axis=1)
    nearest = int(np.argmin(gap))
    if nearest == 0 and share[0] < 0:
        return 0
    if nearest == len(way) - 1 and share[-1] > 1:
        return len(uv)
    return nearest + 1


def way_at(points: tuple[Point, ...], index: int) -> Optional[Array]:
    """Return the direction (2,) of a line at one of its points; None for a single one."""
    uv = pixels_of(points)
    if len(uv) < 2:
        return None
    return np.asarray(uv[min(index + 1, len(uv) - 1)] - uv[max(index - 1, 0)])


def apply(draft: Draft, name: str, data: object, snapper: Snapper) -> Draft:
    """
    Return a draft after one step.

    :param draft: the draft before the step.
    :param name: name of the step, one of :data:`STEPS`.
    :param data: its fields.
    :param snapper: snaps points, where the step asks for it.
    :raises InputError: the step is not possible.
    """
    if name not in STEPS:
        raise InputError(WHERE, 'step', repr(name), 'one of ' + ', '.join(STEPS))
    fields, step = STEPS[name]
    return step(draft, Step(data, fields), snapper)


# -- lines --------------------------------------------------------------------------------------


def _free_name(names: Iterable[str], stem: str) -> str:
    """Return an unused name with a stem."""
    taken = set(names)
    return next(f'{stem}_{n}' for n in range(len(taken) + 1) if f'{stem}_{n}' not in taken)


def _room(things: tuple[Thing, ...], what: str) -> None:
    if len(things) >= MOST_THINGS:
        raise InputError(WHERE, what, f'{len(things)} already', f'at most {MOST_THINGS}')


def _add_line(draft: Draft, step: Step, _: Snapper) -> Draft:
    _room(draft.lines, 'lines')
    name = step.line_text('name') if 'name' in step else _free_name(
        (line.name for line in draft.lines), 'line')
    _refuse_twice(name, (line.name for line in draft.lines), 'name')
    return replace(draft, lines=(*draft.lines, DraftLine(draft.next_id, name)),
                   next_id=draft.next_id + 1)


def _refuse_twice(name: str, others: Iterable[str], what: str) -> None:
    if name in others:
        raise InputError(WHERE, what, f'{name} twice', 'a name of its own')


def _rename_line(draft: Draft, step: Step, _: Snapper) -> Draft:
    line, name = found(draft.lines, step.integer('line'), 'line'), step.line_text('name')
    _refuse_twice(name, (o.name for o in draft.lines if o.number != line.number), 'name')
    return replace(draft, lines=replaced(draft.lines, replace(line, name=name)))


def _delete_line(draft: Draft, step: Step, _: Snapper) -> Draft:
    gone = found(draft.lines, step.integer('line'), 'line').number

    def kept(number: Optional[int]) -> Optional[int]:
        return None if number == gone else number
    return replace(
        draft, lines=tuple(line for line in draft.lines if line.number != gone),
        lanes=tuple(replace(lane, right=kept(lane.right), left=kept(lane.left),
                            path=kept(lane.path)) for lane in draft.lanes),
        lengths=tuple(replace(known, lines=tuple(n for n in known.lines if n != gone))
                      for known in draft.lengths))


def _turn_line(draft: Draft, step: Step, _: Snapper) -> Draft:
    line = found(draft.lines, step.integer('line'), 'line')
    turned = replace(line, left=line.left[::-1], right=line.right[::-1],
                     points_m=line.points_m[::-1])
    return replace(draft, lines=replaced(draft.lines, turned))


def _drawn(draft: Draft, step: Step) -> tuple[DraftLine, str]:
    """Return the line and the view of a step that changes a point."""
    line = found(draft.lines, step.integer('line'), 'line')
    if line.points_m:
        raise InputError(WHERE, 'line', f'{line.name}, which is surveyed', 'a line that is drawn')
    return line, step.choice('view', VIEWS)


def _redrawn(draft: Draft, line: DraftLine, view: str, points: Iterable[Point]) -> Draft:
    """Return a draft with other points in one view of a line."""
    return replace(draft, lines=replaced(draft.lines, with_view(line, view, points)))


def _placed(points: tuple[Point, ...], index: int, step: Step, view: str, snapper: Snapper
            ) -> tuple[Point, ...]:
    """Return points with one moved to the step's pixel, snapped if requested."""
    at = step.pixel()
    moved = Point(*at.tolist())
    points = (*points[:index], moved, *points[index + 1:])
    if step.flag('snap'):
        point = snapper(view, at, way_at(points, index))
        if point is not None:
            points = (*points[:index], point, *points[index + 1:])
    return points


def _add_point(draft: Draft, step: Step, snapper: Snapper) -> Draft:
    line, view = _drawn(draft, step)
    points = line.view(view)
    if len(points) >= MOST_POINTS:
        raise step.error('line', f'{len(points)} points', f'at most {MOST_POINTS}')
    at = step.pixel()
    index = place_for(points, at)
    points = (*points[:index], Point(*at.tolist()), *points[index:])
    return _redrawn(draft, line, view, _placed(points, index, step, view, snapper))


def _index(step: Step, points: tuple[Point, ...]) -> int:
    index = step.integer('index')
    if index >= len(points):
        raise step.error('index', index, f'below {len(points)}')
    return index


def _move_point(draft: Draft, step: Step, snapper: Snapper) -> Draft:
    line, view = _drawn(draft, step)
    points = line.view(view)
    return _redrawn(draft, line, view,
                    _placed(points, _index(step, points), step, view, snapper))


def _delete_point(draft: Draft, step: Step, _: Snapper) -> Draft:
    line, view = _drawn(draft, step)
    points, index = line.view(view), _index(step, line.view(view))
    return _redrawn(draft, line, view, points[:index] + points[index + 1:])


def _snap_line(draft: Draft, step: Step, snapper: Snapper) -> Draft:
    """Snap all points of a line in both views."""
    line = found(draft.lines, step.integer('line'), 'line')
    for view in VIEWS:
        points = line.view(view)
        line = with_view(line, view, (
            snapper(view, pixels_of([point])[0], way_at(points, index)) or point
            for index, point in enumerate(points)))
    return replace(draft, lines=replaced(draft.lines, line))


# -- lanes --------------------------------------------------------------------------------------


def _add_lane(draft: Draft, step: Step, _: Snapper) -> Draft:
    _room(draft.lanes, 'lanes')
    name = _free_name((lane.name for lane in draft.lanes), 'lane')
    lane = DraftLane(draft.next_id, name, step.line_or_none('right', draft),
                     step.line_or_none('left', draft), backward=step.flag('backward'))
    if draft.lanes:
        lane = replace(lane, speed_limit=draft.lanes[-1].speed_limit)
    return replace(draft, lanes=(*draft.lanes, lane), next_id=draft.next_id + 1)


def _set_lane(draft: Draft, step: Step, _: Snapper) -> Draft:
    lane = found(draft.lanes, step.integer('lane'), 'lane')
    if 'name' in step:
        name = step.line_text('name')
        _refuse_twice(name, (o.name for o in draft.lanes if o.number != lane.number), 'name')
        lane = replace(lane, name=name)
    if 'speed_limit' in step:
        step.speed('speed_limit')
        lane = replace(lane, speed_limit=step.line_text('speed_limit'))
    if 'backward' in step:
        lane = replace(lane, backward=step.flag('backward'))
    lines: dict[str, Any] = {key: step.line_or_none(key, draft)
                             for key in ('right', 'left', 'path') if key in step}
    lane = replace(lane, **lines)
    if lane.path is not None and 'path' in step:
        lane = replace(lane, right=None, left=None)
    elif lane.right is not None or lane.left is not None:
        lane = replace(lane, path=None)
    return replace(draft, lanes=replaced(draft.lanes, lane))


def _delete_lane(draft: Draft, step: Step, _: Snapper) -> Draft:
    gone = found(draft.lanes, step.integer('lane'), 'lane').number
    return replace(draft, lanes=tuple(lane for lane in draft.lanes if lane.number != gone))


# -- known lengths ------------------------------------------------------------------------------


def _add_length(draft: Draft, step: Step, _: Snapper) -> Draft:
    _room(draft.lengths, 'known lengths')
    kind = step.choice('kind', KINDS)
    name = _free_name((known.name for known in draft.lengths), 'length')
    known = DraftLength(draft.next_id, name, 3.5, 0.05, kind)
    return replace(draft, lengths=(*draft.lengths, known), next_id=draft.next_id + 1)


def _set_length(draft: Draft, step: Step, _: Snapper) -> Draft:
    known = found(draft.lengths, step.integer('length'), 'known length')
    if 'name' in step:
        known = replace(known, name=step.line_text('name'))
    if 'length_m' in step:
        known = replace(known, length_m=step.number('length_m', 0.01, MOST_LENGTH_M, 'm'))
    if 'std_m' in step:
        known = replace(known, std_m=step.number('std_m', 1e-4, 10.0, 'm'))
    if 'lines' in step:
        numbers = [found(draft.lines, n, 'line').number for n in step.listed('lines')]
        if len(set(numbers)) < len(numbers) or len(numbers) > 2:
            raise step.error('lines', numbers, 'one line, or two')
        known = replace(known, lines=tuple(numbers))
    return replace(draft, lengths=replaced(draft.lengths, known))


def _length_point(draft: Draft, step: Step, _: Snapper) -> Draft:
    known = found(draft.lengths, step.integer('length'), 'known length')
    return replace(draft, lengths=replaced(draft.lengths, _with_one_of(known, ENDS, step)))


def _with_one_of(thing: Drawn, most: int, step: Step) -> Drawn:
    """Add a point to an item of up to ``most`` points per view, else move the nearest one."""
    view, at = step.choice('view', VIEWS), Point(*step.pixel().tolist())
    points: tuple[Point, ...] = thing.view(view)
    points = (*points, at) if len(points) < most else _nearest_moved(points, at)
    return with_view(thing, view, points)


def _nearest_moved(points: tuple[Point, ...], at: Point) -> tuple[Point, ...]:
    """Return points with the nearest one moved to a position."""
    gap = np.linalg.norm(pixels_of(points) - [at.u, at.v], axis=1)
    nearest = int(np.argmin(gap))
    return (*points[:nearest], at, *points[nearest + 1:])


def _delete_length(draft: Draft, step: Step, _: Snapper) -> Draft:
    gone = found(draft.lengths, step.integer('length'), 'known length').number
    return replace(draft, lengths=tuple(k for k in draft.lengths if k.number != gone))


# -- fronts of vehicles -------------------------------------------------------------------------


def _add_front(draft: Draft, step: Step, _: Snapper) -> Draft:
    _room(draft.fronts, 'vehicles')
    frame = step.integer('frame')
    if frame > _MOST_FRAME:
        raise step.error('frame', frame, f'at most {_MOST_FRAME}')
    of = None
    if step.data.get('of') is not None:
        first = found(draft.fronts, step.integer('of'), 'vehicle')
        of = first.number if first.of is None else first.of
    return replace(draft, fronts=(*draft.fronts, DraftFront(draft.next_id, frame, of=of)),
                   next_id=draft.next_id + 1)


def _front_corner(draft: Draft, step: Step, _: Snapper) -> Draft:
    """Add a corner, or move the nearest of the four."""
    front = found(draft.fronts, step.integer('front'), 'vehicle')
    return replace(draft, fronts=replaced(draft.fronts, _with_one_of(front, CORNERS, step)))


def _delete_front(draft: Draft, step: Step, _: Snapper) -> Draft:
    gone = found(draft.fronts, step.integer('front'), 'vehicle').number
    return replace(draft, fronts=tuple(f for f in draft.fronts if gone not in (f.number, f.of)))


def _rename_site(draft: Draft, step: Step, _: Snapper) -> Draft:
    return replace(draft, name=step.line_text('name'))


def _set_calibrated(draft: Draft, step: Step, _: Snapper) -> Draft:
    """Set the date of the rig's calibration; an empty one removes it."""
    if step.data.get('day') == '':
        return replace(draft, calibrated=None)
    text = step.line_text('day')
    try:
        return replace(draft, calibrated=date.fromisoformat(text).isoformat())
    except ValueError:
        raise step.error('day', repr(text), 'a day such as 2026-05-31') from None


Taken = Callable[[Draft, Step, Snapper], Draft]
STEPS: Mapping[str, tuple[tuple[str, ...], Taken]] = {
    'rename_site': (('name',), _rename_site),
    'set_calibrated': (('day',), _set_calibrated),
    'add_line': (('name',), _add_line),
    'rename_line': (('line', 'name'), _rename_line),
    'delete_line': (('line',), _delete_line),
    'turn_line': (('line',), _turn_line),
    'snap_line': (('line',), _snap_line),
    'add_point': (('line', 'view', 'at', 'snap'), _add_point),
    'move_point': (('line', 'view', 'index', 'at', 'snap'), _move_point),
    'delete_point': (('line', 'view', 'index'), _delete_point),
    'add_lane': (('right', 'left', 'backward'), _add_lane),
    'set_lane': (('lane', 'name', 'right', 'left', 'path', 'speed_limit', 'backward'),
                 _set_lane),
    'delete_lane': (('lane',), _delete_lane),
    'add_length': (('kind',), _add_length),
    'set_length': (('length', 'name', 'length_m', 'std_m', 'lines'), _set_length),
    'length_point': (('length', 'view', 'at'), _length_point),
    'delete_length': (('length',), _delete_length),
    'add_front': (('frame', 'of'), _add_front),
    'front_corner': (('front', 'view', 'at'), _front_corner),
    'delete_front': (('front',), _delete_front),
}


def no_snap(view: str, at_px: Array, way: Optional[Array]) -> Optional[Point]:
    """Return None: without an image there is nothing to snap to."""
    return None


def fields_of(step: Mapping[str, Any]) -> tuple[str, str, dict[str, Any]]:
    """
    Return identity, name and fields of a step as received from a page.

    :raises InputError: it is no step.
    """
    outer = StrictMapping(WHERE, 'step', step, ('id', 'name', 'fields'))
    inner = step.get('fields', {})
    if not isinstance(inner, dict):
        raise outer.error('fields', repr(inner), 'a mapping')
    return outer.text('id'), outer.text('name'), inner
