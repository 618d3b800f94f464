"""A ROS 2 node: images and their camera_info in, geometry_msgs/PoseStamped on ~/pose out. python ros2_node.py"""

import numpy as np
import rclpy
import rclpy.node
from geometry_msgs.msg import PoseStamped
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from monoslam import Camera, CameraModel, Client

FISHEYE, N_CHANNELS = "equidistant", {"mono8": 1, "rgb8": 3, "bgr8": 3}


class Slam(rclpy.node.Node):
    def __init__(self):
        super().__init__("monoslam")
        self.client = Client(self.declare_parameter("server", "http://127.0.0.1:50051").value)
        self.stream = None
        self.poses = self.create_publisher(PoseStamped, "~/pose", 10)
        self.create_subscription(CameraInfo, "camera_info", self.on_info, 10)
        self.create_subscription(Image, "image", self.on_image, qos_profile_sensor_data)

    def on_info(self, info):
        if self.stream is None:
            model = CameraModel.KANNALA_BRANDT if info.distortion_model == FISHEYE else CameraModel.RADTAN
            camera = Camera(info.width, info.height, *(info.k[i] for i in (0, 4, 2, 5)), tuple(info.d), model)
            session = self.client.create_session("", camera)
            self.stream = self.client.open_stream(session.id, policy="realtime", on_answer=self.on_answer)

    def on_image(self, image):
        if self.stream is not None:
            rows, n = np.frombuffer(image.data, np.uint8), N_CHANNELS[image.encoding]
            pixels = rows.reshape(image.height, image.step)[:, : n * image.width].reshape(image.height, -1, n)
            stamp_ns = image.header.stamp.sec * 10**9 + image.header.stamp.nanosec
            self.stream.send(pixels.copy(), stamp_ns, channels=image.encoding[:3], wait=False)

    def on_answer(self, answer):
        if answer.pose is not None:
            message = PoseStamped()
            message.header.frame_id = f"submap_{answer.submap_id}"
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(answer.timestamp_ns, 10**9)
            p, q = message.pose.position, message.pose.orientation
            p.x, p.y, p.z = map(float, answer.pose.position)
            q.x, q.y, q.z, q.w = map(float, answer.pose.quaternion)
            self.poses.publish(message)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Slam())
