"""Definitions of messages that cars use and ROS 2 itself does not bring along."""

ACKERMANN = {
  "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
  "float32 acceleration\nfloat32 jerk\n",
  "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
}
