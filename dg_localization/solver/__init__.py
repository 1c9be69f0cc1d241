"""
Interval distance geometry without ROS and without I/O, from the kernels up.

``jit``, ``float_environment``, ``rounding``, ``interval``, ``box``: how kernels, numbers,
intervals and boxes are made.
``smoothing``, ``projection``, ``line``, ``back_projection``: the steps of the paper.
``linearization``: all measured distances at once. ``contraction``: their fixed point. ``search``,
``tightening``: branch and prune, and what is shaved off in the end. ``rigidity``, ``placements``,
``hypotheses``, ``coordinates``: what the cover means. ``problem``, ``sides``, ``result``,
``solve``: what a user says and sees.
"""
