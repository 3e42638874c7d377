"""The helper process that speaks ROS 2 for cfgplan. It runs in the user's ROS Python, which need not be cfgplan's.

Modules here import rclpy and the standard library, and of cfgplan what does that too (`streams.element`,
`streams.inlet`). They keep to Python 3.10.
"""
