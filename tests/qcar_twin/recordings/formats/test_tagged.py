"""Samples among the lines of a simulator's log, as DeepRacer's writes them."""

import numpy as np

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table


def trace(episodes=3, steps=300):
  """Lines of a simulator, and the speed that was commanded: each episode begins at the same place."""
  lines, speeds, k = ["log level: INFO", "s3 bucket: a,b,c"], [], 0
  for episode in range(episodes):
    x = y = yaw = speed = 0.0
    for step in range(steps):
      command, angle = 1.0 + 0.5 * np.sin(0.07 * step), 0.3 * np.sin(0.11 * step + episode)
      speed += (command - speed) * 0.3
      yaw += speed * np.tan(angle) / 0.165 / 15.0
      x, y = x + speed * np.cos(yaw) / 15.0, y + speed * np.sin(yaw) / 15.0
      turned = np.degrees((yaw + np.pi) % (2.0 * np.pi) - np.pi)
      cells = (episode, step + 1, f"{x:.4f}", f"{y:.4f}", f"{turned:.4f}", f"{np.degrees(angle):.2f}", f"{command:.2f}")
      rest = f"3,0.5,False,True,{0.3 * step:.4f},{step % 118},17.67,{1.7e9 + k / 15.0:.5f},in_progress,0.00"
      lines.append(f"SIM_TRACE_LOG:{','.join(map(str, cells))},{rest}")
      speeds.append(round(command, 2))
      k += 1
    lines.append("## agent: Finished episode, reset")
    k += 30
  return lines, np.array(speeds)


def test_a_simulators_trace_is_read_with_the_names_that_it_documents(tmp_path):
  lines, speeds = trace()
  path = tmp_path / "robomaker.log"
  path.write_text("\n".join([*lines, lines[5][:40]]), encoding="utf-8")  # the last line was cut off
  table = read_table(path)
  assert table.rows == speeds.size and list(table.columns)[:2] == ["episode", "steps"]
  np.testing.assert_array_equal(table.columns["speed_command [m/s]"], speeds)
  (tmp_path / "dataset.toml").write_text(propose("racer", [table]).text, encoding="utf-8")
  runs = DataSet.load(tmp_path).recordings
  assert all({"speed_command", "steering_command", "speed", "pose_x", "pose_yaw"} <= set(run.channels) for run in runs)
  assert max(np.abs(run["speed"].value).max() for run in runs) < 2.0  # no leap back to the start is a speed
