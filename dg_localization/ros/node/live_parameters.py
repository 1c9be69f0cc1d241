# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Parameters that are set while the node runs."""

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from dg_localization.ros.interface.outputs import transform_output
from dg_localization.ros.interface.parameters.settings import (
    Settings,
    changed_values,
    declare_missing,
    settings_from,
    without_fleet_changes,
)
from dg_localization.ros.interface.parameters.spec import WrongParameterError


class LiveParameters:
    """
    Checks each change as a whole, and applies what takes effect at once.

    Parameters
    ----------
    node : Node
        Its parameters are declared.
    apply : callable
        Called with the settings after a change; the fleet in them is the present one.

    """

    def __init__(self, node: Node, apply: Callable[[Settings], None]) -> None:
        self._node = node
        self._apply = apply
        declared: dict[str, Any] = node.get_parameters_by_prefix('')
        given = {name: parameter.value for name, parameter in declared.items()}
        self._wanted: dict[str, Any] = changed_values({}, given)
        self._present = self._wanted
        self._is_declaring = False
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._on_set)

    def at_configure(self) -> Settings | None:
        """Return the settings with all changes so far; None where there is none to come."""
        if self._wanted == self._present:
            return None
        self._present = self._wanted
        self._is_declaring = True
        declare_missing(self._node, self._wanted)
        self._is_declaring = False
        return settings_from(self._wanted, self._node.resolve_topic_name)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse wrong values, and another clock: all stamps so far would be wrong."""
        try:
            if any(parameter.name == 'use_sim_time' for parameter in parameters):
                raise WrongParameterError('use_sim_time can be set only when the node starts')
            self._settings_after(parameters)
        except WrongParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_set(self, parameters: Sequence[Parameter]) -> None:
        """Apply what takes effect at once; the rest waits for the next configuration."""
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
        """Return the wanted values, the present ones, and the settings of these."""
        changes = {one.name: one.value for one in parameters if one.name in self._wanted}
        if self._is_declaring:
            changes = {}
        wanted = changed_values(self._wanted, changes)
        if settings_from(wanted, self._node.resolve_topic_name).publish_tf:
            transform_output()
        present = without_fleet_changes(self._present, wanted)
        return wanted, present, settings_from(present, self._node.resolve_topic_name)
