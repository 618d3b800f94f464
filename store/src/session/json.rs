//! Cameras and options as JSON text. Map types do not know of it: these mirrors are written by hand.

use crate::StoreError;
use geometry::{CameraModel, CameraParameters};
use serde::{Deserialize, Serialize};

/// What the client asked a session to run with; what it left out takes the server's default each time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SessionOptions {
    /// Every stage runs in turn on one thread.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Seed of every random choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Features asked of the extractor per frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n_features: Option<u32>,
    /// Whether points are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<bool>,
    /// Whether lines are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lines: Option<bool>,
    /// Whether global primitives are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub global_primitives: Option<bool>,
    /// Whether loops are closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loop_closing: Option<bool>,
    /// Self-calibration: whether focal length and principal point are refined as the map grows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine_calibration: Option<bool>,
    /// Most keyframes the session keeps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_keyframes: Option<u32>,
    /// How far what was said of the camera is to be believed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
    /// Whether a calibration that the images contradict is given up for what they say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub give_up_calibration: Option<bool>,
    /// Whether what is not the scene is looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub find_mask: Option<bool>,
    /// Rolling shutter: from the first row of an image to the last, milliseconds; `None` where that is not
    /// known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub readout_ms: Option<f64>,
}

/// How far what was said of a camera is to be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Calibration {
    /// It was calibrated.
    Given,
    /// Its focal length is known roughly.
    Approximate,
    /// Nothing is known but the size of the image.
    Unknown,
}

#[derive(Serialize, Deserialize)]
struct CameraJson {
    model: String,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: Vec<f64>,
}

pub(super) fn encode_camera(camera: &CameraParameters) -> Result<String, StoreError> {
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
    if !numbers.iter().chain(&camera.distortion).all(|value| value.is_finite()) {
        return Err(StoreError::NotFinite("the camera".into()));
    }
    encode(&CameraJson {
        model: camera.model.name().to_owned(),
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
        distortion: camera.distortion.clone(),
    })
}

pub(crate) fn decode_camera(text: &str) -> Result<CameraParameters, StoreError> {
    let CameraJson { model, width, height, fx, fy, cx, cy, distortion } = decode("camera", text)?;
    let model = CameraModel::ALL
        .into_iter()
        .find(|known| known.name() == model)
        .ok_or_else(|| StoreError::Corrupt(format!("a camera is of the unknown model {model:?}")))?;
    Ok(CameraParameters { model, width, height, fx, fy, cx, cy, distortion })
}

pub(super) fn encode_options(options: &SessionOptions) -> Result<String, StoreError> {
    encode(options)
}

pub(super) fn decode_options(text: &str) -> Result<SessionOptions, StoreError> {
    decode("options", text)
}

fn encode(value: &impl Serialize) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::NotFinite(error.to_string()))
}

fn decode<T: for<'de> Deserialize<'de>>(what: &str, text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| StoreError::Corrupt(format!("{what}: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_camera_model_comes_back_bit_for_bit() {
        for (model, n) in CameraModel::ALL.into_iter().zip([0, 8, 4, 1, 2, 2]) {
            // Numbers whose shortest decimal form is long.
            let distortion: Vec<f64> = (0..n).map(|i| (f64::from(i) + 0.1).sqrt() / 30.0).collect();
            let (fx, fy, cx, cy) = (458.654 / 3.0, 1e-300, 0.1 + 0.2, f64::MAX);
            let camera = CameraParameters { model, width: 752, height: 480, fx, fy, cx, cy, distortion };
            assert_eq!(decode_camera(&encode_camera(&camera).unwrap()).unwrap(), camera);
        }
    }

    #[test]
    fn options_left_out_stay_left_out() {
        let options =
            SessionOptions { seed: Some(u64::MAX), lines: Some(false), ..SessionOptions::default() };
        let text = encode_options(&options).unwrap();
        assert_eq!(text, r#"{"seed":18446744073709551615,"lines":false}"#);
        assert_eq!(decode_options(&text).unwrap(), options);
        assert_eq!(decode_options("{}").unwrap(), SessionOptions::default());
    }

    #[test]
    fn nonsense_is_called_damaged() {
        assert!(matches!(decode_camera("{"), Err(StoreError::Corrupt(_))));
        let unknown = r#"{"model":"x","width":1,"height":1,"fx":1,"fy":1,"cx":0,"cy":0,"distortion":[]}"#;
        assert!(matches!(decode_camera(unknown), Err(StoreError::Corrupt(_))));
    }
}
