"""Between messages of the contract and the values of `model`."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import model
from .errors import ProtocolError
from .v1 import slam_pb2 as pb

_STATES: dict[int, model.TrackingState] = {
    pb.TRACKING_STATE_INITIALISING: model.TrackingState.INITIALIZING,
    pb.TRACKING_STATE_TRACKED: model.TrackingState.TRACKED,
    pb.TRACKING_STATE_WEAK: model.TrackingState.WEAK,
    pb.TRACKING_STATE_LOST: model.TrackingState.LOST,
}
_MODELS = {
    model.CameraModel.PINHOLE: pb.CAMERA_MODEL_PINHOLE,
    model.CameraModel.RADTAN: pb.CAMERA_MODEL_RADTAN,
    model.CameraModel.KANNALA_BRANDT: pb.CAMERA_MODEL_KANNALA_BRANDT,
    model.CameraModel.FOV: pb.CAMERA_MODEL_FOV,
    model.CameraModel.EXTENDED_UNIFIED: pb.CAMERA_MODEL_EXTENDED_UNIFIED,
    model.CameraModel.DOUBLE_SPHERE: pb.CAMERA_MODEL_DOUBLE_SPHERE,
}
_MODEL_OF = {number: kind for kind, number in _MODELS.items()}
_OPTIONS = [
    "deterministic",
    "seed",
    "n_features",
    "points",
    "lines",
    "global_primitives",
    "loop_closing",
    "max_keyframes",
    "refine_calibration",
    "give_up_calibration",
    "find_mask",
    "readout_ms",
]


def state(number: int) -> model.TrackingState:
    return _STATES.get(number, model.TrackingState.UNKNOWN)


def scale(number: int) -> model.Scale:
    return model.Scale.METRIC if number == pb.SCALE_KIND_METRIC else model.Scale.UP_TO_SCALE


def optional(message: Any, name: str) -> Any:
    """A field that may be absent."""
    return getattr(message, name) if message.HasField(name) else None


def camera_message(camera: model.Camera) -> pb.Camera:
    return pb.Camera(
        model=_MODELS[camera.model],
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        distortion=camera.distortion,
    )


def camera(message: pb.Camera) -> model.Camera:
    kind = _MODEL_OF.get(message.model)
    if kind is None:
        raise ProtocolError(
            f"the server's answer has a camera model this package does not know: {message.model}"
        )
    m = message
    return model.Camera(m.width, m.height, m.fx, m.fy, m.cx, m.cy, tuple(m.distortion), kind)


def options_message(options: model.SessionOptions | None) -> pb.SessionOptions:
    given = {} if options is None else {name: getattr(options, name) for name in _OPTIONS}
    return pb.SessionOptions(**{name: value for name, value in given.items() if value is not None})


def session(message: pb.Session) -> model.Session:
    m = message
    refined = optional(m, "refined_camera")
    return model.Session(
        id=m.id,
        camera=camera(m.camera),
        options=model.SessionOptions(**{name: optional(m.options, name) for name in _OPTIONS}),
        created_at_ns=m.created_at_ns,
        state=state(m.state),
        n_frames=m.n_frames,
        n_keyframes=m.n_keyframes,
        n_points=m.n_points,
        n_lines=m.n_lines,
        n_primitives=m.n_primitives,
        n_submaps=m.n_submaps,
        durable_sequence=optional(m, "durable_sequence"),
        next_sequence=m.next_sequence,
        loaded=m.loaded,
        has_writer=m.has_writer,
        last_timestamp_ns=optional(m, "last_timestamp_ns"),
        meters_per_unit=optional(m, "metres_per_unit"),
        refined_camera=None if refined is None else camera(refined),
        found_readout=_readout(m),
        map=optional(m, "map"),
    )


def _readout(message: Any, name: str = "found_readout") -> model.Readout | None:
    found = optional(message, name)
    return None if found is None else model.Readout(found.readout_ms, found.sigma_ms)


def pose(message: Any) -> model.Pose | None:
    """The field `pose_world_from_camera` of a message that has one."""
    p = optional(message, "pose_world_from_camera")
    if p is None:
        return None
    return model.Pose(np.array([p.tx, p.ty, p.tz]), np.array([p.qx, p.qy, p.qz, p.qw]))


def _corrections(messages: Any) -> tuple[model.MapCorrection, ...]:
    def one(m: pb.MapCorrection) -> model.MapCorrection:
        found = optional(m, "camera")
        camera = None
        if found is not None:
            camera = model.CameraCorrection(found.focal, found.centre_x, found.centre_y, found.adopted)
        gone, kept = optional(m, "submap_gone"), optional(m, "submap_kept")
        readout = _readout(m, "readout")
        return model.MapCorrection(m.keyframe, m.matched_keyframe, m.n_matches, gone, kept, camera, readout)

    return tuple(one(message) for message in messages)


def _timings(m: pb.FrameTimings) -> model.Timings:
    stages = tuple(model.StageTime(stage.name, stage.ms) for stage in m.stages)
    return model.Timings(m.total_ms, m.tracking_cpu_ms, m.queue_ms, stages)


def answer(message: pb.StreamFramesResponse) -> model.Answer:
    kind = message.WhichOneof("message")
    if kind == "result":
        return _result(message.result)
    if kind == "dropped":
        return model.FrameDropped(message.dropped.sequence, message.dropped.reason)
    if kind == "rejected":
        r = message.rejected
        return model.FrameRejected(r.sequence, r.reason, r.field, r.code)
    raise ProtocolError(f"the server's answer cannot be used: `{kind}` came where a frame's answer was due")


def _result(m: pb.FrameResult) -> model.FrameResult:
    return model.FrameResult(
        sequence=m.sequence,
        timestamp_ns=m.timestamp_ns,
        state=state(m.state),
        reason=m.reason,
        pose=pose(m),
        scale=scale(m.scale),
        submap_id=m.submap_id,
        n_inlier_points=m.n_inlier_points,
        n_inlier_lines=m.n_inlier_lines,
        n_keypoints=m.n_keypoints,
        is_keyframe=m.is_key_frame,
        relocalized=m.relocalised,
        n_relocalization_candidates=optional(m, "n_relocalisation_candidates"),
        durable_sequence=optional(m, "durable_sequence"),
        repeated=m.repeated,
        corrections=_corrections(m.corrections),
        timings=_timings(m.timings),
    )


def localization(m: pb.LocalizeResponse) -> model.Localization:
    return model.Localization(
        state=state(m.state),
        reason=m.reason,
        pose=pose(m),
        scale=scale(m.scale),
        submap_id=m.submap_id,
        n_inlier_points=m.n_inlier_points,
        n_inlier_lines=m.n_inlier_lines,
        n_keypoints=m.n_keypoints,
        durable_sequence=optional(m, "durable_sequence"),
        load_ms=m.load_ms,
        locate_ms=m.locate_ms,
    )


def event(message: pb.SessionEvent) -> model.Event:
    kind = message.WhichOneof("event")
    if kind == "session":
        return session(message.session)
    if kind == "missed":
        return model.Missed(message.missed)
    if kind == "map":
        return _map_change(message.map)
    if kind == "frame":
        m = message.frame
        return model.FrameResult(
            sequence=m.sequence,
            timestamp_ns=m.timestamp_ns,
            state=state(m.state),
            reason=m.reason,
            pose=pose(m),
            scale=scale(m.scale),
            submap_id=m.submap_id,
            is_keyframe=m.is_key_frame,
            relocalized=m.relocalised,
            corrections=_corrections(m.corrections),
        )
    raise ProtocolError("the server's answer cannot be used: an event is empty")


def _map_change(m: pb.MapEvent) -> model.MapChange:
    return model.MapChange(
        changed_keyframes=tuple(m.changed_keyframes),
        removed_keyframes=tuple(m.removed_keyframes),
        changed_primitives=tuple(m.changed_primitives),
        removed_primitives=tuple(m.removed_primitives),
        n_changed_points=m.n_changed_points,
        n_removed_points=m.n_removed_points,
        n_changed_lines=m.n_changed_lines,
        n_removed_lines=m.n_removed_lines,
        n_keyframes=m.n_keyframes,
        n_points=m.n_points,
        n_lines=m.n_lines,
        n_primitives=m.n_primitives,
    )
