"""
The replacer on a ROS 2 graph: messages to numbers and back. It decides nothing about sensors.

The ways in are `vsensor_ros.node.lifecycle` (start, ManagedNode) and, below it,
`vsensor_ros.node.replacer` (Replacer) with `vsensor_ros.node.loop` (run); the accessors of
`vsensor_ros.node.accessor` serve whoever else turns messages into numbers.
"""
