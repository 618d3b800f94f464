"""A session's map in Open3D: python open3d_map.py SESSION [SERVER] [--save FILE.ply]. Needs Open3D.

Points are gray, lines have the color of their global primitive, the camera's path is orange.
"""

import argparse

import numpy as np
import open3d as o3d

from monoslam import NONE, Client

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("session")
parser.add_argument("server", nargs="?", default="http://127.0.0.1:50051")
parser.add_argument("--save", help="write the points to a file instead of opening a window")
args = parser.parse_args()


def line_set(start: np.ndarray, end: np.ndarray, colors: np.ndarray) -> o3d.geometry.LineSet:
    lines = o3d.geometry.LineSet()
    lines.points = o3d.utility.Vector3dVector(np.vstack([start, end]))
    lines.lines = o3d.utility.Vector2iVector(np.arange(2 * len(start)).reshape(2, -1).T)
    lines.colors = o3d.utility.Vector3dVector(colors)
    return lines


with Client(args.server) as client:
    scene = client.map(args.session)

# Submaps share no frame of reference: one is shown.
path = scene.trajectory.largest_submap()
if len(path) == 0:
    raise SystemExit(f"{args.session} has no map yet")
submap = int(path.submap_id[0])
points, lines = scene.points.of_submap(submap), scene.lines.of_submap(submap)

cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.position))
cloud.paint_uniform_color([0.5, 0.5, 0.5])
palette = np.random.default_rng(1).uniform(0.2, 0.9, (int(lines.primitive_id.max(initial=0)) + 1, 3))
colors = np.where((lines.primitive_id == NONE)[:, None], 0.6, palette[lines.primitive_id])
edges = line_set(lines.start, lines.end, colors)
orange = np.tile([1.0, 0.5, 0.0], (len(path) - 1, 1))
camera_path = line_set(path.position[:-1], path.position[1:], orange)

print(f"{len(cloud.points)} points, {len(edges.lines)} lines, {len(path)} poses")
if args.save:
    o3d.io.write_point_cloud(args.save, cloud)
else:
    o3d.visualization.draw_geometries([cloud, edges, camera_path])
