//! Reading packed values without trusting them.

use super::BlobError;

/// What is left to read of a blob.
pub(super) struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    /// The next `n` bytes.
    pub fn bytes(&mut self, n: usize) -> Result<&'a [u8], BlobError> {
        let (head, rest) = self
            .0
            .split_at_checked(n)
            .ok_or_else(|| BlobError(format!("{n} more bytes expected, {} found", self.0.len())))?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], BlobError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    pub fn u8(&mut self) -> Result<u8, BlobError> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub fn u32(&mut self) -> Result<u32, BlobError> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Result<u64, BlobError> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn f32(&mut self) -> Result<f32, BlobError> {
        self.array().map(f32::from_le_bytes)
    }

    pub fn f64(&mut self) -> Result<f64, BlobError> {
        self.array().map(f64::from_le_bytes)
    }

    /// An unsigned LEB128 number: seven bits a byte, the least first.
    pub fn varint(&mut self) -> Result<u64, BlobError> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.u8()?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                break;
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(BlobError("a number of more than 64 bits".into()))
    }

    /// Ends the reading.
    pub fn finish(self) -> Result<(), BlobError> {
        if self.0.is_empty() { Ok(()) } else { Err(BlobError(format!("{} bytes too many", self.0.len()))) }
    }
}

/// Appends an unsigned LEB128 number.
pub(super) fn push_varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn varints_come_back_and_overlong_ones_are_refused() {
        for value in [0, 1, 127, 128, 300, u64::from(u32::MAX), u64::MAX] {
            let mut bytes = Vec::new();
            push_varint(&mut bytes, value);
            let mut reader = Reader(&bytes);
            assert_eq!(reader.varint(), Ok(value));
            assert!(reader.finish().is_ok());
        }
        assert!(Reader(&[0xff; 10]).varint().is_err());
        assert!(Reader(&[0xff; 3]).varint().is_err());
    }
}
