# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Check whether a rig still stands as it is assumed to stand in measurements.

The lines of the road and the background are searched again, as in the refinement of a site. A
movement is assessed by its effect on speeds. One look may be wrong; a state that two looks agree
on may be used for measuring.
"""
from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
import math
from typing import Iterable, Mapping, Optional, Sequence, Union

import numpy as np

from .clicked import unlike_rotation_px
from .config import RefineConfig
from .refiner import refine_site, RefinedSite
from .speed_effect import lane_speed_std, Setup, speed_error
from ..file import PickedLine, Site
from ...core.errors import SiteError
from ...core.records import RigMotion, StereoPair
from ...geometry.rig import StereoRig
from ...road.fitted import RoadFit
from ...road.lanes import LanePath
from ...road.problem import RoadPrior

MOST_SHARE = 0.01  # largest relative error of speeds that a self-test allows
_NO_LIMIT = 100.0  # sigmas that disable the comparison of found lines with their clicks
_FAR_PX = 50.0  # how far lines are searched for that are not all where they were
_TELLING_LINES = 3  # fewest lines that tell by what rotation they have moved
# Distance from there within which most points of the lines must be.  A rotation, to first order,
# is good to some tenths of a pixel; another line beside one of them is many pixels off.
_TOGETHER_PX, _MOST_LINES = 2.0, 0.8
_SIGNIFICANT_SIGMAS = 4.0  # sigmas of the speed error from which a rotated camera counts
_EXCESS_SIGMAS = 3.0  # sigmas by which an error must exceed the limit


@dataclass(frozen=True, eq=False)
class Stance:
    """
    The pose of a rig relative to its road.

    :param site: the lines, and the rotation of the right camera since its calibration.
    :param rig: the rig with that rotation applied.
    :param lanes: paths of the lanes, by name.
    """

    site: Site
    rig: StereoRig
    lanes: Mapping[str, LanePath]


@dataclass(frozen=True)
class RigState:
    """
    The state of a rig, compared with the stance that is measured with.

    :param share: largest relative error of speeds by the movement, over the visible lanes; None if
        the images do not show it.
    :param lane: name of the lane with that error; empty if unknown.
    :param text: short description of the result.
    :param std_share: relative 1-sigma of that error, by the uncertainty of both stances.
    :param turned: whether the right camera was found to have rotated.
    :param stance: stance that the images show; None if they do not show all of it well.
    :param confirmed: whether this agrees with the stance of an earlier look.
    """

    share: Optional[float]
    lane: str
    text: str
    std_share: float = 0.0
    turned: bool = False
    stance: Optional[Stance] = field(default=None, compare=False)
    confirmed: bool = False

    @property
    def is_off(self) -> bool:
        """
        Return whether speeds are significantly off; False if this is unknown.

        A rotated right camera counts whatever the size of the error, if that is significant; other
        movements must significantly exceed ``MOST_SHARE``.
        """
        if self.share is None:
            return False
        if self.turned and self.share > _SIGNIFICANT_SIGMAS * self.std_share:
            return True
        return not self.share <= MOST_SHARE + _EXCESS_SIGMAS * self.std_share


def rig_state(used: Stance, pairs: Iterable[StereoPair], config: RefineConfig = RefineConfig(),
              prior: RoadPrior = RoadPrior(), followed: Optional[RigMotion] = None,
              suspected: Optional[Stance] = None) -> RigState:
    """
    Return the state of a rig, compared with the stance that is measured with.

    :param used: stance that is measured with.
    :param pairs: pairs spread over some time, in which the rig does not sway.
    :param config: parameters of the refinement.
    :param prior: prior knowledge of any road and rig.
    :param followed: rotation of the rig since, which the measurement already accounts for.
    :param suspected: stance found by an earlier look; None if there was none.
    """
    try:
        refined = _refined(used, list(pairs), config, prior)
    except SiteError as error:
        return RigState(None, '', f'pose of the rig unknown: {error}')
    if refined.kept_clicks:
        return RigState(math.inf, '', f'the rig or the lines have moved: {refined.kept_clicks}')
    if not refined.found:
        return RigState(None, '', 'pose of the rig unknown: no line is visible')
    stance = Stance(refined.site, refined.rig, refined.lanes)
    state = _compared(stance, replace(used, rig=used.rig.as_taken(followed)), refined.drift.moved)
    repeated = None if suspected is None else _compared(stance, suspected, refined.drift.moved)
    return replace(state, confirmed=repeated is not None and repeated.share is not None
                   and repeated.share <= MOST_SHARE)


def _refined(used: Stance, pairs: Sequence[StereoPair], config: RefineConfig, prior: RoadPrior
             ) -> RefinedSite:
    """
    Return the site as the images show it, near the lines of a stance or, if it is not, beyond.

    Of a rig that has turned by more than lines are searched for, other things are found near
    some of the lines. If one rotation has taken all lines to where they are visible elsewhere,
    that is where they are; in the dark, or where a line is worn, something else is beside it.
    Two straight lines do not tell, as a rotation can take each of them anywhere.

    :raises SiteError: what is found near the lines gives no road.
    """
    # Lines beside their clicks must not be dropped here, as they may show that the rig has moved.
    tolerant = replace(config, clicked_sigmas=_NO_LIMIT, disagreement_sigmas=_NO_LIMIT,
                       disagreement_factor=_NO_LIMIT)
    near: Union[RefinedSite, SiteError]
    try:
        near = refine_site(used.site, used.rig, pairs, tolerant, prior)
    except SiteError as error:
        near = error
    picked = used.site.picked
    # Lines that refining the site has not found are not expected to be seen now.
    expected = {n for n, line in picked.items() if line.views_std_px is not None} or set(picked)
    in_place = set() if isinstance(near, SiteError) else set(near.found)
    if len(expected) >= _TELLING_LINES and expected - in_place:
        with suppress(SiteError, np.linalg.LinAlgError):
            far = refine_site(used.site, used.rig, pairs,
                              replace(tolerant, search_px=_FAR_PX), prior)
            if not expected - set(far.found) and far.road is not None \
                    and moved_together(far.road, picked):
                return far
    if isinstance(near, SiteError):
        raise near
    return near


def moved_together(road: RoadFit, before: Mapping[str, PickedLine]) -> bool:
    """
    Return whether one rotation of the rig explains where all lines of a road are now.

    :param road: road fitted to the lines as found.
    :param before: the lines where they were, by name.
    """
    off_px = np.abs(unlike_rotation_px(
        road, {name: before[name].views_px for name in road.names if name in before}))
    return bool(np.isfinite(off_px).any() and np.nanquantile(off_px, _MOST_LINES) < _TOGETHER_PX)


def _compared(now: Stance, used: Stance, turned: bool) -> RigState:
    """
    Return the state by the difference of speeds between two stances.

    :param now: stance as found now.
    :param used: stance as assumed.
    :param turned: whether the right camera has rotated since its calibration.
    """
    changes = {name: speed_error(Setup(now.lanes[name].path, now.rig), Setup(lane.path, used.rig))
               for name, lane in used.lanes.items() if name in now.lanes}
    known = {name: abs(change) for name, change in changes.items() if np.isfinite(change)}
    if not known:
        return RigState(math.inf, '', 'the road is out of view: the rig has moved')
    lane = max(known, key=lambda name: known[name])
    worst_std = max(lane_speed_std(now.lanes[name], now.rig) for name in known)
    std = math.hypot(worst_std, lane_speed_std(used.lanes[lane], used.rig))
    text = (f'the present pose of rig and lines changes speeds on {lane} '
            f'by {100 * known[lane]:.2f} ± {100 * std:.2f} %')
    hidden = [name for name in used.lanes if name not in known]
    return RigState(known[lane], lane, text + (
        f'; unknown for lanes out of view: {", ".join(hidden)}' if hidden else ''),
        std, turned, None if hidden or worst_std > MOST_SHARE else now)
