"""A process that publishes a person until it is killed: python ros_person.py X, where the person stands at (X, 0)."""

import sys

import rclpy
from rclpy.parameter import Parameter
from visualization_msgs.msg import Marker, MarkerArray

from safe_ompl.geometry import STANDING

rclpy.init()
node = rclpy.create_node("tracker", parameter_overrides=[Parameter("use_sim_time", value=True)])
publisher = node.create_publisher(MarkerArray, "people", 1)


def publish():
    """Publish all key points of the operator."""
    now, message = node.get_clock().now().to_msg(), MarkerArray()
    for k, (name, place) in enumerate(STANDING.items()):
        marker = Marker(ns="operator", id=k, text=name)
        marker.header.stamp, marker.header.frame_id = now, "world"
        marker.pose.position.x = float(sys.argv[1]) - 1.75 * place[0]
        marker.pose.position.y = -1.75 * place[1]
        marker.pose.position.z = 1.75 * place[2] - 0.75
        message.markers.append(marker)
    publisher.publish(message)


node.create_timer(0.04, publish)
rclpy.spin(node)
