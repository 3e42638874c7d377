"""ROS: message types, and graphs of nodes and topics from running systems, recordings and files."""
