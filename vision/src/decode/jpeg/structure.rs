//! What a JPEG file says of itself, and whether it ends where it should.
//!
//! Segments are skipped by their length, so that what metadata carry, such as a thumbnail with an end of its
//! own, is not taken for the image's.

/// A JPEG file as far as its markers tell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Structure {
    /// The frame, from the first header of one.
    pub frame: Option<Frame>,
    /// Whether there are Huffman tables.
    pub has_huffman_tables: bool,
    /// What Adobe's segment says of the colors: 0 none, 1 YCbCr, 2 YCCK.
    pub adobe_transform: Option<u8>,
    /// Whether a scan begins.
    pub has_scan: bool,
    /// Whether the first scan has all components.
    pub is_in_one_scan: bool,
    /// For each component of a progressive file, which bit of each coefficient is the last that came.
    precision: Vec<[u8; N_COEFFICIENTS]>,
    /// How it ends.
    pub end: End,
    /// Where it ends: at the marker of its end, at the next file's beginning, or with the bytes.
    pub end_at: usize,
}

/// How a file ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum End {
    /// Inside a segment, or before the first scan.
    #[default]
    CutOff,
    /// Inside a scan, or right behind one.
    NoMarker,
    /// With the marker of its end.
    Marked,
}

/// A header of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Frame {
    /// The kind of compression, the marker's second byte.
    pub kind: u8,
    /// Bits a sample.
    pub n_bits: u8,
    /// Width, pixels.
    pub width: u16,
    /// Height, pixels.
    pub height: u16,
    /// Names of the components.
    pub components: Vec<u8>,
    /// Their sampling factors, across in the upper four bits and down in the lower.
    pub sampling: Vec<u8>,
}

impl Frame {
    /// Whether the decoder reads more blocks than there are, to no harm: some components have twice as many
    /// rows as others and all the same columns, or all have the same factors and these are not one. `ffmpeg`
    /// writes gray and full color so.
    pub fn is_read_beyond_its_end(&self) -> bool {
        let is_narrow = self.sampling.iter().all(|factors| factors >> 4 == 1);
        let is_tall = self.sampling.contains(&0x12);
        let first = self.sampling.first().copied().unwrap_or(0x11);
        let is_alike = first != 0x11 && self.sampling.iter().all(|factors| *factors == first);
        self.sampling.len() > 1 && (is_narrow && is_tall || is_alike)
    }

    /// Factors, across and down, that the decoder takes for others.
    pub fn misread_sampling(&self) -> Option<(u8, u8)> {
        let factors = self.sampling.iter().map(|factors| (factors >> 4, factors & 0xF));
        factors
            .filter(|_| self.sampling.len() > 1)
            .find(|(across, down)| *down > 2 || *across > 2 && *down > 1)
    }
}

const N_COEFFICIENTS: usize = 64;

/// A coefficient of which nothing came.
const NOTHING: u8 = u8::MAX;

const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;
const DHT: u8 = 0xC4;
const DAC: u8 = 0xCC;
const JPG: u8 = 0xC8;
const APP14: u8 = 0xEE;
const TEM: u8 = 0x01;

/// Progressive, by Huffman codes.
pub(super) const PROGRESSIVE: u8 = 0xC2;

impl Structure {
    /// Reads the markers of a file that begins with the marker of an image, up to its first scan.
    pub fn head_of(data: &[u8]) -> Self {
        Self::read(data, true)
    }

    /// Reads all markers of a file that begins with the marker of an image.
    pub fn of(data: &[u8]) -> Self {
        Self::read(data, false)
    }

    fn read(data: &[u8], stops_at_scan: bool) -> Self {
        let mut structure = Self { end_at: data.len(), ..Self::default() };
        let mut at = 2;
        while let Some(marker) = next_marker(data, &mut at) {
            match marker {
                EOI => {
                    structure.end = if structure.has_scan { End::Marked } else { End::CutOff };
                    structure.end_at = at - 2;
                    return structure;
                }
                // The next image of a stream begins in the middle of this one.
                SOI => {
                    structure.end_at = at - 2;
                    return structure;
                }
                TEM | 0xD0..=0xD7 => continue,
                _ => {}
            }
            structure.end = End::CutOff;
            let Some(segment) = segment(data, &mut at) else { return structure };
            structure.note(marker, segment);
            if marker == SOS {
                if stops_at_scan {
                    return structure;
                }
                structure.has_scan = true;
                structure.end = End::NoMarker;
                at = end_of_scan(data, at);
            }
        }
        structure
    }

    fn note(&mut self, marker: u8, segment: &[u8]) {
        match (marker, segment) {
            (DHT, _) => self.has_huffman_tables = true,
            (APP14, [b'A', b'd', b'o', b'b', b'e', _, _, _, _, _, _, transform, ..]) => {
                self.adobe_transform = Some(*transform);
            }
            (SOS, _) => self.note_scan(segment),
            (DAC | JPG, _) => {}
            (0xC0..=0xCF, [n_bits, h0, h1, w0, w1, n, components @ ..]) if self.frame.is_none() => {
                let described = || components.chunks_exact(3).take(usize::from(*n));
                let sampling = described().map(|component| component[1]).collect();
                let components: Vec<u8> = described().map(|component| component[0]).collect();
                self.precision = vec![[NOTHING; N_COEFFICIENTS]; components.len()];
                let (height, width) = (u16::from_be_bytes([*h0, *h1]), u16::from_be_bytes([*w0, *w1]));
                self.frame =
                    Some(Frame { kind: marker, n_bits: *n_bits, width, height, components, sampling });
            }
            _ => {}
        }
    }

    /// Takes note of which coefficients a scan brings, to which bit.
    fn note_scan(&mut self, segment: &[u8]) {
        let Some(frame) = &self.frame else { return };
        let Some((n, rest)) = segment.split_first() else { return };
        self.is_in_one_scan |= usize::from(*n) == frame.components.len();
        let n_bytes = 2 * usize::from(*n);
        let (Some(names), Some([first, last, bits])) =
            (rest.get(..n_bytes), rest.get(n_bytes..).and_then(|tail| tail.first_chunk()))
        else {
            return;
        };
        for name in names.iter().step_by(2) {
            let Some(place) = frame.components.iter().position(|component| component == name) else {
                continue;
            };
            let coefficients = usize::from(*first)..=usize::from(*last);
            for (_, bit) in
                self.precision[place].iter_mut().enumerate().filter(|(i, _)| coefficients.contains(i))
            {
                *bit = bits & 0x0F;
            }
        }
    }

    /// Whether the scans that began bring every coefficient to its last bit.
    pub fn has_every_scan(&self) -> bool {
        let is_progressive = self.frame.as_ref().is_some_and(|frame| frame.kind == PROGRESSIVE);
        if is_progressive {
            return self.precision.iter().flatten().all(|bit| *bit == 0);
        }
        self.precision.iter().all(|component| component[0] != NOTHING)
    }
}

/// The first byte that may begin a marker.
fn find_mark(bytes: &[u8]) -> Option<usize> {
    bytes.iter().position(|byte| *byte == 0xFF)
}

/// The next marker at or behind `at`, which is moved behind it.
fn next_marker(data: &[u8], at: &mut usize) -> Option<u8> {
    loop {
        *at += find_mark(data.get(*at..)?)?;
        // Any number of fill bytes may come before a marker.
        while *data.get(*at)? == 0xFF {
            *at += 1;
        }
        let marker = data[*at];
        *at += 1;
        if marker != 0 {
            return Some(marker);
        }
    }
}

/// The content of the segment at `at`, which is moved behind it.
fn segment<'a>(data: &'a [u8], at: &mut usize) -> Option<&'a [u8]> {
    let length = data.get(*at..)?.first_chunk().map(|bytes| usize::from(u16::from_be_bytes(*bytes)))?;
    let segment = data.get(*at + 2..*at + length)?;
    *at += length;
    Some(segment)
}

/// Where the marker behind the scan at `at` is, or the end of the file.
fn end_of_scan(data: &[u8], mut at: usize) -> usize {
    while let Some(found) = data.get(at..).and_then(find_mark) {
        match data.get(at + found + 1) {
            // A byte of the scan, a restart, or a fill byte.
            Some(0x00 | 0xD0..=0xD7) => at += found + 2,
            Some(0xFF) => at += found + 1,
            _ => return at + found,
        }
    }
    data.len()
}
