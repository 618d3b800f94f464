"""Maps and trajectories as numpy arrays: one row for each landmark, keyframe or frame.

Submaps share no frame of reference: positions of different `submap_id` must not be mixed. Every table takes a
mask or an index, `points[points.n_observations > 3]`, and `of_submap(id)`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import _convert
from .model import Floats, Scale, TrackingState, rotations

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NONE = -1
"""Stands in columns of ids where there is none."""

_Table = TypeVar("_Table", bound="Table")


@dataclass(frozen=True)
class Table:
    """Columns of equal length, and of what their lengths are."""

    scale: Scale
    submap_id: Ints

    def __len__(self) -> int:
        return len(self.submap_id)

    def __getitem__(self: _Table, rows: Any) -> _Table:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        # What is said of the whole table stays.
        return type(self)(**{n: v[rows] if isinstance(v, np.ndarray) else v for n, v in values.items()})

    def of_submap(self: _Table, submap_id: int) -> _Table:
        """The rows of one submap."""
        return self[self.submap_id == submap_id]


@dataclass(frozen=True)
class Points(Table):
    """Points of a map."""

    id: Ints
    position: Floats
    """(N, 3)."""
    n_observations: Ints
    """Keyframes that see it."""


@dataclass(frozen=True)
class Lines(Table):
    """Infinite lines and the parts of them that were seen."""

    id: Ints
    start: Floats
    """(N, 3), an end of the part that was seen."""
    end: Floats
    direction: Floats
    """(N, 3), of unit length."""
    moment: Floats
    """(N, 3), a point on the line times its direction (Plücker)."""
    n_observations: Ints
    primitive_id: Ints
    """The global primitive whose direction it has, or `NONE`."""


@dataclass(frozen=True)
class Primitives(Table):
    """Directions of the world that keyframes share, whether or not they see the same place."""

    id: Ints
    direction: Floats
    """(N, 3), of unit length; it means the same as its negative."""
    covariance: Floats
    """(N, 3, 3), radians squared, of rank two."""
    std_deg: Floats
    """Standard deviation where the direction is least certain."""
    n_keyframes: Ints
    n_lines: Ints


@dataclass(frozen=True)
class Posed(Table):
    """Poses world_from_camera with their times."""

    sequence: Ints
    timestamp_ns: Ints
    position: Floats
    """(N, 3), of the camera in the world."""
    quaternion: Floats
    """(N, 4), x y z w."""

    def matrices(self) -> Floats:
        """(N, 4, 4), world_from_camera."""
        matrices = np.tile(np.eye(4), (len(self), 1, 1))
        matrices[:, :3, :3], matrices[:, :3, 3] = rotations(self.quaternion), self.position
        return matrices


@dataclass(frozen=True)
class Keyframes(Posed):
    """Keyframes of a map."""

    id: Ints
    parent: Ints
    """The keyframe it hangs on in the spanning tree; `NONE` for the first of a submap."""
    n_keypoints: Ints
    n_points: Ints
    n_segments: Ints
    n_lines: Ints
    has_image: Bools


@dataclass(frozen=True)
class Trajectory(Posed):
    """Poses of frames, or of keyframes, in the order of their times."""

    state: NDArray[np.object_]
    """`TrackingState` of each."""
    backfilled: Bools
    """The pose was found after the frame was answered."""
    n_left_out: int = 0
    """Poses of other submaps than those asked for."""

    def largest_submap(self) -> Trajectory:
        """The poses of the submap that has most of them, which is what one file can hold."""
        if len(self) == 0:
            return self
        ids, counts = np.unique(self.submap_id, return_counts=True)
        return self.of_submap(int(ids[np.argmax(counts)]))

    def save_tum(self, path: str | PathLike[str]) -> None:
        """Writes `seconds tx ty tz qx qy qz qw` of the largest submap, which evo reads as `tum`."""
        poses = self.largest_submap()
        numbers = np.hstack([poses.position, poses.quaternion]).tolist()
        rows = zip(poses.timestamp_ns.tolist(), numbers, strict=True)
        text = "".join(f"{seconds(t)} {' '.join(map(repr, row))}\n" for t, row in rows)
        Path(path).write_text(text, encoding="ascii")


@dataclass(frozen=True)
class Map:
    """Everything of a session, each part as of its own commit: ask while nobody streams for parts that
    agree."""

    points: Points
    lines: Lines
    primitives: Primitives
    keyframes: Keyframes
    trajectory: Trajectory


def seconds(timestamp_ns: int) -> str:
    """Nanoseconds as seconds with nine decimals, exactly."""
    sign, magnitude = "-" if timestamp_ns < 0 else "", abs(timestamp_ns)
    return f"{sign}{magnitude // 10**9}.{magnitude % 10**9:09d}"


def points(batches: Iterable[Any]) -> Points:
    """From messages of QueryPoints."""
    scale, rows = _gather(batches, "points")
    return Points(
        **_common(scale, rows),
        id=_ints(row.id for row in rows),
        position=_vectors(row.position for row in rows),
        n_observations=_ints(row.n_observations for row in rows),
    )


def lines(batches: Iterable[Any]) -> Lines:
    """From messages of QueryLines."""
    scale, rows = _gather(batches, "lines")
    return Lines(
        **_common(scale, rows),
        id=_ints(row.id for row in rows),
        start=_vectors(row.start for row in rows),
        end=_vectors(row.end for row in rows),
        direction=_vectors(row.direction for row in rows),
        moment=_vectors(row.moment for row in rows),
        n_observations=_ints(row.n_observations for row in rows),
        primitive_id=_optional_ints(rows, "primitive_id"),
    )


def primitives(batches: Iterable[Any]) -> Primitives:
    """From messages of ListPrimitives."""
    scale, rows = _gather(batches, "primitives")
    covariance = [list(row.covariance) or [np.nan] * 9 for row in rows]
    return Primitives(
        **_common(scale, rows),
        id=_ints(row.id for row in rows),
        direction=_vectors(row.direction for row in rows),
        covariance=np.array(covariance, dtype=np.float64).reshape(-1, 3, 3),
        std_deg=np.array([row.std_deg for row in rows], dtype=np.float64),
        n_keyframes=_ints(row.n_keyframes for row in rows),
        n_lines=_ints(row.n_lines for row in rows),
    )


def keyframes(batches: Iterable[Any]) -> Keyframes:
    """From messages of ListKeyframes."""
    scale, rows = _gather(batches, "keyframes")
    return Keyframes(
        **_common(scale, rows),
        **_posed(rows),
        id=_ints(row.id for row in rows),
        parent=_optional_ints(rows, "parent"),
        n_keypoints=_ints(row.n_keypoints for row in rows),
        n_points=_ints(row.n_points for row in rows),
        n_segments=_ints(row.n_segments for row in rows),
        n_lines=_ints(row.n_lines for row in rows),
        has_image=np.array([row.has_image for row in rows], dtype=np.bool_),
    )


def trajectory(batches: Iterable[Any]) -> Trajectory:
    """From messages of GetTrajectory."""
    messages = list(batches)
    scale, rows = _gather(messages, "poses")
    states: list[TrackingState] = [_convert.state(row.state) for row in rows]
    return Trajectory(
        **_common(scale, rows),
        **_posed(rows),
        state=np.array(states, dtype=np.object_),
        backfilled=np.array([row.backfilled for row in rows], dtype=np.bool_),
        n_left_out=messages[0].n_poses_left_out if messages else 0,
    )


def _gather(batches: Iterable[Any], name: str) -> tuple[Scale, list[Any]]:
    scale, rows = Scale.UP_TO_SCALE, []
    for batch in batches:
        # Directions have no length, so messages of primitives have no scale.
        scale = _convert.scale(batch.scale) if hasattr(batch, "scale") else scale
        rows += getattr(batch, name)
    return scale, rows


def _common(scale: Scale, rows: list[Any]) -> dict[str, Any]:
    return {"scale": scale, "submap_id": _ints(row.submap_id for row in rows)}


def _posed(rows: list[Any]) -> dict[str, Any]:
    poses = [row.pose_world_from_camera for row in rows]
    return {
        "sequence": _ints(row.sequence for row in rows),
        "timestamp_ns": _ints(row.timestamp_ns for row in rows),
        "position": np.array([(p.tx, p.ty, p.tz) for p in poses], dtype=np.float64).reshape(-1, 3),
        "quaternion": np.array([(p.qx, p.qy, p.qz, p.qw) for p in poses], dtype=np.float64).reshape(-1, 4),
    }


def _ints(values: Iterable[int]) -> Ints:
    return np.fromiter(values, dtype=np.int64)


def _optional_ints(rows: list[Any], name: str) -> Ints:
    return _ints(getattr(row, name) if row.HasField(name) else NONE for row in rows)


def _vectors(messages: Iterable[Any]) -> Floats:
    return np.array([(v.x, v.y, v.z) for v in messages], dtype=np.float64).reshape(-1, 3)
