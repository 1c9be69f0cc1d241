# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How a method of a lifecycle node becomes the callback of a transition."""

from collections.abc import Callable
from functools import wraps
import traceback
from typing import TypeVar

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
