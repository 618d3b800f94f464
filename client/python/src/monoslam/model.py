"""What a session is and what it answers, as plain values.

Transforms are target_from_source: poses are world_from_camera, camera x right, y down, z forward. Quaternions
are Hamilton's, x y z w. Pixel centers are at integers. Lengths are map units unless `scale` says metric.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class CameraModel(Enum):
    """How a lens bends rays, with its distortion coefficients."""

    PINHOLE = "pinhole"
    """None."""
    RADTAN = "radtan"
    """Brown-Conrady: k1 k2 p1 p2 [k3 [k4 k5 k6]]."""
    KANNALA_BRANDT = "kannala-brandt"
    """Equidistant fisheye: k1 k2 k3 k4."""
    FOV = "fov"
    """Devernay-Faugeras field of view: omega."""
    EXTENDED_UNIFIED = "eucm"
    """Extended unified model: alpha beta; with beta = 1 the unified model."""
    DOUBLE_SPHERE = "double-sphere"
    """Double sphere: xi alpha."""


@dataclass(frozen=True)
class Camera:
    """A camera's calibration, in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    model: CameraModel = CameraModel.PINHOLE

    @staticmethod
    def from_field_of_view(width: int, height: int, horizontal_deg: float = 65.0) -> Camera:
        """A pinhole with its center in the middle of the image: a start where nothing is known.

        Self-calibration puts right what is off by some three percent; beyond that maps are bent. The default
        is about that of a webcam, and of a phone's main camera along the longer side of its video.
        """
        focal = width / 2 / np.tan(np.radians(horizontal_deg) / 2)
        return Camera(width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2)

    def matrix(self) -> Floats:
        """The calibration matrix K, 3 x 3."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)


@dataclass(frozen=True)
class SessionOptions:
    """What a session runs with; `None` takes the server's default."""

    deterministic: bool | None = None
    """Every stage in turn on one thread: same frames and seed, same bytes."""
    seed: int | None = None
    n_features: int | None = None
    """Features asked of the extractor per frame."""
    points: bool | None = None
    lines: bool | None = None
    global_primitives: bool | None = None
    loop_closing: bool | None = None
    max_keyframes: int | None = None
    """Most keyframes the session keeps."""
    refine_calibration: bool | None = None
    """Whether focal length and principal point are refined as the map grows."""
    give_up_calibration: bool | None = None
    """Whether a calibration that the images contradict is given up for the camera that they show."""
    find_mask: bool | None = None
    """Whether what stays in the image while the scene moves is found and left out."""
    readout_ms: float | None = None
    """Rolling shutter: milliseconds from the first row of an image to the last; phones take 8 to 35, 0 is a
    global shutter. `None` has the session find it where the motion shows it."""


class TrackingState(Enum):
    """What tracking a frame came to."""

    UNKNOWN = "unknown"
    """Before the first frame; or a repeated frame whose answer the server no longer has."""
    INITIALIZING = "initializing"
    TRACKED = "tracked"
    WEAK = "weak"
    """A pose that the geometry does not determine well."""
    LOST = "lost"


class Scale(Enum):
    """Of what lengths are."""

    UP_TO_SCALE = "up_to_scale"
    """Map units."""
    METRIC = "metric"
    """Meters."""


@dataclass(frozen=True)
class Readout:
    """How long a camera takes to read the rows of an image."""

    readout_ms: float
    sigma_ms: float
    """Its standard deviation."""


@dataclass(frozen=True)
class Session:
    """A session as it was when asked for."""

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
    durable_sequence: int | None
    """Every frame up to and including this one is in the database."""
    next_sequence: int
    loaded: bool
    has_writer: bool
    last_timestamp_ns: int | None
    """Frames must be later than this."""
    meters_per_unit: float | None
    """`None` while the scale is free."""
    refined_camera: Camera | None
    """The camera as the session has found it to be; `None` while the calibration is used as it was given."""
    found_readout: Readout | None = None
    """The readout of its rolling shutter as found; `None` where told, and until the motion has shown one."""
    map: str | None = None
    """The session whose map its camera extends; `None` if it has one of its own."""


@dataclass(frozen=True)
class Pose:
    """world_from_camera."""

    position: Floats
    """Of the camera in the world, 3."""
    quaternion: Floats
    """x y z w."""

    def rotation(self) -> Floats:
        """3 x 3."""
        return rotations(self.quaternion)

    def matrix(self) -> Floats:
        """4 x 4."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation(), self.position
        return matrix


@dataclass(frozen=True)
class StageTime:
    """Milliseconds of wall time of one stage."""

    name: str
    ms: float


@dataclass(frozen=True)
class Timings:
    """Milliseconds of one frame."""

    total_ms: float = 0.0
    tracking_cpu_ms: float = 0.0
    queue_ms: float = 0.0
    """How long the frame waited."""
    stages: tuple[StageTime, ...] = ()


@dataclass(frozen=True)
class CameraCorrection:
    """How the camera that fits the images best differs from its calibration."""

    focal: float
    """Relative change of both focal lengths."""
    center_x: float
    """Shift of the principal point to the right, in focal lengths."""
    center_y: float
    adopted: bool
    """Whether the map was adjusted to that camera. Otherwise it is more than a calibration can be wrong
    by."""


@dataclass(frozen=True)
class MapCorrection:
    """A place was seen again, or the camera found to be another; 0 where no keyframes are concerned."""

    keyframe: int
    matched_keyframe: int
    n_matches: int
    submap_gone: int | None
    submap_kept: int | None
    camera: CameraCorrection | None
    readout: Readout | None = None
    """That of the camera's rolling shutter, where it was found."""


@dataclass(frozen=True)
class FrameResult:
    """A frame was tracked, or tried to be."""

    sequence: int
    timestamp_ns: int
    state: TrackingState
    reason: str
    """Why there is no pose, or a weak one; empty when tracked."""
    pose: Pose | None
    """world_from_camera."""
    scale: Scale
    submap_id: int
    n_inlier_points: int = 0
    n_inlier_lines: int = 0
    n_keypoints: int = 0
    is_keyframe: bool = False
    relocalized: bool = False
    n_relocalization_candidates: int | None = None
    durable_sequence: int | None = None
    repeated: bool = False
    """The server had the frame already and did not track it twice."""
    corrections: tuple[MapCorrection, ...] = ()
    timings: Timings = field(default_factory=Timings)


@dataclass(frozen=True)
class FrameDropped:
    """A real-time stream had no time for the frame."""

    sequence: int
    reason: str
    pose: None = None


@dataclass(frozen=True)
class FrameRejected:
    """The frame cannot be used; nothing of it was kept."""

    sequence: int
    reason: str
    field: str
    """Which part of the frame is wrong, such as `image.data`."""
    code: str
    pose: None = None


Answer = FrameResult | FrameDropped | FrameRejected
"""What became of a frame. All have `sequence`, `reason` and `pose`."""


@dataclass(frozen=True)
class Localization:
    """Where one image was taken."""

    state: TrackingState
    reason: str
    pose: Pose | None
    """world_from_camera; `None` if the place was not found."""
    scale: Scale
    submap_id: int
    n_inlier_points: int
    n_inlier_lines: int
    n_keypoints: int
    durable_sequence: int | None
    """The map is as of this frame."""
    load_ms: float
    locate_ms: float


@dataclass(frozen=True)
class MapChange:
    """The map was changed; it is in the database a moment later."""

    changed_keyframes: tuple[int, ...]
    removed_keyframes: tuple[int, ...]
    changed_primitives: tuple[int, ...]
    removed_primitives: tuple[int, ...]
    n_changed_points: int
    n_removed_points: int
    n_changed_lines: int
    n_removed_lines: int
    n_keyframes: int
    n_points: int
    n_lines: int
    n_primitives: int


@dataclass(frozen=True)
class Missed:
    """So many events were left out because they were not read in time."""

    n_events: int


Event = Session | FrameResult | MapChange | Missed
"""What happens in a session."""


def rotations(quaternions: Floats) -> Floats:
    """Rotation matrices, (…, 3, 3), of unit quaternions x y z w, (…, 4)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
