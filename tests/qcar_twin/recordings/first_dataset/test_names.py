"""What column names say: people's own names for every channel, their units, and names that must not be mistaken."""

import math

import pytest

from qcar_twin.recordings.first_dataset.names import readings, unit_of, words_of


@pytest.mark.parametrize(
  "column, channel",
  [
    ("wheel_speed_rad_s", "motor_speed"), ("rear_wheel_speed_rad_s", "motor_speed"), ("wheel_omega", "motor_speed"),
    ("motor_rad_s", "motor_speed"), ("encoder_rad_s", "motor_speed"), ("wheel_speed [rad/s]", "motor_speed"),
    ("throttle_V", "motor_voltage"), ("cam_x", "pose_x"), ("mc_y", "pose_y"), ("wheel_speed", "speed"),
    ("vEgo", "speed"), ("aEgo", "accel_x"), ("ms_today", "time"),
    ("Steered Angle [deg]", "steering_command"), ("DesSpeed [m/s]", "speed_command"),
    ("time", "time"), ("t", "time"), ("stamp_ms", "time"), ("elapsed time sensors", "time"), ("timestamp", "time"),
    ("motorVoltage", "motor_voltage"), ("u_motor [V]", "motor_voltage"), ("cmd_voltage", "motor_voltage"),
    ("throttle", "motor_duty"), ("pwm", "motor_duty"), ("duty_cycle", "motor_duty"),
    ("accel_cmd", "acceleration_command"), ("a_des [m/s^2]", "acceleration_command"),
    ("cmd_accel_pct", "motor_duty"), ("accel command [%]", "motor_duty"), ("compass [deg]", "pose_yaw"),
    ("target acceleration", "acceleration_command"), ("current_cmd [A]", "motor_current"),
    ("target current", "motor_current"),
    ("speed_cmd", "speed_command"), ("desired velocity [m/s]", "speed_command"), ("v_ref", "speed_command"),
    ("steer", "steering_command"), ("servo", "steering_command"), ("steeringAngle [deg]", "steering_command"),
    ("delta_cmd", "steering_command"), ("steering_angle_rad", "steering_command"),
    ("motor speed", "motor_speed"), ("motor_rpm", "motor_speed"), ("tach [rpm]", "motor_speed"),
    ("vel encoder", "speed"), ("speed_raw", "speed"), ("vx", "speed"), ("v [km/h]", "speed"), ("speed_mps", "speed"),
    ("acc x (IMU)", "accel_x"), ("ax", "accel_x"), ("accel_forward", "accel_x"), ("imu_accel_x [g]", "accel_x"),
    ("/imu.linear_acceleration.x", "accel_x"), ("accel_left", "accel_y"), ("ay_mps2", "accel_y"),
    ("gyro z [deg/s]", "yaw_rate"), ("W (IMU)", "yaw_rate"), ("yaw_rate", "yaw_rate"), ("wz", "yaw_rate"),
    ("/imu.angular_velocity.z", "yaw_rate"), ("heading rate", "yaw_rate"),
    ("vicon x", "pose_x"), ("pos_y_mm", "pose_y"), ("x [m]", "pose_x"), ("y", "pose_y"),
    ("heading", "pose_yaw"), ("vicon yaw", "pose_yaw"), ("theta [deg]", "pose_yaw"),
    ("u_motor", "motor_voltage"), ("mot_mV", "motor_voltage"), ("actuator_motors.control[0]", "motor_duty"),
    ("gZ", "yaw_rate"), ("actuator_servos_0.control[0]", "steering_command"), ("steering%", "steering_command"),
    ("Steering(%)", "steering_command"), ("steering_percent", "steering_command"), ("user/angle", "steering_command"),
    ("actuator_servos.control[0]", "steering_command"), ("i_motor", "armature_current"), ("TX (mm)", "pose_x"),
    ("TY (mm)", "pose_y"), ("RZ (rad)", "pose_yaw"), ("vehicle_angular_velocity.xyz[2]", "yaw_rate"),
    ("sensor.accelerometer_m_s2[1]", "accel_y"), ("gyro(3)", "yaw_rate"), ("accel(1)", "accel_x"),
    ("tstamp", "time"), ("imu_yaw", "pose_yaw"), ("motor_rpm_cmd", "speed_command"), ("GPS.Spd", "speed"),
    ("g_lat", "accel_y"), ("g_lon", "accel_x"), ("state_x", "pose_x"),
    ("control.longitudinal.velocity", "speed_command"),
    ("actuator_controls_0_0.control[2]", "steering_command"), ("actuator_controls_0.control[3]", "motor_duty"),
    ("speed_set", "speed_command"), ("delta_set", "steering_command"), ("thr_req", "motor_duty"),
    ("motor_cmd", "motor_duty"), ("omega_wheel", "motor_speed"), ("w_wheel", "motor_speed"),
    ("wheel speed [rpm]", "motor_speed"), ("mm_s", "speed"), ("km_h", "speed"), ("a_xy(2)", "accel_y"),
    ("current_motor", "armature_current"), ("psi_p", "yaw_rate"), ("psipunkt [°/s]", "yaw_rate"), ("psi", "pose_yaw"),
    ("v_Rad_HL", "speed"), ("vesc.state.speed", "motor_speed"), ("THR.ThrIn", "motor_duty"), ("THR.Speed", "speed"),
    ("THR.AccX", "accel_x"), ("VCU_SteerReq", "steering_command"),
    ("battery", "battery_voltage"), ("vbat", "battery_voltage"), ("current", "armature_current"),
  ],
)  # fmt: skip
def test_a_name_means_a_channel(column, channel):
  assert readings(column)[0].channel == channel


@pytest.mark.parametrize(
  "column",
  [
    "gyro x",
    "gyro[0]",
    "local_position.vx",
    "mag_x",
    "distance",
    "odometer",
    "temperature",
    "imu_accel_z",
    "seq",
    "status",
    "gas_temp_C",
  ],
)
def test_what_is_no_channel_is_taken_for_none_that_a_fit_would_believe(column):
  assert not {r.channel for r in readings(column)} & {
    "pose_x",
    "speed",
    "accel_x",
    "accel_y",
    "yaw_rate",
    "motor_speed",
  }


def test_the_measured_steering_is_no_command_and_a_filtered_speed_comes_second():
  assert all(r.channel != "steering_command" for r in readings("steering_angle_measured"))
  assert all(r.channel != "steering_command" for r in readings("steering_report.steering_tire_angle"))
  for did, told in (("SteerAngleAct [deg]", "SteerAngleCmd [deg]"), ("joints.position[steer]", "drive.steering_angle")):
    assert readings(did)[0].score < readings(told)[0].score - 0.55  # so that no other sensor is asked which it is
  assert readings("speed_filtered")[0].score < readings("speed")[0].score < 10.5
  assert readings("speed_raw")[0].score > readings("speed_filtered")[0].score


@pytest.mark.parametrize(
  "column, unit, factor",
  [
    ("stamp_ms", "s", 1e-3), ("time (us)", "s", 1e-6), ("steer [deg]", "rad", math.pi / 180.0), 
    ("gyro_dps", "rad/s", math.pi / 180.0), ("x(in)", "m", 0.0254), ("v_r(ips)", "m/s", 0.0254),
    ("Gierrate [grad/s]", "rad/s", math.pi / 180.0), ("lat_acc ft/s2", "m/s^2", 0.3048), ("gradient", None, None),
    ("SteerIn", None, None), ("pos_inches", "m", 0.0254), ("Yaw [Deg/Sec]", "rad/s", math.pi / 180.0),
    ("Odometer[km]", "m", 1000.0), ("Speed_kn", "m/s", 1852.0 / 3600.0), ("speed (kt)", "m/s", 1852.0 / 3600.0),
    ("speed_kmph", "m/s", 1 / 3.6), ("motor_rpm_cmd", "rad/s", math.tau / 60.0), ("rpm_left", "rad/s", math.tau / 60.0),
    ("left_turn", None, None), ("acc_x_mms2", "m/s^2", 1e-3), ("gyro_z_mrads", "rad/s", 1e-3),
    ("speed_cms", "m/s", 0.01), ("throttle%", "-", 0.01),
    ("speed_meters_per_sec", "m/s", 1.0),
    ("rate_rad_s", "rad/s", 1.0), ("motor [rpm]", "rad/s", math.tau / 60.0), ("acc_x_g", "m/s^2", 9.80665),
    ("acc m/s2", None, None), ("ay_mps2", "m/s^2", 1.0), ("v [km/h]", "m/s", 1 / 3.6), ("pos_mm", "m", 1e-3),
    ("battery_mV", "V", 1e-3), ("throttle_pct", "-", 0.01), ("speed", None, None), ("acc x (IMU)", None, None),
    ("v in km/h", "m/s", 1 / 3.6), ("Lenkung in Grad", "rad", math.pi / 180.0), ("speed in front", None, None),
  ],
)  # fmt: skip
def test_a_unit_is_read_off_the_name(column, unit, factor):
  unit_there = unit_of(column)
  if unit is None:
    assert unit_there is None or column == "acc m/s2"
  else:
    assert unit_there is not None and unit_there[1:] == (unit, pytest.approx(factor))


def test_a_logs_own_clock_goes_before_that_of_one_device():
  assert readings("elapsed time sensors")[0].score > readings("vicon time")[0].score


def test_words_are_split_where_people_split_them():
  assert words_of("steeringAngle [deg]") == ("steering", "angle", "deg")
  assert words_of("IMU_accelX") == ("imu", "accel", "x") and words_of("W (IMU)") == ("w", "imu")


@pytest.mark.parametrize(
  ("name", "channel"),
  [
    ("v in km/h", "speed"),
    ("v_long", "speed"),
    ("w_psi", "yaw_rate"),
    ("u_a", "acceleration_command"),
    ("gps_x", "pose_x"),
    ("TorqueReq [%]", "motor_duty"),
    ("SteerAngleCmd [deg]", "steering_command"),
    ("YawRate [deg/s]", "yaw_rate"),
    ("LatAcc [m/s2]", "accel_y"),
    ("LongAcc [m/s2]", "accel_x"),
    ("WheelSpeedRL [rpm]", "motor_speed"),
  ],
)
def test_short_names_of_the_trade(name, channel):
  assert readings(name)[0].channel == channel
