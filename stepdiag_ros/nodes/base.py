"""What every node of the graph is: a lifecycle node in a process of its own.

A node declares its parameters, says how it is (``health``), and does its work in
``configure``, ``activate``, ``deactivate`` and ``cleanup``, which raise
:class:`StepdiagError` where they cannot.  The rest is here: diagnostics once a
second, the lifecycle's return codes, signals, spinning.
"""

import faulthandler
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from stepdiag_ros.nodes import environment

#: What a user is to be told of the network: that it is open, or what of his environment is not followed.
NETWORK_SAID = environment.prepare()

import rclpy  # noqa: E402 - the environment has to be set before
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor  # noqa: E402
from rclpy.clock import Clock, ClockType  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.exceptions import InvalidParameterValueException  # noqa: E402
from rclpy.experimental.events_executor import EventsExecutor  # noqa: E402
from rclpy.impl.implementation_singleton import rclpy_implementation  # noqa: E402
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import (  # noqa: E402
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402
from rclpy.task import Future  # noqa: E402
from rclpy.timer import Timer  # noqa: E402

from stepdiag_ros.errors import StepdiagError  # noqa: E402
from stepdiag_ros.guard.show import escaped  # noqa: E402

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

#: Messages that wait for a slow reader before the oldest is lost.
DEPTH = 2000
#: How long the executor waits at a time.  The one in the wheel spins idly and deaf when
#: it is told to wait for ever (decision 0031); a finite wait is what it does well.
SPIN_S = 0.2
#: So long diagnostics say that a callback has failed.
FAILED_S = 10.0
#: A node that was told to end has ended after so long, whatever still holds it.
ENDS_S = 15.0


def reliable(depth: int = DEPTH, latched: bool = False) -> QoSProfile:
    """Reliable and deep; ``latched`` also reaches those who come later."""
    return QoSProfile(
        depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def steady_clock() -> Clock:
    """The monotonic clock, for timers."""
    return Clock(clock_type=ClockType.STEADY_TIME)


def overridable() -> QoSOverridingOptions:
    """Let parameters ``qos_overrides.<topic>.…`` change history, depth, reliability, durability."""
    return QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                 QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY))


@dataclass(frozen=True)
class Health:
    """What goes to ``/diagnostics``: a level, one phrase, numbers by name."""

    level: bytes = OK
    message: str = 'ok'
    values: Mapping[str, Any] = field(default_factory=dict)


class SafeLogger:
    """A node's logger that shows names from outside escaped; each level stands on a line of its own, as rclpy wants."""

    def __init__(self, logger: Any):
        self._logger = logger

    def debug(self, text: str, **options: Any) -> bool:
        return self._logger.debug(escaped(str(text)), **options)

    def info(self, text: str, **options: Any) -> bool:
        return self._logger.info(escaped(str(text)), **options)

    def warning(self, text: str, **options: Any) -> bool:
        return self._logger.warning(escaped(str(text)), **options)

    def error(self, text: str, **options: Any) -> bool:
        return self._logger.error(escaped(str(text)), **options)

    def fatal(self, text: str, **options: Any) -> bool:
        return self._logger.fatal(escaped(str(text)), **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._logger, name)


class StepdiagNode(LifecycleNode):
    """A lifecycle node with described parameters and diagnostics."""

    def __init__(self, name: str, **kwargs):
        super().__init__(name, **kwargs)
        self.state = 'unconfigured'
        self._fault, self._own_start = '', False
        self._not_understood, self._not_understood_s = '', -FAILED_S
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = self._refusing(service.callback)
        autostart = self.text('autostart', False, 'configure and activate without being asked')
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_timer = self.every(1.0, self.publish_diagnostics)
        self._autostart_timer = self.every(1.0, self._start_by_itself) if autostart else None

    def get_logger(self) -> Any:
        return SafeLogger(super().get_logger())

    # -- for the node in question to fill ----------------------------------------

    def configure(self) -> None:
        """Open what is needed; :class:`StepdiagError` if it cannot be had."""

    def activate(self) -> None:
        """Begin to work; publishers are open when this is called."""

    def deactivate(self) -> None:
        """Stop working; publishers are still open."""

    def cleanup(self) -> None:
        """Release what ``configure`` took; may be called twice."""

    def health(self) -> Health:
        """How the node is; called once a second in every state."""
        return Health()

    def every(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """A timer that a step of the system's clock does not hold up, as it does rclpy's own default."""
        return self.create_timer(period_s, callback, clock=steady_clock())

    # -- parameters --------------------------------------------------------------

    # ``fixed``: read-only once the node runs.  Whatever names files, hosts, feeds or places is: everybody on this
    # computer may call the parameter services.

    def number(self, name: str, default: float, description: str, low: float, high: float,
               unit: str = '', fixed: bool = False) -> float:
        """Declare a floating-point parameter with its range; returns its value."""
        described = f'{description} [{unit}]' if unit else description
        return self.declare_parameter(name, float(default), ParameterDescriptor(
            description=described, read_only=fixed,
            floating_point_range=[FloatingPointRange(from_value=float(low), to_value=float(high))])).value

    def count(self, name: str, default: int, description: str, low: int, high: int, fixed: bool = False) -> int:
        """Declare a whole-number parameter with its range; returns its value."""
        return self.declare_parameter(name, int(default), ParameterDescriptor(
            description=description, read_only=fixed,
            integer_range=[IntegerRange(from_value=low, to_value=high, step=1)])).value

    def text(self, name: str, default: Any, description: str, fixed: bool = False) -> Any:
        """Declare a parameter without a range (text, switch or list); returns its value."""
        return self.declare_parameter(name, default, ParameterDescriptor(
            description=description, read_only=fixed)).value

    def value(self, name: str) -> Any:
        """The parameter as it stands now."""
        return self.get_parameter(name).value

    def stated(self, name: str) -> Any:
        """A parameter that nobody can guess; :class:`StepdiagError` where it was not given."""
        value = self.value(name)
        if not value:
            raise StepdiagError(f'{self.get_name()}: parameter {name} is not given; start the node with '
                                '--ros-args --params-file FILE (stepdiag up and ros2 launch write one), or with '
                                f'-p {name}:=…')
        return value

    # -- lifecycle ---------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent = super().on_configure
        return self._transition('inactive', self.configure, lambda: parent(state))

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent, back = super().on_activate, super().on_deactivate
        return self._transition('active', lambda: parent(state), self.activate,
                                undo=lambda: back(state))

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent = super().on_deactivate
        return self._transition('inactive', self.deactivate, lambda: parent(state))

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent = super().on_cleanup
        return self._transition('unconfigured', self.cleanup, lambda: parent(state))

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent = super().on_shutdown
        work = (self.deactivate, self.cleanup) if self.state == 'active' else (self.cleanup,)
        return self._transition('finalized', *work, lambda: parent(state))

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        parent, fault = super().on_error, self._fault
        result = self._transition('unconfigured', self.cleanup, lambda: parent(state))
        self._fault = fault
        return result

    def _transition(self, target: str, *steps: Callable[[], Any],
                    undo: Callable[[], Any] | None = None) -> TransitionCallbackReturn:
        """Run the steps; bad input is one line and a refusal, anything else is an error."""
        try:
            for step in steps:
                result = step()
                if result not in (None, TransitionCallbackReturn.SUCCESS):
                    return result
        except StepdiagError as error:
            self._fault = str(error)
            self.get_logger().error(str(error))
            if undo is not None:
                undo()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            # rclpy would swallow it (its lifecycle says nothing about what was raised).
            self._fault = f'{type(error).__name__}: {error}'
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self._fault = ''
        self.state = target
        return TransitionCallbackReturn.SUCCESS

    def _refusing(self, change: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """``change`` of the state as in C++: a transition that does not leave the present state is refused.

        rclpy raises there, and whoever asks for one, were it twice for the same, would end the node.
        """
        def answer(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change(request, response)
            except RuntimeError as error:
                self.get_logger().warning(f'no transition {request.transition.label or request.transition.id} from '
                                          f'{self.state}: {error}')
                response.success = False
                return response
        return answer

    def callback_failed(self, error: Exception) -> None:
        """Somebody has sent what no callback was made for: it is said, and nothing else suffers."""
        self._not_understood = f'a message was not understood: {type(error).__name__}: {error}'
        quiet = time.monotonic() - self._not_understood_s
        self._not_understood_s = time.monotonic()
        # Not by rclpy's throttle: it keeps what a line of source was first called with, and raises at anything else.
        if quiet > FAILED_S:
            self.get_logger().error(''.join(traceback.format_exception(error)))

    def _start_by_itself(self) -> None:
        if self.state == 'unconfigured':
            self._own_start = True
            self.trigger_configure()
        if self.state == 'inactive' and self._own_start:
            self.trigger_activate()
        elif self.state == 'inactive':
            self._autostart_timer.cancel()   # somebody else has taken over and knows what he waits for
        if self.state == 'active':
            self._autostart_timer.cancel()

    def close(self) -> None:
        """Wind down on the way out, whatever the state."""
        if self.state == 'active':
            self.trigger_deactivate()
        if self.state == 'inactive':
            self.trigger_cleanup()

    # -- diagnostics -------------------------------------------------------------

    def publish_diagnostics(self) -> None:
        """Publish the health; a refused transition shows as an error until the next one."""
        health = self.health()
        level, message = health.level, health.message
        if self._fault:
            level, message = ERROR, self._fault
        elif level == OK and time.monotonic() < self._not_understood_s + FAILED_S:
            level, message = WARN, self._not_understood
        status = DiagnosticStatus(
            level=level, name=f'{self.get_namespace().strip("/")}/{self.get_name()}'.lstrip('/'),
            message=message, hardware_id=str(health.values.get('device', '')),
            values=[KeyValue(key='state', value=self.state),
                    *(KeyValue(key=k, value=_short(v)) for k, v in health.values.items())])
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _short(value: Any) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def spin(executor, until: Callable[[], bool], failed: Callable[[Exception], None] | None = None) -> None:
    """Serve callbacks until ``until()`` is true, which is asked at least five times a second; ``failed`` is told what a
    callback raises, which else ends this."""
    never = Future(executor=executor)
    while not until():
        try:
            executor.spin_until_future_complete(never, timeout_sec=SPIN_S)
        except Exception as error:
            if failed is None:
                raise
            failed(error)


def end(node: Node, context: Context, executor: Any = None) -> None:
    """End a node that has a context of its own, and what DDS has of it; actions of it are to be destroyed before.

    What still holds the node keeps its participant, which goes on to discover and answer all others of its domain.
    """
    if executor is not None:
        # Before what it listens to is destroyed: a message that comes meanwhile has nobody to wake.
        executor.remove_node(node)
        executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def run_node(make: Callable[[], StepdiagNode]) -> int:
    """The ``main`` of a node: make it, spin until SIGINT or SIGTERM, wind down.

    rclpy's own signal handlers would close the context at once, before a recorder has
    drained and an axis has stopped; so the node takes the signals itself.  What the middleware
    holds for ever on the way out ends with the process, which then says where it stood.
    """
    status = _run(make)
    if threading.active_count() > 1:
        # A thread still computes, and the interpreter's end may abort where it tears one out of C++ code.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def _run(make: Callable[[], StepdiagNode]) -> int:
    asked: list[int] = []

    def ask(number: int, _frame: Any) -> None:
        asked.append(number)
        faulthandler.dump_traceback_later(ENDS_S, exit=True)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, ask)
    node = None
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        if NETWORK_SAID:
            node.get_logger().warning(NETWORK_SAID)
        executor = EventsExecutor()
        executor.add_node(node)
        spin(executor, lambda: bool(asked), node.callback_failed)
        # Before what it listens to is destroyed: a message that comes meanwhile has nobody to wake.
        executor.remove_node(node)
        return 0
    except StepdiagError as error:
        print(escaped(f'stepdiag: {error}'), file=sys.stderr)
        return 2
    except (InvalidParameterValueException, rclpy_implementation.RCLError) as error:
        # Of arguments: a file of parameters that is not there or no YAML, a value out of its range.
        print(escaped(f'stepdiag: {error}'.replace('\n', ' ')), file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
