//! The fields of a ROS message, one after the other: as ROS 1 writes them, or in the common data
//! representation (CDR) of ROS 2, in which a number begins at a multiple of its size.

/// Longest text in a message, bytes; they are names.
const MAX_TEXT: usize = 4096;

/// How a message is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ros1,
    /// Behind four bytes that say so.
    Cdr {
        is_big_endian: bool,
    },
}

impl Encoding {
    /// What the first bytes of a message say.
    pub(super) fn of_cdr(data: &[u8]) -> Result<Self, String> {
        match data {
            [0, 0, _, _, ..] => Ok(Self::Cdr { is_big_endian: true }),
            [0, 1, _, _, ..] => Ok(Self::Cdr { is_big_endian: false }),
            [a, b, _, _, ..] => Err(format!("it is encoded as {a:02x}{b:02x}, not as plain CDR")),
            _ => Err(TOO_SHORT.to_owned()),
        }
    }
}

const TOO_SHORT: &str = "it is shorter than its fields";

/// Reads the fields of a message.
pub(super) struct Fields<'a> {
    data: &'a [u8],
    place: usize,
    encoding: Encoding,
}

impl<'a> Fields<'a> {
    pub(super) fn of(data: &'a [u8], encoding: Encoding) -> Self {
        // Places count from behind the bytes that tell the encoding.
        let data = if encoding == Encoding::Ros1 { data } else { data.get(4..).unwrap_or_default() };
        Self { data, place: 0, encoding }
    }

    pub(super) fn u8(&mut self) -> Result<u8, String> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        let bytes = self.number::<4>()?;
        Ok(if self.is_big_endian() { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    pub(super) fn f64(&mut self) -> Result<f64, String> {
        let bytes = self.number::<8>()?;
        Ok(if self.is_big_endian() { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) })
    }

    pub(super) fn text(&mut self) -> Result<&'a str, String> {
        let length = self.length()?;
        if length > MAX_TEXT {
            return Err(format!("a text of {length} bytes is too long for a name"));
        }
        let bytes = self.take(length)?;
        // In CDR the zero byte at the end counts.
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| "a text is not UTF-8".to_owned())
    }

    /// Bytes behind their number.
    pub(super) fn bytes(&mut self) -> Result<&'a [u8], String> {
        let length = self.length()?;
        self.take(length)
    }

    /// Numbers behind how many there are, at most `max`.
    pub(super) fn numbers(&mut self, max: usize) -> Result<Vec<f64>, String> {
        let n = self.length()?;
        if n > max {
            return Err(format!("it has {n} coefficients where at most {max} are expected"));
        }
        (0..n).map(|_| self.f64()).collect()
    }

    fn length(&mut self) -> Result<usize, String> {
        usize::try_from(self.u32()?).map_err(|_| TOO_SHORT.to_owned())
    }

    fn is_big_endian(&self) -> bool {
        self.encoding == Encoding::Cdr { is_big_endian: true }
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        if self.encoding != Encoding::Ros1 {
            self.place = self.place.next_multiple_of(N);
        }
        self.take(N)?.try_into().map_err(|_| TOO_SHORT.to_owned())
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let end = self.place.checked_add(n).ok_or(TOO_SHORT)?;
        let bytes = self.data.get(self.place..end).ok_or(TOO_SHORT)?;
        self.place = end;
        Ok(bytes)
    }
}

/// What a message's header says of its time; zero if it was not set.
pub(super) fn header_time_ns(fields: &mut Fields<'_>) -> Result<i64, String> {
    if fields.encoding == Encoding::Ros1 {
        // The sequence number.
        fields.u32()?;
    }
    let seconds = i64::from(fields.u32()?);
    let nanoseconds = i64::from(fields.u32()?);
    fields.text()?;
    Ok(1_000_000_000 * seconds + nanoseconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_multiples_of_their_size_in_cdr_only() {
        let data = [0, 1, 0, 0, 7, 0, 0, 0, 5, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 9];
        let mut fields = Fields::of(&data, Encoding::of_cdr(&data).unwrap());
        assert_eq!((fields.u8(), fields.u32()), (Ok(7), Ok(5)));
        assert_eq!((fields.text(), fields.u8()), (Ok("ab"), Ok(9)));
        assert_eq!(fields.u8(), Err(TOO_SHORT.to_owned()));
        let data = [7, 5, 0, 0, 0, 2, 0, 0, 0, b'a', b'b'];
        let mut fields = Fields::of(&data, Encoding::Ros1);
        assert_eq!((fields.u8(), fields.u32(), fields.text()), (Ok(7), Ok(5), Ok("ab")));
        let data = [0, 0, 0, 0, 0, 0, 1, 2];
        assert_eq!(Fields::of(&data, Encoding::of_cdr(&data).unwrap()).u32(), Ok(258));
    }

    #[test]
    fn lengths_that_cannot_be_are_refused() {
        let data = [0xff, 0xff, 0xff, 0xff, 1, 2];
        let fields = || Fields::of(&data, Encoding::Ros1);
        assert!(fields().text().is_err() && fields().bytes().is_err() && fields().numbers(8).is_err());
        assert!(Encoding::of_cdr(&[0, 7, 0, 0]).unwrap_err().contains("0007"));
        assert!(Encoding::of_cdr(&[0]).is_err());
    }
}
