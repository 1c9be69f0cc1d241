# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The heartbeat that a lifecycle manager of Nav2 expects of the nodes it manages."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec

from rclpy.node import Node

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
