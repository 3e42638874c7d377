"""What backends of nodes share, whichever ROS they are of: processes of nodes, and wires that a relay leads."""
