# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How the executables spin: what is ready together is run together."""

import pytest

from dg_localization.ros.spinning import BatchExecutor

NUMBER = 20


class Counting(BatchExecutor):
    """An executor that counts how often it looks for what is ready."""

    looked = 0

    def get_nodes(self):
        self.looked += 1
        return super().get_nodes()


def test_what_is_ready_is_run_after_one_look_also_where_a_callback_raises(node):
    called = []

    def callback(number):
        called.append(number)
        if number == 3:
            raise ValueError('wrong')

    executor = Counting(context=node.context)
    executor.add_node(node)
    guards = [node.create_guard_condition(lambda i=i: callback(i)) for i in range(NUMBER)]
    for guard in guards:
        guard.trigger()
    with pytest.raises(ValueError, match='wrong'):
        executor.spin_batch()
    assert executor.looked == 1
    executor.spin_batch()
    assert called == list(range(NUMBER))
    executor.shutdown()
