"""The interface of a fleet on ROS: parameters, input topics, outputs and diagnostics."""
