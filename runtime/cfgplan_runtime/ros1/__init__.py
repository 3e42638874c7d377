"""Runs whose units are ROS 1 nodes: started, connected by a relay, watched and stopped over a master."""
