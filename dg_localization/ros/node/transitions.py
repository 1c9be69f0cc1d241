# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Transitions of a managed node: methods become callbacks, and every request is answered."""

from collections.abc import Callable
from functools import wraps
import traceback
from typing import Any, TypeVar

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

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
