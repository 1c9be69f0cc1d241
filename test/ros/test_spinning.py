# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How the executables spin: what is ready together is run together."""

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.ros.spinning import BatchExecutor  # noqa: E402

NUMBER = 20


class Counting(BatchExecutor):
    """An executor that counts how often it looks for what is ready."""

    looked = 0

    def get_nodes(self):
        self.looked += 1
        return super().get_nodes()


def make_ready(node, callback):
    guards = [node.create_guard_condition(lambda i=i: callback(i)) for i in range(NUMBER)]
    for guard in guards:
        guard.trigger()
    return guards


def test_what_is_ready_together_is_run_after_one_look(node):
    called = []
    executor = Counting(context=node.context)
    executor.add_node(node)
    make_ready(node, called.append)
    executor.spin_batch()
    assert called == list(range(NUMBER))
    assert executor.looked == 1
    executor.shutdown()


def test_a_callback_that_raises_does_not_drop_the_others(node):
    called = []

    def callback(number):
        called.append(number)
        if number == 3:
            raise ValueError('wrong')

    executor = BatchExecutor(context=node.context)
    executor.add_node(node)
    make_ready(node, callback)
    with pytest.raises(ValueError, match='wrong'):
        executor.spin_batch()
    executor.spin_batch()
    assert called == list(range(NUMBER))
    executor.shutdown()
