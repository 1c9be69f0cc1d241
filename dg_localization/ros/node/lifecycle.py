# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A managed node: its transitions, and the heartbeat for a lifecycle manager."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
import traceback
from typing import Any, TypeVar

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

N = TypeVar('N', bound=LifecycleNode)


def transition(
    method: Callable[[N], None],
) -> Callable[[N, LifecycleState], TransitionCallbackReturn]:
    """Make a transition callback of a method that raises when it fails; rclpy would not log it."""

    @wraps(method)
    def callback(node: N, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            method(node)
        except Exception:
            node.get_logger().error(f'{method.__name__} failed:\n{traceback.format_exc()}')
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    return callback


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """
    Answer requests of transitions that the present state does not have: they are refused.

    rclpy raises, and whoever asks, such as a lifecycle manager, waits for an answer for ever.
    """
    for service in node.services:
        if service.srv_type is ChangeState:
            service.callback = _refusing(service.callback)


def _refusing(callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a callback that refuses where `callback` raises."""

    @wraps(callback)
    def change_state(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        # rclpy has no public class for this; rcl has logged the transition and the state.
        except RuntimeError:
            response.success = False
            return response

    return change_state


BOND_TOPIC = 'bond'


def make_bond(node: Node) -> Callable[[], None] | None:
    """Form a bond with the manager of a node and return what breaks it; None without bondpy."""
    if find_spec('bondpy') is None:
        return None
    bond = import_module('bondpy.bondpy').Bond(BOND_TOPIC, node.get_name(), node)
    bond.start()

    def end() -> None:
        bond.break_bond()
        bond.shutdown()

    return end


class ManagedNode(LifecycleNode):
    """
    A node with the states of REP-2003, which takes apart what its transitions made.

    A class derived from it makes things in `_configure` and `_activate`, and puts what takes them
    apart into `_made_to_configure` and `_made_to_activate`. `_state` is the name of the state.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        refuse_impossible_transitions(self)
        self._state = 'unconfigured'
        self._made_to_configure = ExitStack()
        self._made_to_activate = ExitStack()

    def _configure(self) -> None:
        raise NotImplementedError

    def _activate(self) -> None:
        raise NotImplementedError

    @transition
    def on_configure(self) -> None:
        """Make what is there while the node is inactive, too."""
        self._configure()
        self._state = 'inactive'

    @transition
    def on_activate(self) -> None:
        """Make what is there while the node is active."""
        self._activate()
        self._state = 'active'

    @transition
    def on_deactivate(self) -> None:
        """Take apart what was made to be active."""
        self._state = 'inactive'
        self._made_to_activate.close()

    @transition
    def on_cleanup(self) -> None:
        """Take apart what was made to be inactive."""
        self._state = 'unconfigured'
        self._made_to_configure.close()

    @transition
    def on_shutdown(self) -> None:
        """End from any state."""
        self._state = 'finalized'
        self._dismantle()

    @transition
    def on_error(self) -> None:
        """Go back to where nothing is made."""
        self._state = 'unconfigured'
        self._dismantle()

    def destroy_node(self) -> None:
        """Take everything apart and destroy the node."""
        self._dismantle()
        super().destroy_node()

    def _dismantle(self) -> None:
        self._made_to_activate.close()
        self._made_to_configure.close()

    def _make_wake_up(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Return a function that has the executor's thread call `callback`."""
        guard = self.create_guard_condition(callback)
        self._made_to_configure.callback(self.destroy_guard_condition, guard)
        wake_up: Callable[[], None] = guard.trigger
        return wake_up

    def _bond_with_manager(self) -> None:
        end_bond = make_bond(self)
        if end_bond is None:
            self.get_logger().info(
                'no bond with a lifecycle manager without the package bondpy: a manager of Nav2 '
                'needs bond_timeout: 0.0'
            )
        else:
            self._made_to_activate.callback(end_bond)

    def _clock_s(self) -> float:
        """Return the time of the node's clock in s."""
        return float(self.get_clock().now().nanoseconds) * 1e-9
