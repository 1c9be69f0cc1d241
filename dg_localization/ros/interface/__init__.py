"""What a fleet is told and tells on ROS: parameters, input topics, outputs and diagnostics."""
