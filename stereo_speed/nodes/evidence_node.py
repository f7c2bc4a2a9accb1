# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``evidence_node``: raw images and finished passes in, records of violations out.

Images are kept as received, for a limited time. When a pass has ended and its images have come,
the node decides whether it is a violation; a thread of its own writes the record, so that no image
is missed meanwhile.
"""
from __future__ import annotations

from collections import Counter, deque, OrderedDict
from dataclasses import dataclass, replace
from functools import partial
import json
from pathlib import Path
import threading
from typing import Any, Optional

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String

from .common import (
    LAST_S, LATCHED, latched_options, Parameters, receive_last, run, stamp_ns)
from .diagnostics import Diagnostics
from .health import ERROR, State, WARN
from .subscriptions import image_kind, OfferedSubscription
from ..core.errors import InputError, StereoSpeedError
from ..core.passes import PassResult
from ..enforcement.chain import load_private_key
from ..enforcement.clock import clock_state
from ..enforcement.config import EnforcementConfig
from ..enforcement.decision import NoRecord
from ..enforcement.fingerprint import Approved, load_approved
from ..enforcement.instrument import Instrument
from ..enforcement.recompute import read_json
from ..enforcement.record import Setting, Violation, violation_text
from ..enforcement.recorder import EvidenceRecorder
from ..enforcement.ring import ImageRing
from ..enforcement.store import EvidenceStore, Stored
from ..enforcement.verify import RECORD_FILE
from ..io.source_image import SourceImage
from ..io.topics import SIDES
from ..io.trace_json import result_of
from ..pipeline.assembly import MeasuringSite

_MOST_WAITING = 100  # greatest number of passes without a trace, and of traces without a pass
_MOST_VIOLATIONS = 20  # greatest number of unwritten violations, each with its images
_MOST_RUNS = 8  # number of latest runs of the measuring program whose passes are accepted
_POLL_S = 0.1
_RETENTION_S = 3600.0
# Longest wait for images that are received after their pass, as on a busy machine.  It is counted
# in looks, as nothing is received while the process stands still.
_IMAGES_S = 5.0
_STOP_S = 60.0  # longest time to write the last records when the node stops


@dataclass(eq=False)
class _Undecided:
    """
    A pass to decide on.

    :param recorder: decides on it.
    :param name: its id.
    :param result: the pass with its trace.
    :param looks: number of looks for its images that are left.
    """

    recorder: EvidenceRecorder
    name: str
    result: PassResult
    looks: int


class EvidenceNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('evidence_node')
        p = Parameters(self)
        where = f'{self.get_name()}: parameter'
        out = p.get('out', '', 'folder for the records')
        head = p.get('head', '', "file of the chain's head, preferably on another disk; "
                     'empty: beside the records')
        key = p.get('key', '', 'file of the private key (Ed25519, PEM) that signs records')
        approved = p.get('approved', '', 'file of approved fingerprints')
        kind, suffix = image_kind(p)
        self.config = p.config(EnforcementConfig)
        if not out:
            raise InputError(where, 'out', 'nothing', 'the folder for the records')
        self.approved = load_approved(approved) if approved else Approved()
        self.store = EvidenceStore(out, Path(head) if head else None,
                                   load_private_key(key) if key else None,
                                   self.config.evidence.least_free_mib)
        self.ring = ImageRing.of(self.config.evidence)
        self.images, self.last_ns = Counter[str](), 0
        self.counts: Counter[str] = Counter()
        self.wrong = ''  # why records cannot be written at present
        self.recorders: dict[str, EvidenceRecorder] = {}
        # id of a pass to its run and its message, and the same for its trace
        self.told: OrderedDict[str, tuple[str, str]] = OrderedDict()
        self.traced: OrderedDict[str, tuple[str, str]] = OrderedDict()
        self._undecided: deque[_Undecided] = deque()
        self._work: deque[tuple[EvidenceRecorder, Violation]] = deque()
        self._done: deque[tuple[Optional[Stored], str]] = deque()
        self._wake, self._stopping = threading.Condition(), False
        self._publish_and_subscribe(kind, suffix)
        self._writer = threading.Thread(target=self._write_all, name='records', daemon=True)
        self._writer.start()
        self.diagnostics = Diagnostics(self, {'evidence': self.state})

    def _publish_and_subscribe(self, kind: type, suffix: str) -> None:
        latched = {'qos_overriding_options': latched_options()}
        self.violations = self.create_publisher(String, 'violations', LATCHED, **latched)
        self._awaited = [
            self.create_subscription(String, topic, callback, LATCHED, **latched)
            for topic, callback in (('instrument', self.on_instrument), ('passes', self.on_pass),
                                    ('pass_traces', self.on_trace))]
        for side in SIDES:
            OfferedSubscription(self, kind, f'{side}/image_raw{suffix}',
                                partial(self.on_image, side))
        # Steady time, because simulated time stops with the images.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_POLL_S, self.tell, clock=steady)
        self.create_timer(_RETENTION_S, self.delete_older, clock=steady)

    # -- input ----------------------------------------------------------------------------

    def on_image(self, side: str, msg: Any) -> None:
        """Keep an image as received."""
        ns = stamp_ns(msg.header.stamp)
        self.images[side] += 1
        self.last_ns = max(self.last_ns, ns)
        self.ring.add(side, ns, SourceImage.from_message(msg))

    def on_instrument(self, msg: String) -> None:
        """Register the instrument that a measuring program describes."""
        try:
            instrument = Instrument.of_text(msg.data, 'instrument')
            setting = Setting(instrument, self._place(instrument), self.config, self.approved,
                              'header stamps')
            recorder = EvidenceRecorder(self.store, setting, self.ring, clock_state)
        except StereoSpeedError as error:
            self._refuse('bad_instrument', error)
            return
        if instrument.run in self.recorders:  # the run continues with another calibration
            recorder.refused = self.recorders[instrument.run].refused
        self.recorders[instrument.run] = recorder
        while len(self.recorders) > _MOST_RUNS:
            del self.recorders[next(iter(self.recorders))]
        unknown = self.approved.unknown(instrument.fingerprints)
        if unknown:
            self.get_logger().error(f'fingerprints not approved: {", ".join(unknown)}')
        self._join()

    def _place(self, instrument: Instrument) -> MeasuringSite:
        """Return the site that is measured at; another self-test does not change it."""
        known = self.recorders.get(instrument.run)
        if known is not None and known.setting.instrument == replace(
                instrument, self_test=known.setting.instrument.self_test):
            return known.setting.place
        return instrument.place('instrument')

    def on_pass(self, msg: String) -> None:
        """Register a finished pass; its trace may arrive before or after it."""
        self._keep(self.told, msg)

    def on_trace(self, msg: String) -> None:
        """Register the trace of a pass."""
        self._keep(self.traced, msg)

    def _keep(self, waiting: OrderedDict[str, tuple[str, str]], msg: String) -> None:
        try:
            data = json.loads(msg.data)
            waiting[str(data['id'])] = str(data['run']), msg.data
        except (ValueError, KeyError, TypeError) as error:
            self._refuse('bad_message', error)
            return
        while len(waiting) > _MOST_WAITING:
            waiting.popitem(last=False)
            self.counts['never_whole'] += 1
        self._join()

    def _join(self) -> None:
        """Take up each pass whose trace and instrument have arrived, and decide where possible."""
        for name in [n for n in self.told if n in self.traced]:
            recorder = self.recorders.get(self.traced[name][0])
            if recorder is not None:
                self._take_up(recorder, name, self.told.pop(name)[1], self.traced.pop(name)[1])
        self._decide_ready()

    def _take_up(self, recorder: EvidenceRecorder, name: str, told: str, traced: str) -> None:
        try:
            result = result_of(told, traced, 'passes')
        except StereoSpeedError as error:
            self._refuse('bad_message', error)
            return
        self._undecided.append(_Undecided(
            recorder, name, result, round(_IMAGES_S / _POLL_S)))

    def _decide_ready(self) -> None:
        """Decide on each pass whose images have come, or have been waited for long enough."""
        for one in list(self._undecided):
            if one.looks <= 0 or not one.recorder.awaits_images(one.result):
                self._undecided.remove(one)
                self._decide(one.recorder, one.name, one.result)

    def _decide(self, recorder: EvidenceRecorder, name: str, result: PassResult) -> None:
        violation = recorder.decide(name, result)
        self.counts['passes'] += 1
        if isinstance(violation, NoRecord):
            if violation not in (NoRecord.BELOW_LIMIT, NoRecord.NOT_MEASURED):
                self.get_logger().warning(f'{name}: no record: {violation}')
            return
        with self._wake:
            if len(self._work) < _MOST_VIOLATIONS:
                self._work.append((recorder, violation))
                self._wake.notify()
                return
        self._refuse('not_written_in_time',
                     f'{name}: {_MOST_VIOLATIONS} records are waiting already')

    # -- output ---------------------------------------------------------------------------

    def _write_all(self) -> None:
        """Write records, in a thread of its own, until the node stops and all are written."""
        while True:
            with self._wake:
                while not self._work and not self._stopping:
                    self._wake.wait()
                if not self._work:
                    return
                recorder, violation = self._work[0]
            try:
                self._done.append((recorder.write(violation), ''))
            except StereoSpeedError as error:
                self._done.append((None, str(error)))
            except Exception as error:  # any error of one record, as others are waiting
                self._done.append((None, repr(error)))
            with self._wake:
                self._work.popleft()

    def tell(self) -> None:
        """Decide on passes that have waited; publish the records written since, log errors."""
        for one in self._undecided:
            one.looks -= 1
        self._decide_ready()
        while self._done:
            stored, self.wrong = self._done.popleft()
            if self.wrong:
                self.get_logger().error(f'no record: {self.wrong}')
            elif stored is not None and stored.anew:
                record = read_json(stored.folder / RECORD_FILE)
                self.violations.publish(String(data=violation_text(
                    record, str(stored.folder), stored.seal.record_sha256)))
                self.get_logger().info(
                    f'violation: {record["speed"]["considered"]} {record["speed"]["unit"]} '
                    f'considered, limit {record["speed"]["limit"]:.4g}, in {stored.folder}')

    def delete_older(self) -> None:
        """Delete records whose retention time is over, by the stamps of the images."""
        for recorder in list(self.recorders.values())[-1:]:
            if self._work:
                return  # the writer uses the store; try again in an hour
            try:
                for name in recorder.delete_older(self.last_ns):
                    self.get_logger().info(f'deleted {name}: older than '
                                           f'{self.config.evidence.retention_days} days')
            except StereoSpeedError as error:
                self._refuse('not_deleted', error)

    def _refuse(self, what: str, why: object) -> None:
        self.counts[what] += 1
        self.get_logger().error(f'{what}: {why}', throttle_duration_sec=1.0)

    def close(self) -> None:
        """
        Write the last records, because the node stops; images not received yet are missing.

        Those of passes count that a measuring node publishes as it ends with this one.
        """
        receive_last(self, self._awaited, LAST_S)
        for one in self._undecided:
            self._decide(one.recorder, one.name, one.result)
        self._undecided.clear()
        with self._wake:
            self._stopping = True
            self._wake.notify()
        self._writer.join(_STOP_S)
        if rclpy.ok():
            self.tell()
        if not self._writer.is_alive():
            self.store.close()

    def state(self) -> State:
        """Return the state of the records for ``/diagnostics``."""
        state = State('recording')
        refused = sum((r.refused for r in self.recorders.values()), Counter[str]())
        state.values.update(
            images_left=self.images['left'], images_right=self.images['right'],
            ring_images=len(self.ring), ring_mib=self.ring.bytes >> 20,
            records=len(self.store.chain), undecided=len(self._undecided),
            to_write=len(self._work), **self.counts,
            **{f'no_record_{reason}': count for reason, count in sorted(refused.items())})
        if self.wrong:
            state.find(ERROR, f'no records: {self.wrong}')
        if any(self.approved.unknown(r.setting.instrument.fingerprints)
               for r in self.recorders.values()):
            state.find(ERROR, 'the running instrument is not as approved')
        if not self.recorders:
            state.find(WARN, 'no instrument has identified itself')
        elif not all(self.images[side] for side in SIDES):
            state.find(WARN, 'no images received')
        return state


main = partial(run, EvidenceNode)

if __name__ == '__main__':
    raise SystemExit(main())
