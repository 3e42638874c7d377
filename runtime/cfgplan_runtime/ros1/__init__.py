"""Runs whose units are ROS 1 nodes: the run starts, connects (by a relay), watches and stops them through a master."""
