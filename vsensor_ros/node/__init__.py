"""
The replacer on a ROS 2 graph: messages to numbers and back. It decides nothing about sensors.

The way in is `vsensor_ros.node.replacer` (Replacer, start); the accessors of
`vsensor_ros.node.accessor` serve whoever else turns messages into numbers.
"""
