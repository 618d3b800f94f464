//! The messages of Foxglove <https://docs.foxglove.dev/docs/visualization/message-schemas/introduction> that
//! a map is made of, and their JSON schemas. Bytes are text in base 64; a schema has to say so.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use geometry::{CameraModel, CameraParameters};
use serde_json::{Value, json};

use super::ply::Color;
use crate::model::Pose;

/// A kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Schema {
    CameraCalibration,
    CompressedImage,
    FrameTransform,
    PointCloud,
    PoseInFrame,
    SceneUpdate,
}

impl Schema {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::CameraCalibration => "foxglove.CameraCalibration",
            Self::CompressedImage => "foxglove.CompressedImage",
            Self::FrameTransform => "foxglove.FrameTransform",
            Self::PointCloud => "foxglove.PointCloud",
            Self::PoseInFrame => "foxglove.PoseInFrame",
            Self::SceneUpdate => "foxglove.SceneUpdate",
        }
    }

    /// The fields, as a JSON schema.
    pub(super) fn definition(self) -> Value {
        let fields = match self {
            Self::CameraCalibration => json!({
                "timestamp": time(), "frame_id": text(), "width": whole(), "height": whole(),
                "distortion_model": text(), "D": list(number()), "K": list(number()), "R": list(number()),
                "P": list(number()),
            }),
            Self::CompressedImage => json!({
                "timestamp": time(), "frame_id": text(), "data": bytes(), "format": text(),
            }),
            Self::FrameTransform => json!({
                "timestamp": time(), "parent_frame_id": text(), "child_frame_id": text(),
                "translation": numbers(&["x", "y", "z"]), "rotation": numbers(&["x", "y", "z", "w"]),
            }),
            Self::PointCloud => json!({
                "timestamp": time(), "frame_id": text(), "pose": pose(), "point_stride": whole(),
                "fields": list(object(json!({"name": text(), "offset": whole(), "type": whole()}))),
                "data": bytes(),
            }),
            Self::PoseInFrame => json!({"timestamp": time(), "frame_id": text(), "pose": pose()}),
            Self::SceneUpdate => json!({
                "deletions": list(object(json!({"timestamp": time(), "type": whole(), "id": text()}))),
                "entities": list(entity()),
            }),
        };
        let mut schema = object(fields);
        schema["title"] = self.name().into();
        schema
    }
}

fn object(fields: Value) -> Value {
    json!({"type": "object", "properties": fields})
}

fn list(items: Value) -> Value {
    json!({"type": "array", "items": items})
}

fn text() -> Value {
    json!({"type": "string"})
}

fn bytes() -> Value {
    json!({"type": "string", "contentEncoding": "base64"})
}

fn number() -> Value {
    json!({"type": "number"})
}

fn whole() -> Value {
    json!({"type": "integer", "minimum": 0})
}

fn numbers(names: &[&str]) -> Value {
    object(names.iter().map(|name| ((*name).to_owned(), number())).collect())
}

fn time() -> Value {
    let mut time = object(json!({"sec": whole(), "nsec": whole()}));
    time["title"] = "time".into();
    time
}

fn pose() -> Value {
    object(json!({"position": numbers(&["x", "y", "z"]), "orientation": numbers(&["x", "y", "z", "w"])}))
}

/// Of the shapes of a scene only lines are used; the others are there because they are expected.
fn entity() -> Value {
    let color = numbers(&["r", "g", "b", "a"]);
    let lines = object(json!({
        "type": whole(), "pose": pose(), "thickness": number(), "scale_invariant": {"type": "boolean"},
        "points": list(numbers(&["x", "y", "z"])), "color": color, "colors": list(color.clone()),
        "indices": list(whole()),
    }));
    let unused = || list(object(json!({})));
    object(json!({
        "timestamp": time(), "frame_id": text(), "id": text(),
        "lifetime": object(json!({"sec": whole(), "nsec": whole()})), "frame_locked": {"type": "boolean"},
        "metadata": list(object(json!({"key": text(), "value": text()}))),
        "arrows": unused(), "cubes": unused(), "spheres": unused(), "cylinders": unused(), "lines": list(lines),
        "triangles": unused(), "texts": unused(), "models": unused(),
    }))
}

/// A time; there is none before zero.
pub(super) fn stamp(timestamp_ns: u64) -> Value {
    json!({"sec": timestamp_ns / 1_000_000_000, "nsec": timestamp_ns % 1_000_000_000})
}

fn position_fields([x, y, z]: [f64; 3]) -> Value {
    json!({"x": x, "y": y, "z": z})
}

fn pose_fields(pose: &Pose) -> Value {
    json!({
        "position": {"x": pose.tx, "y": pose.ty, "z": pose.tz},
        "orientation": {"x": pose.qx, "y": pose.qy, "z": pose.qz, "w": pose.qw},
    })
}

/// No motion.
fn origin() -> Value {
    json!({"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}})
}

/// Where a child frame is in its parent.
pub(super) fn frame_transform(timestamp_ns: u64, parent: &str, child: &str, pose: &Pose) -> Value {
    json!({
        "timestamp": stamp(timestamp_ns), "parent_frame_id": parent, "child_frame_id": child,
        "translation": {"x": pose.tx, "y": pose.ty, "z": pose.tz},
        "rotation": {"x": pose.qx, "y": pose.qy, "z": pose.qz, "w": pose.qw},
    })
}

/// A pose in a frame.
pub(super) fn pose_in_frame(timestamp_ns: u64, frame: &str, pose: &Pose) -> Value {
    json!({"timestamp": stamp(timestamp_ns), "frame_id": frame, "pose": pose_fields(pose)})
}

/// An image as a file.
pub(super) fn compressed_image(timestamp_ns: u64, frame: &str, format: &str, file: &[u8]) -> Value {
    json!({
        "timestamp": stamp(timestamp_ns), "frame_id": frame, "format": format, "data": STANDARD.encode(file),
    })
}

/// Points with their gray values, in the bytes that the message has.
#[derive(Default)]
pub(super) struct Cloud(Vec<u8>);

impl Cloud {
    /// Three numbers of four bytes, and a byte each of red, green, blue and opacity.
    const STRIDE: usize = 16;
    /// Foxglove's numbers for what a field is.
    const UINT8: u8 = 1;
    const FLOAT32: u8 = 7;

    pub(super) fn push(&mut self, position: [f64; 3], gray: u8) {
        position.iter().for_each(|length| self.0.extend((*length as f32).to_le_bytes()));
        self.0.extend([gray, gray, gray, u8::MAX]);
    }

    pub(super) fn message(&self, timestamp_ns: u64, frame: &str) -> Value {
        let field = |(idx, name): (usize, &str)| match idx {
            0..3 => json!({"name": name, "offset": 4 * idx, "type": Self::FLOAT32}),
            _ => json!({"name": name, "offset": 9 + idx, "type": Self::UINT8}),
        };
        let names = ["x", "y", "z", "red", "green", "blue", "alpha"];
        let fields: Vec<Value> = names.into_iter().enumerate().map(field).collect();
        json!({
            "timestamp": stamp(timestamp_ns), "frame_id": frame, "pose": origin(), "point_stride": Self::STRIDE,
            "fields": fields, "data": STANDARD.encode(&self.0),
        })
    }
}

/// Lines as a scene: pairs of ends with a color each.
#[derive(Default)]
pub(super) struct Lines {
    ends: Vec<Value>,
    colors: Vec<Value>,
}

impl Lines {
    /// Foxglove's number for lines between every two points.
    const LINE_LIST: u8 = 2;
    /// Pixels.
    const THICKNESS: f64 = 2.0;

    pub(super) fn push(&mut self, ends: [[f64; 3]; 2], color: Color) {
        let [r, g, b] = color.map(|part| f64::from(part) / 255.0);
        for end in ends {
            self.ends.push(position_fields(end));
            self.colors.push(json!({"r": r, "g": g, "b": b, "a": 1}));
        }
    }

    pub(super) fn message(self, timestamp_ns: u64, frame: &str) -> Value {
        let lines = json!({
            "type": Self::LINE_LIST, "pose": origin(), "thickness": Self::THICKNESS, "scale_invariant": true,
            "points": self.ends, "color": {"r": 1, "g": 1, "b": 1, "a": 1}, "colors": self.colors, "indices": [],
        });
        json!({
            "deletions": [],
            "entities": [{
                "timestamp": stamp(timestamp_ns), "frame_id": frame, "id": "lines",
                "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": true, "metadata": [], "arrows": [], "cubes": [],
                "spheres": [], "cylinders": [], "lines": [lines], "triangles": [], "texts": [], "models": [],
            }],
        })
    }
}

/// The calibration, by the names of ROS.
pub(super) fn camera_calibration(timestamp_ns: u64, frame: &str, camera: &CameraParameters) -> Value {
    let CameraParameters { model, width, height, fx, fy, cx, cy, distortion } = camera;
    let (name, n_coefficients) = match model {
        CameraModel::Pinhole => ("plumb_bob", 5),
        CameraModel::Radtan if distortion.len() <= 5 => ("plumb_bob", 5),
        CameraModel::Radtan => ("rational_polynomial", 8),
        CameraModel::KannalaBrandt => ("equidistant", 4),
        CameraModel::Fov => ("fov", 1),
        CameraModel::ExtendedUnified => ("eucm", 2),
        CameraModel::DoubleSphere => ("ds", 2),
    };
    let mut coefficients = distortion.clone();
    coefficients.resize(n_coefficients, 0.0);
    json!({
        "timestamp": stamp(timestamp_ns), "frame_id": frame, "width": width, "height": height,
        "distortion_model": name, "D": coefficients,
        "K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, 1],
        "P": [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cloud_has_a_row_of_bytes_for_each_point() {
        let mut cloud = Cloud::default();
        cloud.push([1.0, -2.0, 0.5], 7);
        let message = cloud.message(3_000_000_007, "map");
        assert_eq!(message["timestamp"], json!({"sec": 3, "nsec": 7}));
        let data = STANDARD.decode(message["data"].as_str().unwrap()).unwrap();
        assert_eq!(data.len(), Cloud::STRIDE);
        assert_eq!((&data[4..8], &data[12..]), (&(-2.0f32).to_le_bytes()[..], &[7, 7, 7, 255][..]));
        let offsets: Vec<&Value> =
            message["fields"].as_array().unwrap().iter().map(|field| &field["offset"]).collect();
        assert_eq!(offsets, [0, 4, 8, 12, 13, 14, 15]);
    }

    #[test]
    fn every_message_has_the_fields_of_its_schema() {
        let pose = Pose { tx: 0.0, ty: 0.0, tz: 0.0, qx: 0.0, qy: 0.0, qz: 0.0, qw: 1.0 };
        let camera = CameraParameters {
            model: CameraModel::Pinhole,
            width: 4,
            height: 3,
            fx: 1.0,
            fy: 1.0,
            cx: 1.0,
            cy: 1.0,
            distortion: Vec::new(),
        };
        for (schema, message) in [
            (Schema::CameraCalibration, camera_calibration(0, "c", &camera)),
            (Schema::CompressedImage, compressed_image(0, "c", "png", &[1])),
            (Schema::FrameTransform, frame_transform(0, "a", "b", &pose)),
            (Schema::PointCloud, Cloud::default().message(0, "c")),
            (Schema::PoseInFrame, pose_in_frame(0, "c", &pose)),
            (Schema::SceneUpdate, Lines::default().message(0, "c")),
        ] {
            let definition = schema.definition();
            let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
            assert_eq!(keys(&definition["properties"]), keys(&message), "{}", schema.name());
        }
    }
}
