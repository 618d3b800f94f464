"""Streams a recording with its truth and compares by evo: python evaluate_with_evo.py RECORDING [SERVER].

RECORDING is a folder with rgb.txt, calib.json and groundtruth.txt (`timestamp tx ty tz qx qy qz qw`).
"""

import sys
from pathlib import Path

from evo.core import metrics, sync
from evo.tools import file_interface

from monoslam import Client, Folder

recording = Folder.open(sys.argv[1])
estimate_file = Path("estimate.txt")

with Client(*sys.argv[2:3]) as client:
    session = client.create_session("", recording.camera)
    for answer in client.stream(session.id, recording):
        print(f"\rframe {answer.sequence + 1} of {len(recording)}", end="", file=sys.stderr)
    client.trajectory(session.id).save_tum(estimate_file)

truth = file_interface.read_tum_trajectory_file(recording.path / "groundtruth.txt")
estimate = file_interface.read_tum_trajectory_file(estimate_file)
truth, estimate = sync.associate_trajectories(truth, estimate, max_diff=0.01)
# One camera does not see scale: it is taken out, as `evo_ape tum --align --correct_scale` and `monoslam
# evaluate` do.
estimate.align(truth, correct_scale=True)
error = metrics.APE(metrics.PoseRelation.translation_part)
error.process_data((truth, estimate))
rmse = error.get_statistic(metrics.StatisticsType.rmse)
print(f"\nATE RMSE {rmse:.6f}, {estimate.num_poses} poses, in {estimate_file}")
