"""Reads what `monoslam export` wrote by the programs that it is for, and compares it with the JSON file.

read_exports.py FOLDER, which has map.json, map.ply, map.mcap, colmap/ and nerfstudio/.
"""

import base64
import io
import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pycolmap
from mcap.reader import make_reader
from PIL import Image
from plyfile import PlyData

SCHEMAS = {
    "/tf": "foxglove.FrameTransform",
    "/map/points": "foxglove.PointCloud",
    "/map/lines": "foxglove.SceneUpdate",
    "/camera/pose": "foxglove.PoseInFrame",
    "/camera/image": "foxglove.CompressedImage",
    "/camera/calibration": "foxglove.CameraCalibration",
}


def rotation(x, y, z, w):
    """Of a quaternion."""
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def world_from_camera(keyframe):
    pose = keyframe["world_from_camera"]
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(pose["qx"], pose["qy"], pose["qz"], pose["qw"])
    matrix[:3, 3] = pose["tx"], pose["ty"], pose["tz"]
    return matrix


def read_mcap(path, truth):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        assert {topic: schema.name for topic, schema in schemas.items()} == SCHEMAS, schemas
        assert all(schema.encoding == "jsonschema" for schema in schemas.values())
        messages = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            assert channel.message_encoding == "json"
            messages.setdefault(channel.topic, []).append(json.loads(message.data))
            assert set(messages[channel.topic][-1]) == set(json.loads(schemas[channel.topic].data)["properties"])
    cloud = messages["/map/points"][0]
    points = np.frombuffer(base64.b64decode(cloud["data"]), dtype=np.uint8).reshape(-1, cloud["point_stride"])
    assert [field["offset"] for field in cloud["fields"]] == [0, 4, 8, 12, 13, 14, 15]
    positions = points[:, :12].copy().view(np.float32)
    expected = np.array([[point["position"][k] for k in "xyz"] if isinstance(point["position"], dict)
                         else point["position"] for point in truth["points"]])
    assert np.allclose(positions, expected, rtol=1e-5, atol=1e-5)
    # Grays are the images', not one for all.
    assert len(set(points[:, 12])) > 20
    lines = messages["/map/lines"][0]["entities"][0]["lines"][0]
    assert len(lines["points"]) == len(lines["colors"]) == 2 * len(truth["lines"])
    poses = {(p["timestamp"]["sec"], p["timestamp"]["nsec"]): p["pose"] for p in messages["/camera/pose"]}
    assert len(poses) == len(messages["/camera/pose"]) == len(messages["/tf"]) - 1
    for keyframe in truth["keyframes"]:
        ns = keyframe["timestamp_ns"]
        pose, expected = poses[ns // 10**9, ns % 10**9], keyframe["world_from_camera"]
        assert abs(pose["position"]["x"] - expected["tx"]) < 1e-6, (keyframe["id"], pose, expected)
    assert len(messages["/camera/image"]) == len(truth["keyframes"])
    image = messages["/camera/image"][0]
    size = Image.open(io.BytesIO(base64.b64decode(image["data"]))).size
    calibration = messages["/camera/calibration"][0]
    assert size == (calibration["width"], calibration["height"]) and image["format"] in ("png", "jpeg")
    print("mcap: ok", Counter({topic: len(of) for topic, of in messages.items()}))


def read_colmap(path, truth):
    model = pycolmap.Reconstruction(str(path / "sparse/0"))
    assert model.num_reg_images() == len(truth["keyframes"])
    assert model.num_points3D() == len(truth["points"])
    camera = next(iter(model.cameras.values()))
    errors = []
    keyframes = {keyframe["id"]: keyframe for keyframe in truth["keyframes"]}
    for image_id, image in model.images.items():
        assert Image.open(path / "images" / image.name).size == (camera.width, camera.height)
        from_world = np.linalg.inv(world_from_camera(keyframes[image_id]))
        assert np.allclose(image.cam_from_world().matrix(), from_world[:3], atol=1e-6)
        for point2d in image.points2D:
            if point2d.has_point3D():
                projected = image.project_point(model.points3D[point2d.point3D_id].xyz)
                errors.append(np.linalg.norm(projected - point2d.xy))
    # A model whose pixels or poses were of another convention would be off by far more than a pixel.
    assert len(errors) > 1000 and np.median(errors) < 1.0, np.median(errors)
    print("colmap: ok", model.summary().replace("\n", " "), "median error", np.median(errors))


def read_transforms(path, truth):
    transforms = json.loads((path / "transforms.json").read_text())
    keyframes = {keyframe["id"]: keyframe for keyframe in truth["keyframes"]}
    points = np.array([[v["x"], v["y"], v["z"]] for v in PlyData.read(path / transforms["ply_file_path"])["vertex"]])
    assert len(transforms["frames"]) == len(keyframes)
    n_seen = 0
    for frame in transforms["frames"]:
        file = path / frame["file_path"]
        assert Image.open(file).size == (transforms["w"], transforms["h"])
        matrix = np.array(frame["transform_matrix"])
        expected = world_from_camera(keyframes[int(file.stem.split("_")[1])])
        assert np.allclose(matrix @ np.diag([1, -1, -1, 1]), expected, atol=1e-6)
        # As a renderer sees it: in front is negative z, up is positive y.
        in_camera = (np.linalg.inv(matrix) @ np.c_[points, np.ones(len(points))].T)[:3]
        x = transforms["cx"] + transforms["fl_x"] * in_camera[0] / -in_camera[2]
        y = transforms["cy"] - transforms["fl_y"] * in_camera[1] / -in_camera[2]
        inside = (in_camera[2] < 0) & (x > 0) & (x < transforms["w"]) & (y > 0) & (y < transforms["h"])
        n_seen += inside.sum()
    assert n_seen > 50 * len(keyframes), n_seen
    print("transforms: ok", transforms["camera_model"], len(keyframes), "frames")


def read_ply(path, truth):
    ply = PlyData.read(path)
    assert ply["vertex"].count == len(truth["points"]) + 2 * len(truth["lines"])
    assert ply["edge"].count == len(truth["lines"])
    assert ply["edge"]["vertex2"].max(initial=0) < ply["vertex"].count
    print("ply: ok", ply["vertex"].count, "vertices")


def main():
    folder = Path(sys.argv[1])
    truth = json.loads((folder / "map.json").read_text())
    assert len({keyframe["submap_id"] for keyframe in truth["keyframes"]}) == 1
    read_mcap(folder / "map.mcap", truth)
    read_colmap(folder / "colmap", truth)
    read_transforms(folder / "nerfstudio", truth)
    read_ply(folder / "map.ply", truth)


if __name__ == "__main__":
    main()
