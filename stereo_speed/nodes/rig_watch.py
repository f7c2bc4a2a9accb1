# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Checks the live rig against its site, at start and at intervals, in a process of its own.

A look compares lines and background of some pairs with the site, as refining a site does. If the
rig has moved so that speeds certainly change by more than the self-test allows, or the right
camera has certainly turned, nothing is measured and ``/diagnostics`` has an ERROR. The rig is then
looked at again at once. If two looks in a row find the same stance, measuring continues with that
stance; if a later look finds the rig right again, it continues as before. A look without a result
changes nothing. A failed look is repeated after a minute.
"""
from __future__ import annotations

from functools import partial
import threading
import time
from typing import Any, Callable, Optional

from .common import Parameters
from .health import ERROR, State, WARN
from ..core.records import RigMotion, StereoPair
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import SiteConfig
from ..pipeline.look_process import LookProcess
from ..site.refine.rig_state import MOST_SHARE, RigState, Stance

# Time after which a look has failed: it must hang, as a tenth of a core suffices in minutes.
_LONGEST_S = 1800.0
_AGAIN_S = 60.0  # time until a failed look is repeated


class RigWatch:
    """
    Gathers pairs for looks at the rig, and decides whether the node may measure.

    :param p: declares the parameters.
    :param log: logger of the node.
    :param make: starts the process of a look; may raise OSError.  None starts one of the niceness
        that the parameters say.
    :param clock: steady time, s.
    """

    def __init__(self, p: Parameters, log: Any, make: Optional[Callable[[], LookProcess]] = None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.interval_s = p.get(
            'rig_check_interval_s', 600.0, 'interval of checks of lines and background, the first '
            'at start [s]; if the rig has certainly moved so that speeds are off by more than '
            f'{100 * MOST_SHARE:g} %, or the right camera has certainly turned, nothing is '
            'measured until two checks find the same stance, which is then used; 0 for never',
            0.0, 1e6)
        self.pairs = p.get('rig_check_pairs', 9, 'number of pairs that such a check uses', 1, 100)
        self.spread_s = p.get('rig_check_spread_s', 20.0, 'time over which these pairs are '
                              'spread [s]', 0.0, 3600.0)
        patience = p.get(
            'rig_check_niceness', 10, 'niceness of the process of such a check, relative to the '
            'node: at 10 it leaves nine tenths of a fully used core to measuring, at 0 it does '
            'not give way', 0, 19)
        self._make = partial(LookProcess, patience) if make is None else make
        self.log, self._clock = log, clock
        self.newest: Optional[RigState] = None
        self.looks, self.failure, self.corrected = 0, '', ''
        self._used: Optional[Stance] = None
        self._suspected: Optional[Stance] = None  # stance found by the newest look, if it is off
        self._correction: Optional[Stance] = None
        self._config = SiteConfig()
        self._due_s = self._next_s = self._begun_s = 0.0
        self._lock = threading.RLock()
        self._process: Optional[LookProcess] = None  # process of the look under way
        self._gathered, self._ready, self._asked = 0, False, False
        self._followed: Optional[RigMotion] = None

    @property
    def withholds(self) -> bool:
        """Return whether nothing may be measured, because the rig has moved."""
        return self.newest is not None and self.newest.is_off

    def begin(self, place: MeasuringSite, config: SiteConfig, corrected: str = '') -> None:
        """
        Start with a new site or rig.

        :param place: the site that is measured at from now on.
        :param config: priors of roads, and how lines are found.
        :param corrected: what was wrong with the site as read; empty if nothing was.
        """
        self.close()
        self._used = Stance(place.site, place.rig, dict(place.lanes))
        self._config, self.newest, self.corrected = config, None, corrected
        self._suspected = self._correction = None
        self._due_s = self._next_s = 0.0

    def pop_correction(self) -> Optional[Stance]:
        """Return, once, the stance that two looks have confirmed; None if there is none."""
        correction, self._correction = self._correction, None
        return correction

    def take(self, pair: StereoPair, followed: Optional[RigMotion] = None) -> None:
        """
        Process the next pair, and begin a look that is due.

        :param pair: the pair as received.
        :param followed: rotation of the rig that measuring already follows and allows for.
        """
        if not self.interval_s or self._used is None:
            return
        with self._lock:
            try:
                self._go_on(pair, followed)
            except Exception as error:  # any error of the other process
                self._failed(error)

    def _go_on(self, pair: StereoPair, followed: Optional[RigMotion]) -> None:
        """
        Begin a look if one is due, give it the pair if it needs one, and advance it.

        :raises OSError: its process has ended, or cannot be started.
        :raises LookProcessError: the look has failed.
        """
        now_s, self._followed = self._clock(), followed
        if self._gathered < self.pairs and now_s >= max(self._due_s, self._next_s):
            if self._process is None:
                self._process, self._begun_s = self._make(), now_s
            self._process.lay(pair)
            self._gathered += 1
            self._next_s = now_s + self.spread_s / max(self.pairs - 1, 1)
        self._advance(now_s)

    def _advance(self, now_s: float) -> None:
        """
        Start the look once its pairs and its process are ready, and collect its result.

        :raises OSError: its process has ended.
        :raises LookProcessError: the look has failed.
        """
        process = self._process
        if process is None or self._gathered < self.pairs or self._used is None:
            return
        if self._asked:
            found = process.found()
            if found is not None:
                self.failure = ''
                self._learn(found)
                self._end(self.interval_s)
            elif now_s - self._begun_s > _LONGEST_S:
                raise TimeoutError(f'not finished within {_LONGEST_S:g} s')
            return
        self._ready = self._ready or process.is_ready()
        if self._ready:
            process.look(self._used, self._config, self._followed, self._suspected)
            self._asked, self._begun_s = True, now_s
        elif now_s - self._begun_s > self.spread_s + _LONGEST_S:
            raise TimeoutError(f'its process was not ready within {_LONGEST_S:g} s')

    def poll(self) -> None:
        """
        Advance a look that needs no further pair; any thread may call this.

        The stream may have ended before the process of the look was ready.
        """
        with self._lock:
            try:
                self._advance(self._clock())
            except Exception as error:  # any error of the other process
                self._failed(error)

    def _failed(self, error: Exception) -> None:
        self.failure = f'the check of the rig failed: {error}'
        self.log.error(self.failure)
        self._end(min(_AGAIN_S, self.interval_s))

    def _end(self, wait_s: float) -> None:
        """End a look, and set when the next one is due."""
        self.close()
        # a rig that is off is looked at again at once
        self._due_s = self._clock() + (0.0 if self.withholds else wait_s)

    def _learn(self, found: RigState) -> None:
        """Register the result of a look."""
        self.looks += 1
        if self.withholds and not found.is_off and found.stance is None:
            self.log.info(found.text)  # not conclusive: the rig may still be off
            return
        self.newest = found
        self._suspected = found.stance if found.is_off else None
        self._correction = self._suspected if found.confirmed else None
        if found.is_off:  # rclpy refuses another severity from the same place
            self.log.error(found.text)
        else:
            self.log.info(found.text)

    def close(self) -> None:
        """Abort a look that is under way."""
        with self._lock:
            process, self._process = self._process, None
            self._gathered, self._ready, self._asked = 0, False, False
        if process is not None:  # in a thread, as its low priority may delay its end
            threading.Thread(target=process.close, args=(0.0,), name='ends a look',
                             daemon=True).start()

    def state(self) -> State:
        """Return the state of the rig for ``/diagnostics``."""
        self.poll()
        fine = 'checks of the rig are disabled'
        if self.interval_s:
            fine = 'not checked yet' if self.newest is None else self.newest.text
        state = State(fine, values={'looks': self.looks})
        if self.withholds and self.newest is not None:
            state.find(ERROR, f'{self.newest.text}: nothing is measured')
        elif self.failure:
            state.find(WARN, self.failure)
        if self.corrected:
            state.find(WARN, 'measuring with the rig as two checks found it, not as in the site '
                       f'file; refine the site: {self.corrected}')
        return state
