# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A managed node: its transitions, and the heartbeat for a lifecycle manager."""

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
import traceback
from typing import Any, TypeVar

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

ManagedNode = TypeVar('ManagedNode', bound=LifecycleNode)


def transition(
    method: Callable[[ManagedNode], None],
) -> Callable[[ManagedNode, LifecycleState], TransitionCallbackReturn]:
    """Make a transition callback of a method that raises when it fails; rclpy would not log it."""

    @wraps(method)
    def callback(node: ManagedNode, state: LifecycleState) -> TransitionCallbackReturn:
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
    """
    Form a bond with the manager of a node, where the package bondpy is installed.

    Parameters
    ----------
    node : Node
        Its name identifies the bond.

    Returns
    -------
    callable or None
        Breaks the bond; None without bondpy.

    """
    if find_spec('bondpy') is None:
        return None
    bond = import_module('bondpy.bondpy').Bond(BOND_TOPIC, node.get_name(), node)
    bond.start()

    def end() -> None:
        bond.break_bond()
        bond.shutdown()

    return end
