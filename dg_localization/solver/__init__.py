"""
Interval distance geometry without ROS and without I/O, from the kernels up.

``rounding``, ``box``: numbers and boxes. ``smoothing``, ``projection``, ``line``,
``back_projection``: the steps of the paper. ``contraction``: their fixed point. ``search``:
branch and prune. ``placements``, ``hypotheses``, ``coordinates``: what the cover means.
``problem``, ``result``, ``solve``: what a user sees.
"""
