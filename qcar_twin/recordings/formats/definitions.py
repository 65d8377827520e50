"""Definitions of messages that cars use and ROS 2 itself does not bring along: names, types and order of their fields,
as the packages of ROS 2 publish them, for bags that hold no definitions of their own."""

ACKERMANN = {
  "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
  "float32 acceleration\nfloat32 jerk\n",
  "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
}
# of the driver of VESC speed controllers (github.com/f1tenth/vesc, vesc_msgs)
_VESC = {
  "vesc_msgs/msg/VescState": "".join(
    f"{kind} {name}\n"
    for kind, names in (
      ("float64", "temp_fet temp_motor current_motor current_input avg_id avg_iq duty_cycle speed"),
      ("float64", "voltage_input charge_drawn charge_regen energy_drawn energy_regen"),
      ("int32", "displacement distance_traveled fault_code"),
      ("float64", "pid_pos_now"),
      ("int32", "controller_id"),
      ("float64", "ntc_temp_mos1 ntc_temp_mos2 ntc_temp_mos3 avg_vd avg_vq"),
    )
    for name in names.split()
  ),
  "vesc_msgs/msg/VescStateStamped": "std_msgs/Header header\nvesc_msgs/VescState state\n",
  "vesc_msgs/msg/VescImu": "geometry_msgs/Vector3 ypr\ngeometry_msgs/Vector3 linear_acceleration\n"
  "geometry_msgs/Vector3 angular_velocity\ngeometry_msgs/Vector3 compass\ngeometry_msgs/Quaternion orientation\n",
  "vesc_msgs/msg/VescImuStamped": "std_msgs/Header header\nvesc_msgs/VescImu imu\n",
}
# of Autoware, whose reports moved from one package to another as they were
_STEERING = "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle\n"
_VELOCITY = "std_msgs/Header header\nfloat32 longitudinal_velocity\nfloat32 lateral_velocity\nfloat32 heading_rate\n"
_AUTOWARE = {
  "autoware_auto_control_msgs/msg/AckermannLateralCommand": f"{_STEERING}float32 steering_tire_rotation_rate\n",
  "autoware_auto_control_msgs/msg/LongitudinalCommand": "builtin_interfaces/Time stamp\nfloat32 speed\n"
  "float32 acceleration\nfloat32 jerk\n",
  "autoware_auto_control_msgs/msg/AckermannControlCommand": "builtin_interfaces/Time stamp\n"
  "autoware_auto_control_msgs/AckermannLateralCommand lateral\n"
  "autoware_auto_control_msgs/LongitudinalCommand longitudinal\n",
  "autoware_auto_vehicle_msgs/msg/SteeringReport": _STEERING,
  "autoware_auto_vehicle_msgs/msg/VelocityReport": _VELOCITY,
  "autoware_vehicle_msgs/msg/SteeringReport": _STEERING,
  "autoware_vehicle_msgs/msg/VelocityReport": _VELOCITY,
}
OF_CARS = {**ACKERMANN, **_VESC, **_AUTOWARE}
