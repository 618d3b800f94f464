"""The examples do what they say, against a real server."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import nbformat
import numpy as np
import pytest
from conftest import EXAMPLES, Mapped, Server
from nbclient import NotebookClient

from monoslam import NONE, Client, Folder


def run(example: str, *arguments: object, folder: Path) -> str:
    command = [sys.executable, EXAMPLES / example, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_video_is_mapped_in_twenty_lines(server: Server, room: Folder, tmp_path: Path) -> None:
    code = (EXAMPLES / "webcam.py").read_text().splitlines()
    assert len([line for line in code if line.strip()]) <= 20
    video = tmp_path / "room.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 20, (640, 480))
    for file in room.files[:60]:
        writer.write(cv2.imread(str(file)))
    writer.release()
    said = run("webcam.py", video, server.address, folder=tmp_path)
    assert re.search(rf"See it at http://{server.http}/#/s/\S+", said)
    assert len(re.findall(r"^\d+ \[", said, re.MULTILINE)) > 30, said


def test_evo_compares_in_the_example(server: Server, room: Folder, tmp_path: Path) -> None:
    said = run("evaluate_with_evo.py", room.path, server.address, folder=tmp_path)
    rmse = float(re.search(r"ATE RMSE ([\d.]+)", said).group(1))  # type: ignore[union-attr]
    assert rmse < 0.05 and (tmp_path / "estimate.txt").exists()


def test_the_notebook_runs_to_its_end(server: Server, room: Folder, tmp_path: Path) -> None:
    notebook = nbformat.read(EXAMPLES / "map.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "commit it without outputs"
    surroundings = {"MONOSLAM_SERVER": server.address, "MONOSLAM_RECORDING": str(room.path)}
    kernel = {"env": {**os.environ, **surroundings, "MPLBACKEND": "agg"}}
    runner = NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}})
    runner.execute(**kernel)
    texts = [out.get("text", "") for cell in notebook.cells for out in cell.get("outputs", [])]
    assert any("of the path's extent" in text for text in texts)
    assert (tmp_path / "model" / "points3D.txt").exists()


@pytest.mark.skipif(importlib.util.find_spec("open3d") is None, reason="Open3D is not installed")
def test_the_map_goes_into_open3d(mapped: Mapped, tmp_path: Path) -> None:
    said = run("open3d_map.py", mapped.id, mapped.server.address, "--save", "room.ply", folder=tmp_path)
    points = mapped.client.points(mapped.id)
    assert said.startswith(f"{len(points)} points") and (tmp_path / "room.ply").exists()
    assert NONE == -1


class Heard:
    """Stands in for the ROS 2 node class: what it subscribes to can be called, what it publishes is kept."""

    def __init__(self, name: str) -> None:
        self.name, self.subscriptions, self.published = name, {}, []  # type: ignore[var-annotated]

    def declare_parameter(self, name: str, default: str) -> SimpleNamespace:
        return SimpleNamespace(value=os.environ.get("MONOSLAM_SERVER", default))

    def create_publisher(self, kind: object, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind: object, topic: str, callback: Any, qos: object) -> None:
        self.subscriptions[topic] = callback


def blank(*names: str) -> SimpleNamespace:
    return SimpleNamespace(**dict.fromkeys(names, 0))


def pose_stamped() -> SimpleNamespace:
    header = SimpleNamespace(stamp=blank("sec", "nanosec"), frame_id="")
    pose = SimpleNamespace(position=blank("x", "y", "z"), orientation=blank("x", "y", "z", "w"))
    return SimpleNamespace(header=header, pose=pose)


def test_the_ros_node_publishes_poses(server: Server, room: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without ROS: its modules are stood in for, the node's own code and the server are real."""
    code = (EXAMPLES / "ros2_node.py").read_text().splitlines()
    assert len([line for line in code if line.strip()]) <= 41
    contents = {
        "rclpy": {"node": SimpleNamespace(Node=Heard)},
        "rclpy.node": {},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": pose_stamped},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"CameraInfo": None, "Image": None},
    }
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("MONOSLAM_SERVER", server.address)
    spec = importlib.util.spec_from_file_location("ros2_node", EXAMPLES / "ros2_node.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    node = module.Slam()
    c = room.camera
    k = [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1]
    info = SimpleNamespace(width=c.width, height=c.height, k=k, d=[0.0] * 5, distortion_model="plumb_bob")
    node.subscriptions["camera_info"](info)
    for frame in room[:40]:
        image = np.asarray(cv2.imread(str(frame.image)))
        padded = np.zeros((480, 640 * 3 + 16), dtype=np.uint8)
        padded[:, : 640 * 3] = image.reshape(480, -1)
        sec, nanosec = divmod(frame.timestamp_ns, 10**9)
        header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
        message = SimpleNamespace(
            header=header, height=480, width=640, step=padded.shape[1], encoding="bgr8", data=padded.tobytes()
        )
        node.subscriptions["image"](message)
        # In real time a slow machine drops frames; here none.
        while not node.stream._ledger.is_answered:
            time.sleep(0.005)
    node.stream.close()
    assert len(node.published) > 10
    assert node.published[-1].header.frame_id == "submap_0"
    with Client(server.address) as client:
        assert client.sessions()[0].n_keyframes >= 2
