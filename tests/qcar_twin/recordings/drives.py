"""A small car that obeys its own kinematics exactly, and data sets of its drives on disk, for the recording tests."""

import numpy as np

from qcar_twin.recordings.recording import Recording

VEHICLE = {
  "name": "test car",
  "mass": 2.7,
  "yaw_inertia": 0.03,
  "cg_to_front": 0.128,
  "cg_to_rear": 0.128,
  "track_width": 0.17,
  "cg_height": 0.045,
  "wheel_radius": 0.033,
  "gear_ratio": 0.0953668,
  "max_steering": 0.5236,
}
STD = {"mass": 0.02, "yaw_inertia": 0.004}
NOISE = {
  "accel_x": 0.1,
  "accel_y": 0.1,
  "yaw_rate": 0.01,
  "motor_speed": 1.0,
  "pose_x": 1e-3,
  "pose_y": 1e-3,
  "pose_yaw": 1e-3,
}


def drive(seconds=12.0, rate=100.0, seed=0):
  """Time (k,) and columns of a winding drive with changing speed; no slip, sensor noise of ordinary size.

  The speed is the rear axle's, the pose that of the centre of gravity.
  """
  random = np.random.default_rng(seed)
  time = np.arange(int(seconds * rate)) / rate
  speed = 0.8 + 0.5 * np.sin(1.7 * time) + 0.1 * np.sin(5.0 * time)
  steering = 0.3 * np.sin(1.1 * time + 0.4)
  yaw_rate = speed * np.tan(steering) / (VEHICLE["cg_to_front"] + VEHICLE["cg_to_rear"])
  yaw = np.cumsum(yaw_rate) / rate
  columns = {
    "motor_voltage": 4.0 * speed,
    "steering_command": steering,
    "motor_speed": speed / (VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]),
    "accel_x": np.gradient(speed, time),
    "accel_y": speed * yaw_rate,
    "yaw_rate": yaw_rate,
    "pose_x": np.cumsum(speed * np.cos(yaw)) / rate + VEHICLE["cg_to_rear"] * np.cos(yaw),
    "pose_y": np.cumsum(speed * np.sin(yaw)) / rate + VEHICLE["cg_to_rear"] * np.sin(yaw),
    "pose_yaw": yaw,
  }
  for channel, sigma in NOISE.items():
    columns[channel] = columns[channel] + sigma * random.standard_normal(time.size)
  return time, columns


def recording(name="run", seed=0, seconds=12.0, **about):
  time, columns = drive(seconds, seed=seed)
  return Recording.from_columns(name, time, columns, **about)


def write_csv(path, time, columns, separator=",", decimal="."):
  """A CSV as a person's logger would write it; NaN becomes a blank cell."""
  rows = [separator.join(("time", *columns))]
  for cells in zip(time, *columns.values(), strict=True):
    texts = [
      "" if isinstance(cell, float) and cell != cell else cell if isinstance(cell, str) else repr(float(cell))
      for cell in cells
    ]
    rows.append(separator.join(text.replace(".", decimal) for text in texts))
  path.write_text("\n".join(rows) + "\n", encoding="utf-8")
  return path


def write_manifest(
  folder, files=("run.csv",), top='name = "lab"', channels="", vehicle=None, role="identify", extra=""
):
  """A dataset.toml beside the files."""
  numbers = VEHICLE if vehicle is None else vehicle
  lines = [top, "[vehicle]", *(f"{key} = {value!r}" for key, value in numbers.items())]
  lines += ["[channels]", channels] if channels else []
  for file in files:
    lines += ["[[recording]]", f'file = "{file}"', f'role = "{role}"', extra]
  (folder / "dataset.toml").write_text("\n".join(lines), encoding="utf-8")
  return folder


def folder_with(tmp_path, time, columns, **manifest):
  write_csv(tmp_path / "run.csv", time, columns)
  return write_manifest(tmp_path, **manifest)
