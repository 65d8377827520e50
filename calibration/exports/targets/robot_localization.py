"""A configuration of robot_localization's EKF with what the twin and its recordings say of the sensors.

That filter takes a measurement's covariance and time from its message. So the file holds, beside the EKF's own
parameters, what has to be put into the messages: variances from the noise while driving, stamps moved back by the
measured latencies, scales and offsets taken out. `history_length` covers the oldest reading.
Source: Moore and Stouch, A generalized extended Kalman filter implementation for the robot operating system, IAS-13,
2014, and the package's parameter file.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.exports.target import Job, Target
from calibration.exports.written import heading, text_lines
from calibration.exports.yaml_numbers import extra_lines
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import driving_noise

_FUSED = {
  "odom0": ("motor_speed", "wheel/odometry", (6,)),  # speed along the car
  "pose0": ("pose_x", "pose", (0, 1, 5)),  # place and heading
  "imu0": ("yaw_rate", "imu/data", (11,)),  # yaw rate
}
_LATENCY = {"odom0": "encoder_latency", "pose0": "pose_latency", "imu0": "imu_latency"}
_STATES = 15


def _write(job: Job, path: Path) -> Sequence[str]:
  if job.dataset is None:
    raise ValueError(
      "an export to robot-localization needs --dataset: noise and rates are its recordings', not a twin's"
    )
  recordings = [r for r in job.dataset.recordings if r.role != "holdout"]
  models, driving = noise_models(recordings), driving_noise(recordings)
  values, here = job.twin.parameters.named(job.theta), {m.name for m in job.present}
  late = {sensor: values[name] if name in here else 0.0 for sensor, name in _LATENCY.items()}
  fused = {sensor: how for sensor, how in _FUSED.items() if how[0] in models}
  rates = [models[how[0]].rate for how in fused.values()]
  lines = [*heading(job, ()), "ekf_filter_node:", "  ros__parameters:"]
  lines += [f"    frequency: {max(rates):.1f}  # Hz, of the fastest sensor", "    two_d_mode: true"]
  lines += [f"    sensor_timeout: {2.0 / min(rates):.3f}  # s, two samples of the slowest"]
  oldest = max(0.0, *late.values()) + 1.0 / min(rates)
  lines += ["    smooth_lagged_data: true", f"    history_length: {oldest:.3f}  # s, the oldest reading"]
  lines += ["    odom_frame: odom", "    base_link_frame: base_link", "    world_frame: odom", "    publish_tf: true"]
  for sensor, (_, topic, places) in fused.items():
    flags = ["true" if k in places else "false" for k in range(_STATES)]
    rows = [", ".join(flags[k : k + 3]) for k in range(0, _STATES, 3)]
    lines += [f"    {sensor}: {topic}", f"    {sensor}_config: [" + f",\n{' ' * 20}".join(rows) + "]"]
    lines += [f"    {sensor}_queue_size: 10"]
  lines += ["# For the messages: variance of a sample, and what to subtract from its stamp or to divide it by."]
  lines += _messages(job, {n: max(models[n].std, driving.get(n, 0.0)) for n in models}, late, values, here)
  text_lines(path, lines)
  return [f"latencies: {', '.join(f'{s} {1e3 * late[s]:.1f} ms' for s in fused)}"]


def _messages(
  job: Job, noise: Mapping[str, float], late: Mapping[str, float], values: Mapping[str, float], here: set[str]
) -> list[str]:
  travel = job.twin.vehicle.gear_ratio * job.twin.vehicle.wheel_radius
  made: dict[str, object] = {f"{sensor}_latency": value for sensor, value in late.items()}
  about = {f"{sensor}_latency": "s, off the stamp" for sensor in late}
  for name, std in noise.items():
    scale = travel if name == "motor_speed" else 1.0
    made[f"variance_{name}"] = (std * scale) ** 2
    about[f"variance_{name}"] = "of speed, m^2/s^2" if name == "motor_speed" else "in the channel's unit, squared"
  for name in ("gyro_scale", "gyro_bias", "accel_bias", "wheel_radius_error", "imu_lever_arm", "pose_mount"):
    if name in here:
      mechanism = next(m for m in job.present if m.name == name)
      made |= {p.name: float(values[p.name]) for p in mechanism.parameters}
      about |= {p.name: f"{p.unit}; {p.description}" for p in mechanism.parameters}
  return extra_lines(made, about)


TARGET = Target(
  name="robot-localization",
  file="ekf.yaml",
  summary="robot_localization's EKF with measured latencies, scales and noise",
  write=_write,
)
