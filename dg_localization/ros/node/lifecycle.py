# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""States of a managed node, its bond, parameters that change while it runs, and its log."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial, wraps
from importlib import import_module
from importlib.util import find_spec
import re
import traceback
from typing import Any, TypeVar

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from dg_localization.ros.interface.intake import shortened
from dg_localization.ros.interface.outputs import transform_output
from dg_localization.ros.interface.parameters.settings import (
    Settings,
    check_values,
    declare_missing,
    settings_from,
)
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.parameters.table import takes_effect_at_once
from msg_adapters import Level, Status

N = TypeVar('N', bound=LifecycleNode)

BOND_TOPIC = 'bond'
BEGINNING = re.compile(r'[^:;,0-9]*')
"""The beginning of a message, before names and numbers."""

LOOKS_BETWEEN = 5
"""A state that changes all the time is logged at most once per this number of calls."""


def transition(method: Callable[[N], None]) -> Callable[..., TransitionCallbackReturn]:
    """Make a transition callback that logs the error of a failed method, since rclpy does not."""

    @wraps(method)
    def callback(node: N, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            method(node)
        except Exception:
            node.get_logger().error(f'{method.__name__} failed:\n{traceback.format_exc()}')
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    return callback


def changed_state(callback: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    """
    Answer a transition request; refuse a transition that the present state does not have.

    rclpy raises instead, and the client, such as a lifecycle manager, would wait forever.
    """
    try:
        return callback(request, response)
    # rclpy has no public class for this; rcl has logged the transition and the state.
    except RuntimeError:
        response.success = False
        return response


class ManagedNode(LifecycleNode):
    """
    A node with the managed lifecycle states, which undoes its transitions.

    A derived class creates resources in `on_configure` and `on_activate`, and registers their
    cleanup in `_made_to_configure` and `_made_to_activate`. `_state` names the state.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = partial(changed_state, service.callback)
        self._state = 'unconfigured'
        self._made_to_configure = ExitStack()
        self._made_to_activate = ExitStack()

    @transition
    def on_deactivate(self) -> None:
        """Destroy the resources of the active state."""
        self._state = 'inactive'
        self._made_to_activate.close()

    @transition
    def on_cleanup(self) -> None:
        """Destroy the resources of the inactive state."""
        self._state = 'unconfigured'
        self._made_to_configure.close()

    @transition
    def on_shutdown(self) -> None:
        """Shut down from any state."""
        self._state = 'finalized'
        self._dismantle()

    @transition
    def on_error(self) -> None:
        """Take everything apart."""
        self._state = 'unconfigured'
        self._dismantle()

    def destroy_node(self) -> None:
        """Destroy all resources and the node."""
        self._dismantle()
        super().destroy_node()

    def _dismantle(self) -> None:
        self._made_to_activate.close()
        self._made_to_configure.close()

    def _bond_with_manager(self) -> None:
        if find_spec('bondpy') is None:
            self.get_logger().info('no bond without bondpy: Nav2 needs bond_timeout: 0.0')
            return
        bond = import_module('bondpy.bondpy').Bond(BOND_TOPIC, self.get_name(), self)
        bond.start()
        self._made_to_activate.callback(bond.shutdown)
        self._made_to_activate.callback(bond.break_bond)

    def _clock_s(self) -> float:
        """Return the time of the node's clock in s."""
        return float(self.get_clock().now().nanoseconds) * 1e-9


class LiveParameters:
    """
    Checks each change as a whole, and applies the parts that take effect at once.

    Parameters
    ----------
    node : Node
        A node with declared parameters.
    apply : callable
        Called with the settings after a change; robots, inputs and outputs are those
        configured.

    """

    def __init__(self, node: Node, apply: Callable[[Settings], None]) -> None:
        self._node = node
        self._apply = apply
        declared: dict[str, Any] = node.get_parameters_by_prefix('')
        given = {name: parameter.value for name, parameter in declared.items()}
        self._wanted = check_values(given, refuses_unknown=False)
        self._present = self._wanted
        self._is_declaring = False
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._on_set)

    def at_configure(self) -> Settings:
        """Return the settings with all changes so far."""
        self._present = self._wanted
        self._is_declaring = True
        declare_missing(self._node, self._wanted)
        self._is_declaring = False
        return settings_from(self._wanted, self._node.resolve_topic_name)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse wrong values, and a change of the clock: all earlier stamps would be wrong."""
        try:
            if any(parameter.name == 'use_sim_time' for parameter in parameters):
                raise WrongParameterError('use_sim_time can be set only when the node starts')
            self._settings_after(parameters)
        except WrongParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_set(self, parameters: Sequence[Parameter]) -> None:
        """Apply parameters that take effect at once; others wait for the next configuration."""
        if self._is_declaring:
            return
        before = self._present
        self._wanted, self._present, settings = self._settings_after(parameters)
        if self._present != before:
            self._apply(settings)
        if self._wanted != self._present:
            self._node.get_logger().info('some changes take effect at the next configure')

    def _settings_after(
        self, parameters: Sequence[Parameter]
    ) -> tuple[dict[str, Any], dict[str, Any], Settings]:
        """Return the wanted values, the values in effect, and the settings from the latter."""
        changes = {} if self._is_declaring else {one.name: one.value for one in parameters}
        # Parameters of points that are gone are left out.
        wanted = check_values({**self._wanted, **changes}, refuses_unknown=False)
        if settings_from(wanted, self._node.resolve_topic_name).publish_tf:
            transform_output()
        present = {
            name: wanted.get(name, value) if takes_effect_at_once(name) else value
            for name, value in self._present.items()
        }
        return wanted, present, settings_from(present, self._node.resolve_topic_name)


class FleetLog:
    """
    Logs the status of the fleet when it changes for more than a moment.

    Parameters
    ----------
    logger : rclpy.impl.rcutils_logger.RcutilsLogger

    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._seen: tuple[Level, str] | None = None
        self._said: tuple[Level, str] | None = None
        self._looks = LOOKS_BETWEEN

    def look(self, status: Status) -> None:
        """Log a status that was seen twice in a row and differs from the one logged last."""
        found = BEGINNING.match(status.message)
        state = status.level, found.group() if found else ''
        lasts, self._seen = state == self._seen, state
        self._looks += 1
        if not lasts or state == self._said or self._looks <= LOOKS_BETWEEN:
            return
        self._said, self._looks = state, 0
        text = shortened(f'fleet: {status.message}')
        # rclpy allows one severity per line of source.
        if status.level is Level.OK:
            self._logger.info(text)
        elif status.level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)
