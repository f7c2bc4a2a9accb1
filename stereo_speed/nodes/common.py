# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Functions that nodes share: parameters, stamps, images, start and end."""
from __future__ import annotations

from array import array
import dataclasses
from functools import partial
import os
import signal
import sys
from tempfile import TemporaryDirectory
import time
from types import FrameType
from typing import Any, Callable, ClassVar, Optional, Sequence

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from .ports import abandoned, others_than
from ..core.config import check_bounds, Record
from ..core.errors import InputError, StereoSpeedError

PAIR_TOPIC = 'stereo/image_pair'
# Nothing may be lost between nodes of this package, or live and offline speeds would differ.
RELIABLE = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
# For messages that are published once: late subscribers get the last ones too.
LATCHED = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                    durability=DurabilityPolicy.TRANSIENT_LOCAL)
BAD_INPUT = 2
LAST_S = 4.0  # longest wait for what other nodes publish while they end; launch kills after 10 s
_LOOK_S = 0.05
_QUEUED = 200  # most messages that may have been received by then
JUMP_NS = 1_000_000_000  # a stamp earlier by more than this is a jump of time, not a late image


def qos_options() -> QoSOverridingOptions:
    """Return options that let parameters override a topic's QoS."""
    return QoSOverridingOptions.with_default_policies()


def latched_options() -> QoSOverridingOptions:
    """Return options that let parameters override a latched topic's QoS, with durability."""
    return QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                 QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY))


def stamp_ns(stamp: Any) -> int:
    """Return a header stamp in integer ns."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def to_stamp(ns: int) -> Time:
    """Return the message stamp of integer ns."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def image_message(pixels: NDArray[Any], *, ns: int, frame_id: str) -> Image:
    """
    Return an ``Image`` of grey or BGR pixels.

    :param pixels: (H, W) uint8 or uint16, or (H, W, 3) uint8 BGR.
    """
    encoding = {(2, 1): 'mono8', (2, 2): 'mono16', (3, 1): 'bgr8'}[pixels.ndim, pixels.itemsize]
    msg = Image(height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
                step=pixels.shape[1] * pixels.itemsize * (3 if pixels.ndim == 3 else 1),
                is_bigendian=int(pixels.itemsize > 1 and sys.byteorder == 'big'))
    msg.header.stamp, msg.header.frame_id = to_stamp(ns), frame_id
    msg.data = byte_array(pixels)
    return msg


def byte_array(values: NDArray[Any]) -> array[int]:
    """
    Return the bytes of an array in the form that is fastest to assign to a message.

    The setter of a message uses the buffer of an ``array.array`` directly, but would check every
    byte of an ndarray in Python.
    """
    data = array('B')
    data.frombytes(np.ascontiguousarray(values).data.cast('B'))
    return data


class Parameters:
    """
    Declares parameters with description and range and reads them once.

    All are read-only, because a measuring instrument does not change while it runs.  ``told`` has
    a line for each parameter declared in this process, for ``--help``.
    """

    told: ClassVar[list[str]] = []

    def __init__(self, node: Node) -> None:
        self.node = node

    def get(self, name: str, default: Any, doc: str, low: Optional[float] = None,
            high: Optional[float] = None) -> Any:
        """
        Declare a parameter and return its value.

        :param name: name of the parameter.
        :param default: default value, whose type is that of the parameter.
        :param doc: description.
        :param low: least legal value; None for no bounds.
        :param high: greatest legal value; None for no bounds.
        :raises InputError: a value of another type or out of range.
        """
        descriptor = ParameterDescriptor(description=doc, read_only=True)
        if isinstance(default, float):
            # A number like 3 is an integer on the command line, but is accepted as 3.0.
            descriptor.dynamic_typing = True
            if low is not None and high is not None:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=float(low), to_value=float(high))]
        elif isinstance(default, int) and not isinstance(default, bool) and low is not None:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high or 0),
                                                     step=1)]
        bounds = '' if low is None or high is None else f' ({low:g} to {high:g})'
        self.told.append(f'  {name} [{default!r}]{bounds}: {doc}')
        where = f'{self.node.get_name()}: parameter'
        try:
            value = self.node.declare_parameter(name, default, descriptor).value
        except ParameterException as error:
            raise InputError(where, name, ' '.join(str(error).split()),
                             f'{type(default).__name__}, as --help describes it') from None
        if isinstance(default, float):
            return self._number(where, name, value, low, high)
        return value

    def config(self, kind: type[Record], prefix: str = '') -> Record:
        """
        Declare all parameters of a config record and of its sections, as their fields describe.

        :param kind: the record, such as :class:`TrackerConfig`.
        :param prefix: dotted prefix of their names.
        :return: the record with the values of the node.
        :raises InputError: a value out of bounds.
        """
        values: dict[str, Any] = {}
        for f in dataclasses.fields(kind):
            meta = f.metadata
            if 'section' in meta:
                values[f.name] = self.config(meta['section'], f'{prefix}{f.name}.')
                continue
            unit = f' [{meta["unit"]}]' if meta['unit'] else ''
            choices = ', '.join(str(choice) for choice in meta['choices'])
            wanted = f'; one of {choices}' if choices else ''
            bounds = () if choices or not isinstance(f.default, (int, float)) \
                or isinstance(f.default, bool) else (meta['low'], meta['high'])
            values[f.name] = self.get(prefix + f.name, f.default, meta['doc'] + unit + wanted,
                                      *bounds)
        try:
            record = kind(**values)
            check_bounds(record)
        except InputError as error:
            raise InputError(f'{self.node.get_name()}: parameter', prefix + error.what,
                             error.found, error.wanted) from None
        return record

    @staticmethod
    def _number(where: str, name: str, value: Any, low: Optional[float],
                high: Optional[float]) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(where, name, repr(value), 'a number')
        if low is not None and high is not None and not low <= value <= high:
            raise InputError(where, name, value, f'a number in [{low}, {high}]')
        return float(value)


def receive_last(node: Node, subscriptions: Sequence[Subscription], most_s: float) -> None:
    """
    Receive what is still published on some topics while their nodes end, as this one does.

    Ctrl-C and launch end all nodes at once, and a measuring node then publishes its open passes.
    Where the context of the node has ended too, nothing can be received any more.

    :param node: a node that is told to stop.
    :param subscriptions: they are waited for until none has a publisher left.
    :param most_s: longest time to wait, s; the publishers may go on.
    """
    end_s = time.monotonic() + most_s
    while rclpy.ok() and time.monotonic() < end_s and any(
            subscription.get_publisher_count() for subscription in subscriptions):
        rclpy.spin_once(node, timeout_sec=_LOOK_S)
    for _ in range(_QUEUED):  # each look takes one message
        if rclpy.ok():
            rclpy.spin_once(node, timeout_sec=0.0)


def unknown_parameters(node: Node) -> list[str]:
    """
    Return the names of parameters that a node was given but has not declared.

    Prefixes in ``unused_parameters`` of the node, those of alternatives not chosen, are left out.
    So are ``qos_overrides`` of a node without autostart, which declares them later.
    """
    unused = getattr(node, 'unused_parameters', ())
    if not getattr(node, 'autostart', True):
        unused += ('qos_overrides.',)
    given = node._parameter_overrides  # rclpy has no public access to them
    return sorted(name for name in given
                  if not node.has_parameter(name) and not name.startswith(unused))


def run(make: Callable[[], Node], args: Optional[Sequence[str]] = None,
        spin: Callable[[Node], None] = rclpy.spin) -> int:
    """
    Run a node until it is told to stop.

    :param make: makes the node.
    :param args: command line.
    :param spin: runs the node; returns when done.
    :return: exit status: 0 if stopped or done, 2 for bad input, which is reported in one line on
        stderr.
    """
    given = list(sys.argv[1:] if args is None else args)
    if {'-h', '--help'} & set(given[:given.index('--ros-args')] if '--ros-args' in given
                              else given):
        _print_help(make)
        return 0
    # Ctrl-C, and SIGTERM from launch and supervisors, end the node in the same way while its
    # context is still valid, so that passes are finished and published.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    told: list[int] = []  # signals received

    def end(number: int, frame: Optional[FrameType]) -> None:
        told.append(number)
        signal.default_int_handler(number, frame)
    before = {ending: signal.signal(ending, end) for ending in (signal.SIGINT, signal.SIGTERM)}
    node: Optional[Node] = None
    status = 0
    try:
        with others_than(abandoned(rclpy.get_default_context().get_domain_id())):
            node = make()
        getattr(node, 'begin', lambda: None)()
        unknown = unknown_parameters(node)
        if unknown:
            node.get_logger().warning(f'unknown parameters ignored: {", ".join(unknown)}')
        spin(node)
    except StereoSpeedError as error:
        print(f'error: {error}', file=sys.stderr, flush=True)
        status = BAD_INPUT
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:
        if not told:  # rclpy may turn an interrupt while it takes a message into this error
            raise
    finally:
        # Under ros2 launch, Ctrl-C arrives twice, as launch forwards it: open passes are published
        # all the same, and SIGKILL remains for those who cannot wait.
        for ending in before:
            signal.signal(ending, signal.SIG_IGN)
        if node is not None:
            getattr(node, 'close', lambda: None)()
            node.destroy_node()
        rclpy.try_shutdown()
        # Otherwise processes started from now on would ignore the signals too.
        for ending, handler in before.items():
            signal.signal(ending, handler or signal.SIG_DFL)
    return status


def _print_help(make: Callable[[], Node]) -> None:
    """
    Print the description of a node and its parameters.

    The node is made in a temporary folder, so that it leaves no files behind.
    """
    Parameters.told.clear()
    rclpy.init(args=[])
    here = os.getcwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            node = make()
            getattr(node, 'close', lambda: None)()
            node.destroy_node()
        except StereoSpeedError:
            pass  # a required value is missing, but all parameters are declared by then
        finally:
            os.chdir(here)
            rclpy.try_shutdown()
    kind = make.func if isinstance(make, partial) else make
    print((sys.modules[kind.__module__].__doc__ or '').strip())
    print('\nusage: NODE [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO]')
    print('\nparameters, with their defaults in brackets (qos_overrides not listed):')
    print('\n'.join(Parameters.told))
