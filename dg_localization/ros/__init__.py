"""The ROS 2 side: the node and the other executables."""
