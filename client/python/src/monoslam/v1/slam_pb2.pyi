from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CameraModel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CAMERA_MODEL_UNSPECIFIED: _ClassVar[CameraModel]
    CAMERA_MODEL_PINHOLE: _ClassVar[CameraModel]
    CAMERA_MODEL_RADTAN: _ClassVar[CameraModel]
    CAMERA_MODEL_KANNALA_BRANDT: _ClassVar[CameraModel]
    CAMERA_MODEL_FOV: _ClassVar[CameraModel]
    CAMERA_MODEL_EXTENDED_UNIFIED: _ClassVar[CameraModel]
    CAMERA_MODEL_DOUBLE_SPHERE: _ClassVar[CameraModel]

class Calibration(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CALIBRATION_UNSPECIFIED: _ClassVar[Calibration]
    CALIBRATION_GIVEN: _ClassVar[Calibration]
    CALIBRATION_APPROXIMATE: _ClassVar[Calibration]
    CALIBRATION_UNKNOWN: _ClassVar[Calibration]

class OperationKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OPERATION_KIND_UNSPECIFIED: _ClassVar[OperationKind]
    OPERATION_KIND_OPTIMIZE: _ClassVar[OperationKind]
    OPERATION_KIND_MERGE: _ClassVar[OperationKind]

class OperationState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OPERATION_STATE_UNSPECIFIED: _ClassVar[OperationState]
    OPERATION_STATE_QUEUED: _ClassVar[OperationState]
    OPERATION_STATE_RUNNING: _ClassVar[OperationState]
    OPERATION_STATE_DONE: _ClassVar[OperationState]
    OPERATION_STATE_FAILED: _ClassVar[OperationState]
    OPERATION_STATE_CANCELLED: _ClassVar[OperationState]

class StreamMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STREAM_MODE_UNSPECIFIED: _ClassVar[StreamMode]
    STREAM_MODE_MAP_AND_LOCALIZE: _ClassVar[StreamMode]
    STREAM_MODE_LOCALIZE_ONLY: _ClassVar[StreamMode]

class StreamPolicy(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STREAM_POLICY_UNSPECIFIED: _ClassVar[StreamPolicy]
    STREAM_POLICY_LOSSLESS: _ClassVar[StreamPolicy]
    STREAM_POLICY_REALTIME: _ClassVar[StreamPolicy]

class ImageEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    IMAGE_ENCODING_UNSPECIFIED: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_PNG: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_JPEG: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_GRAY8: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_GRAY16: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_RGB8: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_BGR8: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_RGBA8: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_BGRA8: _ClassVar[ImageEncoding]

class TrackingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRACKING_STATE_UNSPECIFIED: _ClassVar[TrackingState]
    TRACKING_STATE_INITIALISING: _ClassVar[TrackingState]
    TRACKING_STATE_TRACKED: _ClassVar[TrackingState]
    TRACKING_STATE_WEAK: _ClassVar[TrackingState]
    TRACKING_STATE_LOST: _ClassVar[TrackingState]

class ScaleKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCALE_KIND_UNSPECIFIED: _ClassVar[ScaleKind]
    SCALE_KIND_UP_TO_SCALE: _ClassVar[ScaleKind]
    SCALE_KIND_METRIC: _ClassVar[ScaleKind]

class TrajectoryKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRAJECTORY_KIND_UNSPECIFIED: _ClassVar[TrajectoryKind]
    TRAJECTORY_KIND_FRAMES: _ClassVar[TrajectoryKind]
    TRAJECTORY_KIND_KEYFRAMES: _ClassVar[TrajectoryKind]

class SubmapSelection(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SUBMAP_SELECTION_UNSPECIFIED: _ClassVar[SubmapSelection]
    SUBMAP_SELECTION_ALL: _ClassVar[SubmapSelection]
    SUBMAP_SELECTION_LARGEST: _ClassVar[SubmapSelection]

class MapFormat(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MAP_FORMAT_UNSPECIFIED: _ClassVar[MapFormat]
    MAP_FORMAT_PLY: _ClassVar[MapFormat]
    MAP_FORMAT_JSON: _ClassVar[MapFormat]
    MAP_FORMAT_COLMAP_CAMERAS: _ClassVar[MapFormat]
    MAP_FORMAT_COLMAP_IMAGES: _ClassVar[MapFormat]
    MAP_FORMAT_COLMAP_POINTS3D: _ClassVar[MapFormat]
    MAP_FORMAT_TRANSFORMS: _ClassVar[MapFormat]
    MAP_FORMAT_MCAP: _ClassVar[MapFormat]
CAMERA_MODEL_UNSPECIFIED: CameraModel
CAMERA_MODEL_PINHOLE: CameraModel
CAMERA_MODEL_RADTAN: CameraModel
CAMERA_MODEL_KANNALA_BRANDT: CameraModel
CAMERA_MODEL_FOV: CameraModel
CAMERA_MODEL_EXTENDED_UNIFIED: CameraModel
CAMERA_MODEL_DOUBLE_SPHERE: CameraModel
CALIBRATION_UNSPECIFIED: Calibration
CALIBRATION_GIVEN: Calibration
CALIBRATION_APPROXIMATE: Calibration
CALIBRATION_UNKNOWN: Calibration
OPERATION_KIND_UNSPECIFIED: OperationKind
OPERATION_KIND_OPTIMIZE: OperationKind
OPERATION_KIND_MERGE: OperationKind
OPERATION_STATE_UNSPECIFIED: OperationState
OPERATION_STATE_QUEUED: OperationState
OPERATION_STATE_RUNNING: OperationState
OPERATION_STATE_DONE: OperationState
OPERATION_STATE_FAILED: OperationState
OPERATION_STATE_CANCELLED: OperationState
STREAM_MODE_UNSPECIFIED: StreamMode
STREAM_MODE_MAP_AND_LOCALIZE: StreamMode
STREAM_MODE_LOCALIZE_ONLY: StreamMode
STREAM_POLICY_UNSPECIFIED: StreamPolicy
STREAM_POLICY_LOSSLESS: StreamPolicy
STREAM_POLICY_REALTIME: StreamPolicy
IMAGE_ENCODING_UNSPECIFIED: ImageEncoding
IMAGE_ENCODING_PNG: ImageEncoding
IMAGE_ENCODING_JPEG: ImageEncoding
IMAGE_ENCODING_GRAY8: ImageEncoding
IMAGE_ENCODING_GRAY16: ImageEncoding
IMAGE_ENCODING_RGB8: ImageEncoding
IMAGE_ENCODING_BGR8: ImageEncoding
IMAGE_ENCODING_RGBA8: ImageEncoding
IMAGE_ENCODING_BGRA8: ImageEncoding
TRACKING_STATE_UNSPECIFIED: TrackingState
TRACKING_STATE_INITIALISING: TrackingState
TRACKING_STATE_TRACKED: TrackingState
TRACKING_STATE_WEAK: TrackingState
TRACKING_STATE_LOST: TrackingState
SCALE_KIND_UNSPECIFIED: ScaleKind
SCALE_KIND_UP_TO_SCALE: ScaleKind
SCALE_KIND_METRIC: ScaleKind
TRAJECTORY_KIND_UNSPECIFIED: TrajectoryKind
TRAJECTORY_KIND_FRAMES: TrajectoryKind
TRAJECTORY_KIND_KEYFRAMES: TrajectoryKind
SUBMAP_SELECTION_UNSPECIFIED: SubmapSelection
SUBMAP_SELECTION_ALL: SubmapSelection
SUBMAP_SELECTION_LARGEST: SubmapSelection
MAP_FORMAT_UNSPECIFIED: MapFormat
MAP_FORMAT_PLY: MapFormat
MAP_FORMAT_JSON: MapFormat
MAP_FORMAT_COLMAP_CAMERAS: MapFormat
MAP_FORMAT_COLMAP_IMAGES: MapFormat
MAP_FORMAT_COLMAP_POINTS3D: MapFormat
MAP_FORMAT_TRANSFORMS: MapFormat
MAP_FORMAT_MCAP: MapFormat

class Camera(_message.Message):
    __slots__ = ("model", "width", "height", "fx", "fy", "cx", "cy", "distortion")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FX_FIELD_NUMBER: _ClassVar[int]
    FY_FIELD_NUMBER: _ClassVar[int]
    CX_FIELD_NUMBER: _ClassVar[int]
    CY_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_FIELD_NUMBER: _ClassVar[int]
    model: CameraModel
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, model: _Optional[_Union[CameraModel, str]] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., fx: _Optional[float] = ..., fy: _Optional[float] = ..., cx: _Optional[float] = ..., cy: _Optional[float] = ..., distortion: _Optional[_Iterable[float]] = ...) -> None: ...

class SessionOptions(_message.Message):
    __slots__ = ("deterministic", "seed", "n_features", "points", "lines", "global_primitives", "loop_closing", "max_keyframes", "refine_calibration", "calibration", "give_up_calibration", "find_mask", "readout_ms")
    DETERMINISTIC_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    N_FEATURES_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    LINES_FIELD_NUMBER: _ClassVar[int]
    GLOBAL_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    LOOP_CLOSING_FIELD_NUMBER: _ClassVar[int]
    MAX_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    REFINE_CALIBRATION_FIELD_NUMBER: _ClassVar[int]
    CALIBRATION_FIELD_NUMBER: _ClassVar[int]
    GIVE_UP_CALIBRATION_FIELD_NUMBER: _ClassVar[int]
    FIND_MASK_FIELD_NUMBER: _ClassVar[int]
    READOUT_MS_FIELD_NUMBER: _ClassVar[int]
    deterministic: bool
    seed: int
    n_features: int
    points: bool
    lines: bool
    global_primitives: bool
    loop_closing: bool
    max_keyframes: int
    refine_calibration: bool
    calibration: Calibration
    give_up_calibration: bool
    find_mask: bool
    readout_ms: float
    def __init__(self, deterministic: bool = ..., seed: _Optional[int] = ..., n_features: _Optional[int] = ..., points: bool = ..., lines: bool = ..., global_primitives: bool = ..., loop_closing: bool = ..., max_keyframes: _Optional[int] = ..., refine_calibration: bool = ..., calibration: _Optional[_Union[Calibration, str]] = ..., give_up_calibration: bool = ..., find_mask: bool = ..., readout_ms: _Optional[float] = ...) -> None: ...

class Session(_message.Message):
    __slots__ = ("id", "camera", "options", "created_at_ns", "state", "n_frames", "n_keyframes", "n_points", "n_lines", "n_primitives", "n_submaps", "durable_sequence", "next_sequence", "loaded", "has_writer", "last_timestamp_ns", "metres_per_unit", "refined_camera", "damage", "scale_measurement", "mask", "camera_warnings", "found_readout", "map")
    ID_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    N_FRAMES_FIELD_NUMBER: _ClassVar[int]
    N_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_LINES_FIELD_NUMBER: _ClassVar[int]
    N_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    N_SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    LOADED_FIELD_NUMBER: _ClassVar[int]
    HAS_WRITER_FIELD_NUMBER: _ClassVar[int]
    LAST_TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    REFINED_CAMERA_FIELD_NUMBER: _ClassVar[int]
    DAMAGE_FIELD_NUMBER: _ClassVar[int]
    SCALE_MEASUREMENT_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    CAMERA_WARNINGS_FIELD_NUMBER: _ClassVar[int]
    FOUND_READOUT_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    id: str
    camera: Camera
    options: SessionOptions
    created_at_ns: int
    state: TrackingState
    n_frames: int
    n_keyframes: int
    n_points: int
    n_lines: int
    n_primitives: int
    n_submaps: int
    durable_sequence: int
    next_sequence: int
    loaded: bool
    has_writer: bool
    last_timestamp_ns: int
    metres_per_unit: float
    refined_camera: Camera
    damage: str
    scale_measurement: ScaleMeasurement
    mask: Mask
    camera_warnings: _containers.RepeatedScalarFieldContainer[str]
    found_readout: Readout
    map: str
    def __init__(self, id: _Optional[str] = ..., camera: _Optional[_Union[Camera, _Mapping]] = ..., options: _Optional[_Union[SessionOptions, _Mapping]] = ..., created_at_ns: _Optional[int] = ..., state: _Optional[_Union[TrackingState, str]] = ..., n_frames: _Optional[int] = ..., n_keyframes: _Optional[int] = ..., n_points: _Optional[int] = ..., n_lines: _Optional[int] = ..., n_primitives: _Optional[int] = ..., n_submaps: _Optional[int] = ..., durable_sequence: _Optional[int] = ..., next_sequence: _Optional[int] = ..., loaded: bool = ..., has_writer: bool = ..., last_timestamp_ns: _Optional[int] = ..., metres_per_unit: _Optional[float] = ..., refined_camera: _Optional[_Union[Camera, _Mapping]] = ..., damage: _Optional[str] = ..., scale_measurement: _Optional[_Union[ScaleMeasurement, _Mapping]] = ..., mask: _Optional[_Union[Mask, _Mapping]] = ..., camera_warnings: _Optional[_Iterable[str]] = ..., found_readout: _Optional[_Union[Readout, _Mapping]] = ..., map: _Optional[str] = ...) -> None: ...

class Readout(_message.Message):
    __slots__ = ("readout_ms", "sigma_ms")
    READOUT_MS_FIELD_NUMBER: _ClassVar[int]
    SIGMA_MS_FIELD_NUMBER: _ClassVar[int]
    readout_ms: float
    sigma_ms: float
    def __init__(self, readout_ms: _Optional[float] = ..., sigma_ms: _Optional[float] = ...) -> None: ...

class Mask(_message.Message):
    __slots__ = ("share", "given")
    SHARE_FIELD_NUMBER: _ClassVar[int]
    GIVEN_FIELD_NUMBER: _ClassVar[int]
    share: float
    given: bool
    def __init__(self, share: _Optional[float] = ..., given: bool = ...) -> None: ...

class CreateSessionRequest(_message.Message):
    __slots__ = ("session_id", "camera", "options", "mask", "map")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    camera: Camera
    options: SessionOptions
    mask: bytes
    map: str
    def __init__(self, session_id: _Optional[str] = ..., camera: _Optional[_Union[Camera, _Mapping]] = ..., options: _Optional[_Union[SessionOptions, _Mapping]] = ..., mask: _Optional[bytes] = ..., map: _Optional[str] = ...) -> None: ...

class GetSessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class ListSessionsRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListSessionsResponse(_message.Message):
    __slots__ = ("sessions", "next_page_token")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedCompositeFieldContainer[Session]
    next_page_token: str
    def __init__(self, sessions: _Optional[_Iterable[_Union[Session, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DeleteSessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class DeleteSessionResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class UpdateSessionRequest(_message.Message):
    __slots__ = ("session_id", "options")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    options: SessionOptions
    def __init__(self, session_id: _Optional[str] = ..., options: _Optional[_Union[SessionOptions, _Mapping]] = ...) -> None: ...

class SetScaleRequest(_message.Message):
    __slots__ = ("session_id", "metres_per_unit", "distance", "positions")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    metres_per_unit: float
    distance: KnownDistance
    positions: ReferencePositions
    def __init__(self, session_id: _Optional[str] = ..., metres_per_unit: _Optional[float] = ..., distance: _Optional[_Union[KnownDistance, _Mapping]] = ..., positions: _Optional[_Union[ReferencePositions, _Mapping]] = ...) -> None: ...

class KnownDistance(_message.Message):
    __slots__ = ("to", "metres")
    FROM_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    METRES_FIELD_NUMBER: _ClassVar[int]
    to: ScalePlace
    metres: float
    def __init__(self, to: _Optional[_Union[ScalePlace, _Mapping]] = ..., metres: _Optional[float] = ..., **kwargs) -> None: ...

class ScalePlace(_message.Message):
    __slots__ = ("point_id", "keyframe_id", "pixel")
    POINT_ID_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_ID_FIELD_NUMBER: _ClassVar[int]
    PIXEL_FIELD_NUMBER: _ClassVar[int]
    point_id: int
    keyframe_id: int
    pixel: PickedPixel
    def __init__(self, point_id: _Optional[int] = ..., keyframe_id: _Optional[int] = ..., pixel: _Optional[_Union[PickedPixel, _Mapping]] = ...) -> None: ...

class PickedPixel(_message.Message):
    __slots__ = ("keyframe_id", "x", "y")
    KEYFRAME_ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    keyframe_id: int
    x: float
    y: float
    def __init__(self, keyframe_id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ...) -> None: ...

class ReferencePositions(_message.Message):
    __slots__ = ("rows", "max_error_m")
    ROWS_FIELD_NUMBER: _ClassVar[int]
    MAX_ERROR_M_FIELD_NUMBER: _ClassVar[int]
    rows: _containers.RepeatedCompositeFieldContainer[ReferencePosition]
    max_error_m: float
    def __init__(self, rows: _Optional[_Iterable[_Union[ReferencePosition, _Mapping]]] = ..., max_error_m: _Optional[float] = ...) -> None: ...

class ReferencePosition(_message.Message):
    __slots__ = ("sequence", "timestamp_ns", "position")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    timestamp_ns: int
    position: Vector3
    def __init__(self, sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., position: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class ScaleMeasurement(_message.Message):
    __slots__ = ("metres_per_unit", "map_distance", "places", "residuals", "rms_m", "n_used", "pose_reference_from_map", "submap_id")
    METRES_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    MAP_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    RESIDUALS_FIELD_NUMBER: _ClassVar[int]
    RMS_M_FIELD_NUMBER: _ClassVar[int]
    N_USED_FIELD_NUMBER: _ClassVar[int]
    POSE_REFERENCE_FROM_MAP_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    metres_per_unit: float
    map_distance: float
    places: _containers.RepeatedScalarFieldContainer[str]
    residuals: _containers.RepeatedCompositeFieldContainer[ScaleResidual]
    rms_m: float
    n_used: int
    pose_reference_from_map: Pose
    submap_id: int
    def __init__(self, metres_per_unit: _Optional[float] = ..., map_distance: _Optional[float] = ..., places: _Optional[_Iterable[str]] = ..., residuals: _Optional[_Iterable[_Union[ScaleResidual, _Mapping]]] = ..., rms_m: _Optional[float] = ..., n_used: _Optional[int] = ..., pose_reference_from_map: _Optional[_Union[Pose, _Mapping]] = ..., submap_id: _Optional[int] = ...) -> None: ...

class ScaleResidual(_message.Message):
    __slots__ = ("error_m", "used", "reason")
    ERROR_M_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    error_m: float
    used: bool
    reason: str
    def __init__(self, error_m: _Optional[float] = ..., used: bool = ..., reason: _Optional[str] = ...) -> None: ...

class LocalizeRequest(_message.Message):
    __slots__ = ("session_id", "image", "camera", "fov_deg", "unknown_camera", "session_ids", "all_sessions", "near", "radius")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    IMAGE_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    FOV_DEG_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_CAMERA_FIELD_NUMBER: _ClassVar[int]
    SESSION_IDS_FIELD_NUMBER: _ClassVar[int]
    ALL_SESSIONS_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    image: Image
    camera: Camera
    fov_deg: float
    unknown_camera: bool
    session_ids: _containers.RepeatedScalarFieldContainer[str]
    all_sessions: bool
    near: Vector3
    radius: float
    def __init__(self, session_id: _Optional[str] = ..., image: _Optional[_Union[Image, _Mapping]] = ..., camera: _Optional[_Union[Camera, _Mapping]] = ..., fov_deg: _Optional[float] = ..., unknown_camera: bool = ..., session_ids: _Optional[_Iterable[str]] = ..., all_sessions: bool = ..., near: _Optional[_Union[Vector3, _Mapping]] = ..., radius: _Optional[float] = ...) -> None: ...

class LocalizeResponse(_message.Message):
    __slots__ = ("state", "reason", "pose_world_from_camera", "scale", "submap_id", "n_inlier_points", "n_inlier_lines", "n_keypoints", "durable_sequence", "load_ms", "locate_ms", "session_id", "covariance", "camera", "n_sessions_searched", "n_sessions_tried")
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_FROM_CAMERA_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    N_INLIER_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_INLIER_LINES_FIELD_NUMBER: _ClassVar[int]
    N_KEYPOINTS_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    LOAD_MS_FIELD_NUMBER: _ClassVar[int]
    LOCATE_MS_FIELD_NUMBER: _ClassVar[int]
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    N_SESSIONS_SEARCHED_FIELD_NUMBER: _ClassVar[int]
    N_SESSIONS_TRIED_FIELD_NUMBER: _ClassVar[int]
    state: TrackingState
    reason: str
    pose_world_from_camera: Pose
    scale: ScaleKind
    submap_id: int
    n_inlier_points: int
    n_inlier_lines: int
    n_keypoints: int
    durable_sequence: int
    load_ms: float
    locate_ms: float
    session_id: str
    covariance: _containers.RepeatedScalarFieldContainer[float]
    camera: Camera
    n_sessions_searched: int
    n_sessions_tried: int
    def __init__(self, state: _Optional[_Union[TrackingState, str]] = ..., reason: _Optional[str] = ..., pose_world_from_camera: _Optional[_Union[Pose, _Mapping]] = ..., scale: _Optional[_Union[ScaleKind, str]] = ..., submap_id: _Optional[int] = ..., n_inlier_points: _Optional[int] = ..., n_inlier_lines: _Optional[int] = ..., n_keypoints: _Optional[int] = ..., durable_sequence: _Optional[int] = ..., load_ms: _Optional[float] = ..., locate_ms: _Optional[float] = ..., session_id: _Optional[str] = ..., covariance: _Optional[_Iterable[float]] = ..., camera: _Optional[_Union[Camera, _Mapping]] = ..., n_sessions_searched: _Optional[int] = ..., n_sessions_tried: _Optional[int] = ...) -> None: ...

class OptimizeMapRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class MergeSessionsRequest(_message.Message):
    __slots__ = ("into",)
    INTO_FIELD_NUMBER: _ClassVar[int]
    FROM_FIELD_NUMBER: _ClassVar[int]
    into: str
    def __init__(self, into: _Optional[str] = ..., **kwargs) -> None: ...

class GetOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class ListOperationsRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class ListOperationsResponse(_message.Message):
    __slots__ = ("operations",)
    OPERATIONS_FIELD_NUMBER: _ClassVar[int]
    operations: _containers.RepeatedCompositeFieldContainer[Operation]
    def __init__(self, operations: _Optional[_Iterable[_Union[Operation, _Mapping]]] = ...) -> None: ...

class CancelOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class Operation(_message.Message):
    __slots__ = ("id", "kind", "session_id", "from_session_id", "state", "progress", "n_iterations", "message", "error_code", "created_at_ns", "ended_at_ns", "optimized", "merged")
    ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    FROM_SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    N_ITERATIONS_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    ERROR_CODE_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    ENDED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    OPTIMIZED_FIELD_NUMBER: _ClassVar[int]
    MERGED_FIELD_NUMBER: _ClassVar[int]
    id: str
    kind: OperationKind
    session_id: str
    from_session_id: str
    state: OperationState
    progress: float
    n_iterations: int
    message: str
    error_code: str
    created_at_ns: int
    ended_at_ns: int
    optimized: OptimizeResult
    merged: MergeResult
    def __init__(self, id: _Optional[str] = ..., kind: _Optional[_Union[OperationKind, str]] = ..., session_id: _Optional[str] = ..., from_session_id: _Optional[str] = ..., state: _Optional[_Union[OperationState, str]] = ..., progress: _Optional[float] = ..., n_iterations: _Optional[int] = ..., message: _Optional[str] = ..., error_code: _Optional[str] = ..., created_at_ns: _Optional[int] = ..., ended_at_ns: _Optional[int] = ..., optimized: _Optional[_Union[OptimizeResult, _Mapping]] = ..., merged: _Optional[_Union[MergeResult, _Mapping]] = ...) -> None: ...

class OptimizeResult(_message.Message):
    __slots__ = ("cost_before", "cost_after", "n_keyframes", "n_points", "n_lines")
    COST_BEFORE_FIELD_NUMBER: _ClassVar[int]
    COST_AFTER_FIELD_NUMBER: _ClassVar[int]
    N_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_LINES_FIELD_NUMBER: _ClassVar[int]
    cost_before: float
    cost_after: float
    n_keyframes: int
    n_points: int
    n_lines: int
    def __init__(self, cost_before: _Optional[float] = ..., cost_after: _Optional[float] = ..., n_keyframes: _Optional[int] = ..., n_points: _Optional[int] = ..., n_lines: _Optional[int] = ...) -> None: ...

class MergeResult(_message.Message):
    __slots__ = ("found", "places", "n_keyframes", "n_frames", "sequence_shift", "timestamp_shift_ns", "n_loops", "cost_before", "cost_after")
    FOUND_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    N_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_FRAMES_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_SHIFT_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_SHIFT_NS_FIELD_NUMBER: _ClassVar[int]
    N_LOOPS_FIELD_NUMBER: _ClassVar[int]
    COST_BEFORE_FIELD_NUMBER: _ClassVar[int]
    COST_AFTER_FIELD_NUMBER: _ClassVar[int]
    found: bool
    places: _containers.RepeatedCompositeFieldContainer[MergedPlace]
    n_keyframes: int
    n_frames: int
    sequence_shift: int
    timestamp_shift_ns: int
    n_loops: int
    cost_before: float
    cost_after: float
    def __init__(self, found: bool = ..., places: _Optional[_Iterable[_Union[MergedPlace, _Mapping]]] = ..., n_keyframes: _Optional[int] = ..., n_frames: _Optional[int] = ..., sequence_shift: _Optional[int] = ..., timestamp_shift_ns: _Optional[int] = ..., n_loops: _Optional[int] = ..., cost_before: _Optional[float] = ..., cost_after: _Optional[float] = ...) -> None: ...

class MergedPlace(_message.Message):
    __slots__ = ("from_keyframe", "into_keyframe", "n_matches", "scale")
    FROM_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    INTO_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    N_MATCHES_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    from_keyframe: int
    into_keyframe: int
    n_matches: int
    scale: float
    def __init__(self, from_keyframe: _Optional[int] = ..., into_keyframe: _Optional[int] = ..., n_matches: _Optional[int] = ..., scale: _Optional[float] = ...) -> None: ...

class WatchMapRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class SessionEvent(_message.Message):
    __slots__ = ("session", "frame", "map", "missed")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    MISSED_FIELD_NUMBER: _ClassVar[int]
    session: Session
    frame: FrameEvent
    map: MapEvent
    missed: int
    def __init__(self, session: _Optional[_Union[Session, _Mapping]] = ..., frame: _Optional[_Union[FrameEvent, _Mapping]] = ..., map: _Optional[_Union[MapEvent, _Mapping]] = ..., missed: _Optional[int] = ...) -> None: ...

class FrameEvent(_message.Message):
    __slots__ = ("sequence", "timestamp_ns", "state", "reason", "pose_world_from_camera", "scale", "submap_id", "is_key_frame", "relocalised", "corrections")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_FROM_CAMERA_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    IS_KEY_FRAME_FIELD_NUMBER: _ClassVar[int]
    RELOCALISED_FIELD_NUMBER: _ClassVar[int]
    CORRECTIONS_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    timestamp_ns: int
    state: TrackingState
    reason: str
    pose_world_from_camera: Pose
    scale: ScaleKind
    submap_id: int
    is_key_frame: bool
    relocalised: bool
    corrections: _containers.RepeatedCompositeFieldContainer[MapCorrection]
    def __init__(self, sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., state: _Optional[_Union[TrackingState, str]] = ..., reason: _Optional[str] = ..., pose_world_from_camera: _Optional[_Union[Pose, _Mapping]] = ..., scale: _Optional[_Union[ScaleKind, str]] = ..., submap_id: _Optional[int] = ..., is_key_frame: bool = ..., relocalised: bool = ..., corrections: _Optional[_Iterable[_Union[MapCorrection, _Mapping]]] = ...) -> None: ...

class MapCorrection(_message.Message):
    __slots__ = ("keyframe", "matched_keyframe", "n_matches", "submap_gone", "submap_kept", "camera", "readout")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    MATCHED_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    N_MATCHES_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_GONE_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_KEPT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    READOUT_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    matched_keyframe: int
    n_matches: int
    submap_gone: int
    submap_kept: int
    camera: CameraCorrection
    readout: Readout
    def __init__(self, keyframe: _Optional[int] = ..., matched_keyframe: _Optional[int] = ..., n_matches: _Optional[int] = ..., submap_gone: _Optional[int] = ..., submap_kept: _Optional[int] = ..., camera: _Optional[_Union[CameraCorrection, _Mapping]] = ..., readout: _Optional[_Union[Readout, _Mapping]] = ...) -> None: ...

class CameraCorrection(_message.Message):
    __slots__ = ("focal", "centre_x", "centre_y", "adopted")
    FOCAL_FIELD_NUMBER: _ClassVar[int]
    CENTRE_X_FIELD_NUMBER: _ClassVar[int]
    CENTRE_Y_FIELD_NUMBER: _ClassVar[int]
    ADOPTED_FIELD_NUMBER: _ClassVar[int]
    focal: float
    centre_x: float
    centre_y: float
    adopted: bool
    def __init__(self, focal: _Optional[float] = ..., centre_x: _Optional[float] = ..., centre_y: _Optional[float] = ..., adopted: bool = ...) -> None: ...

class MapEvent(_message.Message):
    __slots__ = ("changed_keyframes", "removed_keyframes", "n_changed_points", "n_removed_points", "n_changed_lines", "n_removed_lines", "changed_primitives", "removed_primitives", "n_keyframes", "n_points", "n_lines", "n_primitives")
    CHANGED_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    REMOVED_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_CHANGED_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_REMOVED_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_CHANGED_LINES_FIELD_NUMBER: _ClassVar[int]
    N_REMOVED_LINES_FIELD_NUMBER: _ClassVar[int]
    CHANGED_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    REMOVED_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    N_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_LINES_FIELD_NUMBER: _ClassVar[int]
    N_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    changed_keyframes: _containers.RepeatedScalarFieldContainer[int]
    removed_keyframes: _containers.RepeatedScalarFieldContainer[int]
    n_changed_points: int
    n_removed_points: int
    n_changed_lines: int
    n_removed_lines: int
    changed_primitives: _containers.RepeatedScalarFieldContainer[int]
    removed_primitives: _containers.RepeatedScalarFieldContainer[int]
    n_keyframes: int
    n_points: int
    n_lines: int
    n_primitives: int
    def __init__(self, changed_keyframes: _Optional[_Iterable[int]] = ..., removed_keyframes: _Optional[_Iterable[int]] = ..., n_changed_points: _Optional[int] = ..., n_removed_points: _Optional[int] = ..., n_changed_lines: _Optional[int] = ..., n_removed_lines: _Optional[int] = ..., changed_primitives: _Optional[_Iterable[int]] = ..., removed_primitives: _Optional[_Iterable[int]] = ..., n_keyframes: _Optional[int] = ..., n_points: _Optional[int] = ..., n_lines: _Optional[int] = ..., n_primitives: _Optional[int] = ...) -> None: ...

class StreamFramesRequest(_message.Message):
    __slots__ = ("open", "frame")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    open: OpenStream
    frame: Frame
    def __init__(self, open: _Optional[_Union[OpenStream, _Mapping]] = ..., frame: _Optional[_Union[Frame, _Mapping]] = ...) -> None: ...

class OpenStream(_message.Message):
    __slots__ = ("session_id", "mode", "policy", "take_over", "new_segment")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    TAKE_OVER_FIELD_NUMBER: _ClassVar[int]
    NEW_SEGMENT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    mode: StreamMode
    policy: StreamPolicy
    take_over: bool
    new_segment: bool
    def __init__(self, session_id: _Optional[str] = ..., mode: _Optional[_Union[StreamMode, str]] = ..., policy: _Optional[_Union[StreamPolicy, str]] = ..., take_over: bool = ..., new_segment: bool = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("sequence", "timestamp_ns", "image")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    IMAGE_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    timestamp_ns: int
    image: Image
    def __init__(self, sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., image: _Optional[_Union[Image, _Mapping]] = ...) -> None: ...

class Image(_message.Message):
    __slots__ = ("encoding", "width", "height", "row_stride", "data")
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    ROW_STRIDE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    encoding: ImageEncoding
    width: int
    height: int
    row_stride: int
    data: bytes
    def __init__(self, encoding: _Optional[_Union[ImageEncoding, str]] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., row_stride: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class StreamFramesResponse(_message.Message):
    __slots__ = ("opened", "result", "dropped", "rejected")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FIELD_NUMBER: _ClassVar[int]
    opened: StreamOpened
    result: FrameResult
    dropped: FrameDropped
    rejected: FrameRejected
    def __init__(self, opened: _Optional[_Union[StreamOpened, _Mapping]] = ..., result: _Optional[_Union[FrameResult, _Mapping]] = ..., dropped: _Optional[_Union[FrameDropped, _Mapping]] = ..., rejected: _Optional[_Union[FrameRejected, _Mapping]] = ...) -> None: ...

class StreamOpened(_message.Message):
    __slots__ = ("session",)
    SESSION_FIELD_NUMBER: _ClassVar[int]
    session: Session
    def __init__(self, session: _Optional[_Union[Session, _Mapping]] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
    TX_FIELD_NUMBER: _ClassVar[int]
    TY_FIELD_NUMBER: _ClassVar[int]
    TZ_FIELD_NUMBER: _ClassVar[int]
    QX_FIELD_NUMBER: _ClassVar[int]
    QY_FIELD_NUMBER: _ClassVar[int]
    QZ_FIELD_NUMBER: _ClassVar[int]
    QW_FIELD_NUMBER: _ClassVar[int]
    tx: float
    ty: float
    tz: float
    qx: float
    qy: float
    qz: float
    qw: float
    def __init__(self, tx: _Optional[float] = ..., ty: _Optional[float] = ..., tz: _Optional[float] = ..., qx: _Optional[float] = ..., qy: _Optional[float] = ..., qz: _Optional[float] = ..., qw: _Optional[float] = ...) -> None: ...

class FrameResult(_message.Message):
    __slots__ = ("sequence", "timestamp_ns", "state", "reason", "pose_world_from_camera", "scale", "submap_id", "n_inlier_points", "n_inlier_lines", "is_key_frame", "relocalised", "durable_sequence", "timings", "repeated", "n_keypoints", "n_relocalisation_candidates", "corrections")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_FROM_CAMERA_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    N_INLIER_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_INLIER_LINES_FIELD_NUMBER: _ClassVar[int]
    IS_KEY_FRAME_FIELD_NUMBER: _ClassVar[int]
    RELOCALISED_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMINGS_FIELD_NUMBER: _ClassVar[int]
    REPEATED_FIELD_NUMBER: _ClassVar[int]
    N_KEYPOINTS_FIELD_NUMBER: _ClassVar[int]
    N_RELOCALISATION_CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    CORRECTIONS_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    timestamp_ns: int
    state: TrackingState
    reason: str
    pose_world_from_camera: Pose
    scale: ScaleKind
    submap_id: int
    n_inlier_points: int
    n_inlier_lines: int
    is_key_frame: bool
    relocalised: bool
    durable_sequence: int
    timings: FrameTimings
    repeated: bool
    n_keypoints: int
    n_relocalisation_candidates: int
    corrections: _containers.RepeatedCompositeFieldContainer[MapCorrection]
    def __init__(self, sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., state: _Optional[_Union[TrackingState, str]] = ..., reason: _Optional[str] = ..., pose_world_from_camera: _Optional[_Union[Pose, _Mapping]] = ..., scale: _Optional[_Union[ScaleKind, str]] = ..., submap_id: _Optional[int] = ..., n_inlier_points: _Optional[int] = ..., n_inlier_lines: _Optional[int] = ..., is_key_frame: bool = ..., relocalised: bool = ..., durable_sequence: _Optional[int] = ..., timings: _Optional[_Union[FrameTimings, _Mapping]] = ..., repeated: bool = ..., n_keypoints: _Optional[int] = ..., n_relocalisation_candidates: _Optional[int] = ..., corrections: _Optional[_Iterable[_Union[MapCorrection, _Mapping]]] = ...) -> None: ...

class FrameTimings(_message.Message):
    __slots__ = ("stages", "total_ms", "tracking_cpu_ms", "queue_ms")
    STAGES_FIELD_NUMBER: _ClassVar[int]
    TOTAL_MS_FIELD_NUMBER: _ClassVar[int]
    TRACKING_CPU_MS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_MS_FIELD_NUMBER: _ClassVar[int]
    stages: _containers.RepeatedCompositeFieldContainer[StageTime]
    total_ms: float
    tracking_cpu_ms: float
    queue_ms: float
    def __init__(self, stages: _Optional[_Iterable[_Union[StageTime, _Mapping]]] = ..., total_ms: _Optional[float] = ..., tracking_cpu_ms: _Optional[float] = ..., queue_ms: _Optional[float] = ...) -> None: ...

class StageTime(_message.Message):
    __slots__ = ("name", "ms")
    NAME_FIELD_NUMBER: _ClassVar[int]
    MS_FIELD_NUMBER: _ClassVar[int]
    name: str
    ms: float
    def __init__(self, name: _Optional[str] = ..., ms: _Optional[float] = ...) -> None: ...

class FrameDropped(_message.Message):
    __slots__ = ("sequence", "reason")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    reason: str
    def __init__(self, sequence: _Optional[int] = ..., reason: _Optional[str] = ...) -> None: ...

class FrameRejected(_message.Message):
    __slots__ = ("sequence", "field", "reason", "code")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    field: str
    reason: str
    code: str
    def __init__(self, sequence: _Optional[int] = ..., field: _Optional[str] = ..., reason: _Optional[str] = ..., code: _Optional[str] = ...) -> None: ...

class Vector3(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class BoundingBox(_message.Message):
    __slots__ = ("min", "max")
    MIN_FIELD_NUMBER: _ClassVar[int]
    MAX_FIELD_NUMBER: _ClassVar[int]
    min: Vector3
    max: Vector3
    def __init__(self, min: _Optional[_Union[Vector3, _Mapping]] = ..., max: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class ListKeyframesRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class ListKeyframesResponse(_message.Message):
    __slots__ = ("scale", "keyframes")
    SCALE_FIELD_NUMBER: _ClassVar[int]
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    scale: ScaleKind
    keyframes: _containers.RepeatedCompositeFieldContainer[Keyframe]
    def __init__(self, scale: _Optional[_Union[ScaleKind, str]] = ..., keyframes: _Optional[_Iterable[_Union[Keyframe, _Mapping]]] = ...) -> None: ...

class Keyframe(_message.Message):
    __slots__ = ("id", "submap_id", "sequence", "timestamp_ns", "pose_world_from_camera", "parent", "n_keypoints", "n_points", "n_segments", "n_lines", "has_image")
    ID_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_FROM_CAMERA_FIELD_NUMBER: _ClassVar[int]
    PARENT_FIELD_NUMBER: _ClassVar[int]
    N_KEYPOINTS_FIELD_NUMBER: _ClassVar[int]
    N_POINTS_FIELD_NUMBER: _ClassVar[int]
    N_SEGMENTS_FIELD_NUMBER: _ClassVar[int]
    N_LINES_FIELD_NUMBER: _ClassVar[int]
    HAS_IMAGE_FIELD_NUMBER: _ClassVar[int]
    id: int
    submap_id: int
    sequence: int
    timestamp_ns: int
    pose_world_from_camera: Pose
    parent: int
    n_keypoints: int
    n_points: int
    n_segments: int
    n_lines: int
    has_image: bool
    def __init__(self, id: _Optional[int] = ..., submap_id: _Optional[int] = ..., sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., pose_world_from_camera: _Optional[_Union[Pose, _Mapping]] = ..., parent: _Optional[int] = ..., n_keypoints: _Optional[int] = ..., n_points: _Optional[int] = ..., n_segments: _Optional[int] = ..., n_lines: _Optional[int] = ..., has_image: bool = ...) -> None: ...

class QueryPointsRequest(_message.Message):
    __slots__ = ("session_id", "bbox", "near", "radius", "min_observations", "submap_id")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    BBOX_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    MIN_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    bbox: BoundingBox
    near: Vector3
    radius: float
    min_observations: int
    submap_id: int
    def __init__(self, session_id: _Optional[str] = ..., bbox: _Optional[_Union[BoundingBox, _Mapping]] = ..., near: _Optional[_Union[Vector3, _Mapping]] = ..., radius: _Optional[float] = ..., min_observations: _Optional[int] = ..., submap_id: _Optional[int] = ...) -> None: ...

class QueryPointsResponse(_message.Message):
    __slots__ = ("scale", "points")
    SCALE_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    scale: ScaleKind
    points: _containers.RepeatedCompositeFieldContainer[Point]
    def __init__(self, scale: _Optional[_Union[ScaleKind, str]] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ...) -> None: ...

class Point(_message.Message):
    __slots__ = ("id", "submap_id", "position", "n_observations")
    ID_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    N_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    id: int
    submap_id: int
    position: Vector3
    n_observations: int
    def __init__(self, id: _Optional[int] = ..., submap_id: _Optional[int] = ..., position: _Optional[_Union[Vector3, _Mapping]] = ..., n_observations: _Optional[int] = ...) -> None: ...

class QueryLinesRequest(_message.Message):
    __slots__ = ("session_id", "bbox", "near", "radius", "min_observations", "submap_id", "primitive_id")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    BBOX_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    MIN_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVE_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    bbox: BoundingBox
    near: Vector3
    radius: float
    min_observations: int
    submap_id: int
    primitive_id: int
    def __init__(self, session_id: _Optional[str] = ..., bbox: _Optional[_Union[BoundingBox, _Mapping]] = ..., near: _Optional[_Union[Vector3, _Mapping]] = ..., radius: _Optional[float] = ..., min_observations: _Optional[int] = ..., submap_id: _Optional[int] = ..., primitive_id: _Optional[int] = ...) -> None: ...

class QueryLinesResponse(_message.Message):
    __slots__ = ("scale", "lines")
    SCALE_FIELD_NUMBER: _ClassVar[int]
    LINES_FIELD_NUMBER: _ClassVar[int]
    scale: ScaleKind
    lines: _containers.RepeatedCompositeFieldContainer[Line]
    def __init__(self, scale: _Optional[_Union[ScaleKind, str]] = ..., lines: _Optional[_Iterable[_Union[Line, _Mapping]]] = ...) -> None: ...

class Line(_message.Message):
    __slots__ = ("id", "submap_id", "start", "end", "direction", "moment", "n_observations", "primitive_id")
    ID_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    END_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    MOMENT_FIELD_NUMBER: _ClassVar[int]
    N_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVE_ID_FIELD_NUMBER: _ClassVar[int]
    id: int
    submap_id: int
    start: Vector3
    end: Vector3
    direction: Vector3
    moment: Vector3
    n_observations: int
    primitive_id: int
    def __init__(self, id: _Optional[int] = ..., submap_id: _Optional[int] = ..., start: _Optional[_Union[Vector3, _Mapping]] = ..., end: _Optional[_Union[Vector3, _Mapping]] = ..., direction: _Optional[_Union[Vector3, _Mapping]] = ..., moment: _Optional[_Union[Vector3, _Mapping]] = ..., n_observations: _Optional[int] = ..., primitive_id: _Optional[int] = ...) -> None: ...

class ListPrimitivesRequest(_message.Message):
    __slots__ = ("session_id", "submap_id")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    submap_id: int
    def __init__(self, session_id: _Optional[str] = ..., submap_id: _Optional[int] = ...) -> None: ...

class ListPrimitivesResponse(_message.Message):
    __slots__ = ("primitives",)
    PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    primitives: _containers.RepeatedCompositeFieldContainer[Primitive]
    def __init__(self, primitives: _Optional[_Iterable[_Union[Primitive, _Mapping]]] = ...) -> None: ...

class Primitive(_message.Message):
    __slots__ = ("id", "submap_id", "direction", "covariance", "std_deg", "n_keyframes", "n_lines")
    ID_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STD_DEG_FIELD_NUMBER: _ClassVar[int]
    N_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    N_LINES_FIELD_NUMBER: _ClassVar[int]
    id: int
    submap_id: int
    direction: Vector3
    covariance: _containers.RepeatedScalarFieldContainer[float]
    std_deg: float
    n_keyframes: int
    n_lines: int
    def __init__(self, id: _Optional[int] = ..., submap_id: _Optional[int] = ..., direction: _Optional[_Union[Vector3, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., std_deg: _Optional[float] = ..., n_keyframes: _Optional[int] = ..., n_lines: _Optional[int] = ...) -> None: ...

class GetTrajectoryRequest(_message.Message):
    __slots__ = ("session_id", "kind", "submap_id", "from_timestamp_ns", "to_timestamp_ns", "submaps")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    FROM_TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    TO_TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    kind: TrajectoryKind
    submap_id: int
    from_timestamp_ns: int
    to_timestamp_ns: int
    submaps: SubmapSelection
    def __init__(self, session_id: _Optional[str] = ..., kind: _Optional[_Union[TrajectoryKind, str]] = ..., submap_id: _Optional[int] = ..., from_timestamp_ns: _Optional[int] = ..., to_timestamp_ns: _Optional[int] = ..., submaps: _Optional[_Union[SubmapSelection, str]] = ...) -> None: ...

class GetTrajectoryResponse(_message.Message):
    __slots__ = ("scale", "poses", "n_poses_left_out")
    SCALE_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    N_POSES_LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    scale: ScaleKind
    poses: _containers.RepeatedCompositeFieldContainer[TrajectoryPose]
    n_poses_left_out: int
    def __init__(self, scale: _Optional[_Union[ScaleKind, str]] = ..., poses: _Optional[_Iterable[_Union[TrajectoryPose, _Mapping]]] = ..., n_poses_left_out: _Optional[int] = ...) -> None: ...

class TrajectoryPose(_message.Message):
    __slots__ = ("sequence", "timestamp_ns", "state", "submap_id", "backfilled", "pose_world_from_camera")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    BACKFILLED_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_FROM_CAMERA_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    timestamp_ns: int
    state: TrackingState
    submap_id: int
    backfilled: bool
    pose_world_from_camera: Pose
    def __init__(self, sequence: _Optional[int] = ..., timestamp_ns: _Optional[int] = ..., state: _Optional[_Union[TrackingState, str]] = ..., submap_id: _Optional[int] = ..., backfilled: bool = ..., pose_world_from_camera: _Optional[_Union[Pose, _Mapping]] = ...) -> None: ...

class ExportMapRequest(_message.Message):
    __slots__ = ("session_id", "format", "submap_id")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    format: MapFormat
    submap_id: int
    def __init__(self, session_id: _Optional[str] = ..., format: _Optional[_Union[MapFormat, str]] = ..., submap_id: _Optional[int] = ...) -> None: ...

class ExportMapResponse(_message.Message):
    __slots__ = ("file", "data")
    FILE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    file: MapFile
    data: bytes
    def __init__(self, file: _Optional[_Union[MapFile, _Mapping]] = ..., data: _Optional[bytes] = ...) -> None: ...

class MapFile(_message.Message):
    __slots__ = ("name", "media_type", "n_bytes")
    NAME_FIELD_NUMBER: _ClassVar[int]
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    N_BYTES_FIELD_NUMBER: _ClassVar[int]
    name: str
    media_type: str
    n_bytes: int
    def __init__(self, name: _Optional[str] = ..., media_type: _Optional[str] = ..., n_bytes: _Optional[int] = ...) -> None: ...
