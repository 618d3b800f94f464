//! The 8-bit gray image everything in this crate works on.

/// An 8-bit gray image, row-major and tight (no padding between rows).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GrayImage {
    width: u32,
    height: u32,
    data: Vec<u8>,
}

/// Why pixels could not be made into a [`GrayImage`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The buffer does not hold exactly `width * height` bytes.
    #[error("a {width}x{height} grey image needs {expected} bytes, but {actual} were given")]
    WrongLength {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Bytes needed.
        expected: u64,
        /// Bytes given.
        actual: u64,
    },
}

impl GrayImage {
    /// A black image of the given size, pixels. Either side may be 0.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, data: vec![0; width as usize * height as usize] }
    }

    /// Takes over `data`, which must hold `width * height` bytes, row by row.
    pub fn from_raw(width: u32, height: u32, data: Vec<u8>) -> Result<Self, ImageError> {
        let expected = u64::from(width) * u64::from(height);
        let actual = data.len() as u64;
        if expected != actual {
            return Err(ImageError::WrongLength { width, height, expected, actual });
        }
        Ok(Self { width, height, data })
    }

    /// An image whose pixel at column `x`, row `y` is `f(x, y)`.
    pub fn from_fn(width: u32, height: u32, mut f: impl FnMut(u32, u32) -> u8) -> Self {
        let mut data = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            data.extend((0..width).map(|x| f(x, y)));
        }
        Self { width, height, data }
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Whether the image has no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// Row `y`, from left to right. Panics if `y >= height`.
    pub fn row(&self, y: u32) -> &[u8] {
        let width = self.width as usize;
        &self.data[y as usize * width..][..width]
    }

    /// Row `y`, writable. Panics if `y >= height`.
    pub fn row_mut(&mut self, y: u32) -> &mut [u8] {
        let width = self.width as usize;
        &mut self.data[y as usize * width..][..width]
    }

    /// The pixel at column `x`, row `y`, or `None` outside the image.
    pub fn get(&self, x: u32, y: u32) -> Option<u8> {
        (x < self.width && y < self.height).then(|| self.row(y)[x as usize])
    }

    /// Sets the pixel at column `x`, row `y`; outside the image nothing happens.
    pub fn set(&mut self, x: u32, y: u32, value: u8) {
        if x < self.width && y < self.height {
            self.row_mut(y)[x as usize] = value;
        }
    }

    /// All pixels, row by row.
    pub fn as_raw(&self) -> &[u8] {
        &self.data
    }

    /// All pixels, row by row, writable.
    pub fn as_raw_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }

    /// Gives the pixel buffer back.
    pub fn into_raw(self) -> Vec<u8> {
        self.data
    }

    /// Changes the size, keeping the buffer where it is large enough. The content is unspecified afterwards.
    pub(crate) fn reshape(&mut self, width: u32, height: u32) {
        self.width = width;
        self.height = height;
        self.data.resize(width as usize * height as usize, 0);
    }

    /// Brightness and sharpness of the whole image.
    pub fn statistics(&self) -> ImageStatistics {
        ImageStatistics::of(self)
    }
}

/// Brightness and sharpness of an image, to notice blur and changes of exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageStatistics {
    /// Mean gray level, 0 to 255; 0 for an empty image.
    pub mean: f64,
    /// Mean of `(I(x+1,y) - I(x,y))^2 + (I(x,y+1) - I(x,y))^2`, squared gray levels: falls when the image is
    /// blurred.
    pub gradient_energy: f64,
}

impl ImageStatistics {
    /// Measures `image`.
    pub fn of(image: &GrayImage) -> Self {
        let (width, height) = (image.width(), image.height());
        if image.is_empty() {
            return Self { mean: 0.0, gradient_energy: 0.0 };
        }
        let squared = |a: u8, b: u8| {
            let difference = i32::from(a) - i32::from(b);
            (difference * difference) as u32
        };
        let mut sum = 0u64;
        let mut energy = 0u64;
        for y in 0..height {
            let row = image.row(y);
            let below = image.row((y + 1).min(height - 1));
            sum += row.iter().map(|&p| u64::from(p)).sum::<u64>();
            // One row holds at most 2^16 pixels in practice; chunks keep the 32-bit sums safe for any width.
            for (row, below) in row.chunks(1 << 15).zip(below.chunks(1 << 15)) {
                energy += u64::from(row.windows(2).map(|p| squared(p[0], p[1])).sum::<u32>());
                energy += u64::from(row.iter().zip(below).map(|(&a, &b)| squared(a, b)).sum::<u32>());
            }
        }
        let n = f64::from(width) * f64::from(height);
        Self { mean: sum as f64 / n, gradient_energy: energy as f64 / n }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_raw_refuses_a_wrong_length() {
        assert!(GrayImage::from_raw(4, 3, vec![0; 12]).is_ok());
        let error = GrayImage::from_raw(4, 3, vec![0; 11]).unwrap_err();
        assert_eq!(error, ImageError::WrongLength { width: 4, height: 3, expected: 12, actual: 11 });
        assert!(GrayImage::from_raw(u32::MAX, u32::MAX, vec![0; 1]).is_err());
    }

    #[test]
    fn pixels_are_addressed_by_column_and_row() {
        let mut image = GrayImage::from_fn(5, 4, |x, y| (10 * y + x) as u8);
        assert_eq!(image.get(3, 2), Some(23));
        assert_eq!(image.row(1), &[10, 11, 12, 13, 14]);
        assert_eq!(image.get(5, 0), None);
        assert_eq!(image.get(0, 4), None);
        image.set(3, 2, 99);
        image.set(5, 0, 99);
        assert_eq!(image.as_raw().iter().filter(|&&p| p == 99).count(), 1);
    }

    #[test]
    fn statistics_measure_brightness_and_sharpness() {
        assert_eq!(GrayImage::new(0, 0).statistics(), ImageStatistics { mean: 0.0, gradient_energy: 0.0 });
        let plain = GrayImage::from_fn(8, 8, |_, _| 77).statistics();
        assert_eq!((plain.mean, plain.gradient_energy), (77.0, 0.0));
        // A step of 10 between columns 3 and 4: one of 8 columns has squared difference 100.
        let step = GrayImage::from_fn(8, 8, |x, _| if x < 4 { 0 } else { 10 }).statistics();
        assert_eq!((step.mean, step.gradient_energy), (5.0, 100.0 / 8.0));
    }
}
