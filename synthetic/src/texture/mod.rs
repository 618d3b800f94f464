//! Paint: what the faces of a world look like close up.

mod canvas;
mod mip;
mod patterns;

pub(crate) use canvas::Canvas;
pub(crate) use mip::{Footprint, MipTexture};

/// What a surface is painted with. Albedos are shares of full white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Material {
    /// Even paint with a faint large-scale mottle: no corners.
    Paint {
        /// Mean albedo.
        albedo: f64,
    },
    /// Rough plaster: blotches and grains of every size, with specks and scratches.
    Plaster {
        /// Mean albedo.
        albedo: f64,
        /// Strength; 1 has corners everywhere, 0.2 is hardly visible.
        contrast: f64,
    },
    /// Paper strewn with small shapes.
    Wallpaper {
        /// Albedo of the ground.
        albedo: f64,
    },
    /// Bricks of varied tone in lighter mortar.
    Bricks {
        /// Mean albedo of the bricks.
        albedo: f64,
    },
    /// Boards with grain and knots, along the longer side.
    Planks {
        /// Mean albedo.
        albedo: f64,
    },
    /// Square tiles with joints.
    Tiles {
        /// Mean albedo.
        albedo: f64,
        /// Distance between joints.
        pitch: f64,
    },
    /// A busy print: overlapping shapes and bars.
    Print,
    /// A picture of hills under a sky: a few soft edges.
    Landscape,
    /// A printed page: rows of marks like writing, and a heading.
    Text,
    /// A row of upright book spines.
    Books,
    /// A bright, nearly even window pane.
    Sky,
}
