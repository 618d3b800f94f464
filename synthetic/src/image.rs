//! The gray image that the renderer returns.

/// An 8-bit gray image, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl GrayImage {
    /// Wraps `width * height` pixels, row-major.
    ///
    /// # Panics
    /// If the number of pixels is another one.
    pub fn new(width: u32, height: u32, pixels: Vec<u8>) -> Self {
        assert_eq!(pixels.len(), width as usize * height as usize, "pixels must fill the image");
        Self { width, height, pixels }
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The pixels, row-major.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The pixels, row-major, without a copy.
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Gray level at column `x`, row `y`.
    ///
    /// # Panics
    /// Outside of the image.
    pub fn get(&self, x: u32, y: u32) -> u8 {
        assert!(x < self.width && y < self.height, "pixel ({x}, {y}) is outside of the image");
        self.pixels[(y * self.width + x) as usize]
    }

    /// Bilinear gray level at a real position; `None` outside of the pixel centers.
    pub fn sample(&self, x: f64, y: f64) -> Option<f64> {
        let inside =
            x >= 0.0 && y >= 0.0 && x < f64::from(self.width) - 1.0 && y < f64::from(self.height) - 1.0;
        inside.then(|| {
            let (x0, y0) = (x as u32, y as u32);
            let (fx, fy) = (x - f64::from(x0), y - f64::from(y0));
            let at = |dx, dy| f64::from(self.get(x0 + dx, y0 + dy));
            (at(0, 0) * (1.0 - fx) + at(1, 0) * fx) * (1.0 - fy)
                + (at(0, 1) * (1.0 - fx) + at(1, 1) * fx) * fy
        })
    }
}
