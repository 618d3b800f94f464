//! Renders a world as a camera sees it.
//!
//! Visibility is decided per tile of the image: the faces that a tile's cone of rays can meet are found once,
//! and rays are cast at the corners of pixels against these few. A pixel whose four corners see the same face
//! is shaded once, with a filtered look-up in the face's texture; any other pixel is split into sub-samples.
//! All rays come from the camera model, so lens distortion costs nothing.

mod lighting;
mod options;
mod rays;
mod sensor;
mod shading;
mod visibility;

use std::sync::{Arc, OnceLock};

use geometry::{Camera, Pose};

pub use options::{ExposureCurve, RenderOptions};

use crate::image::GrayImage;
use crate::random::stream;
use crate::texture::MipTexture;
use crate::world::{RayHit, World};
use rays::RayTable;
use sensor::Sensor;
use shading::shade_band;
use visibility::FrameFaces;

/// Rows of a rolling shutter that are rendered from one pose: at 60 degrees a second and a readout of 30 ms
/// the next ones are a sixteenth of a pixel away.
const ROWS_READ_AT_ONCE: usize = 2;

/// A camera in a world. Textures are painted when they are first seen and kept.
pub struct Renderer {
    world: Arc<World>,
    camera: Camera,
    options: RenderOptions,
    rays: RayTable,
    sensor: Sensor,
    textures: Vec<OnceLock<MipTexture>>,
}

impl Renderer {
    /// Prepares the tables for `camera`.
    pub fn new(world: Arc<World>, camera: Camera, options: RenderOptions) -> Self {
        let rays = RayTable::new(&camera);
        let sensor = Sensor::new(&camera, &options);
        let textures = world.surfaces().iter().map(|_| OnceLock::new()).collect();
        Self { world, camera, options, rays, sensor, textures }
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The options.
    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// The image of an exposure during which the camera takes the poses `camera_from_world` in turn; one pose
    /// gives an image without motion blur. `t_s` is the time on the exposure curve, `noise_seed` the seed of
    /// the sensor's noise.
    ///
    /// # Panics
    /// If there is no pose.
    pub fn render(&self, camera_from_world: &[Pose], t_s: f64, noise_seed: u64) -> GrayImage {
        let mut radiance = self.blank();
        self.add_exposure(camera_from_world, 0, &mut radiance);
        self.sensed(&radiance, t_s, noise_seed)
    }

    /// The image of a rolling shutter: `camera_from_world` gives the poses that the camera takes while a row
    /// is exposed, by when that row is read, as a share of the readout before (down to -0.5) or after (up to
    /// 0.5) the middle row.
    ///
    /// # Panics
    /// If there is no pose.
    pub fn render_rolling(
        &self,
        camera_from_world: impl Fn(f64) -> Vec<Pose>,
        t_s: f64,
        noise_seed: u64,
    ) -> GrayImage {
        let (width, height) = (self.camera.width() as usize, f64::from(self.camera.height()));
        let mut radiance = self.blank();
        for (i, band) in radiance.chunks_mut(ROWS_READ_AT_ONCE * width).enumerate() {
            let first_row = i * ROWS_READ_AT_ONCE;
            let middle_row = first_row as f64 + (band.len() / width - 1) as f64 / 2.0;
            self.add_exposure(&camera_from_world((middle_row + 0.5) / height - 0.5), first_row, band);
        }
        self.sensed(&radiance, t_s, noise_seed)
    }

    fn sensed(&self, radiance: &[f32], t_s: f64, noise_seed: u64) -> GrayImage {
        let pixels = self.sensor.expose(radiance, self.options.exposure.gain(t_s), noise_seed);
        GrayImage::new(self.camera.width(), self.camera.height(), pixels)
    }

    fn blank(&self) -> Vec<f32> {
        vec![0.0; self.camera.width() as usize * self.camera.height() as usize]
    }

    /// Adds the mean of what the poses show in whole rows from `first_row` on.
    fn add_exposure(&self, camera_from_world: &[Pose], first_row: usize, rows: &mut [f32]) {
        assert!(!camera_from_world.is_empty(), "an exposure needs a pose");
        let share = 1.0 / camera_from_world.len() as f32;
        for pose in camera_from_world {
            let shown = self.radiance(pose, first_row, rows.len());
            for (sum, value) in rows.iter_mut().zip(shown) {
                *sum += share * value;
            }
        }
    }

    /// Gray level of the painted and lit surface at a hit, before the sensor, as a close view shows it.
    pub fn surface_gray(&self, hit: &RayHit) -> f64 {
        let texel = self.options.texel;
        let (u, v) = ((hit.uv.x / texel) as f32, (hit.uv.y / texel) as f32);
        let footprint = crate::texture::Footprint::new([1.0, 0.0, 0.0, 1.0]);
        f64::from(self.texture(hit.surface).sample(&[u], &[v], &footprint)[0])
    }

    /// Noise-free gray levels of so many pixels, row-major from `first_row` on.
    fn radiance(&self, camera_from_world: &Pose, first_row: usize, n_pixels: usize) -> Vec<f32> {
        let width = self.camera.width() as usize;
        let faces = FrameFaces::new(&self.world, camera_from_world, self.options.texel);
        let mut pixels = vec![0.0; n_pixels];
        let n_rows = n_pixels / width;
        if self.options.threads <= 1 || n_rows <= ROWS_READ_AT_ONCE {
            shade_band(self, &faces, first_row, &mut pixels);
            return pixels;
        }
        let rows_per_band = n_rows.div_ceil(self.options.threads);
        std::thread::scope(|scope| {
            for (i, band) in pixels.chunks_mut(rows_per_band * width).enumerate() {
                let faces = &faces;
                scope.spawn(move || shade_band(self, faces, first_row + i * rows_per_band, band));
            }
        });
        pixels
    }

    fn texture(&self, surface: usize) -> &MipTexture {
        self.textures[surface].get_or_init(|| self.paint(surface))
    }

    /// Paint times light, as gray levels. Dither keeps smooth gradients free of steps.
    fn paint(&self, index: usize) -> MipTexture {
        let surface = &self.world.surfaces()[index];
        let mut rng = stream(surface.seed, "paint");
        let canvas = surface.material.paint((surface.size.x, surface.size.y), self.options.texel, &mut rng);
        let light = lighting::LightMap::new(&self.world, surface);
        MipTexture::new(canvas.width, &light.lit(&canvas, &mut rng))
    }
}
