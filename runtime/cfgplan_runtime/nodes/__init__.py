"""Code shared by the ROS 1 and ROS 2 backends: processes of nodes, and wires through a relay."""
