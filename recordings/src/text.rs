//! Bytes of a text file to text, as the editors of all systems write it.

/// The text of a file in UTF-8 or UTF-16, without a mark of the byte order.
///
/// # Errors
/// The line, counted from one, and a sentence.
pub(crate) fn decode(bytes: Vec<u8>) -> Result<String, (usize, String)> {
    match &bytes[..] {
        [0xFF, 0xFE, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, u16::from_be_bytes),
        // Text in ASCII that is written in two bytes each.
        [first, 0, second, 0, ..] if *first != 0 && *second != 0 => utf16(&bytes, u16::from_le_bytes),
        [0, first, 0, second, ..] if *first != 0 && *second != 0 => utf16(&bytes, u16::from_be_bytes),
        [0xEF, 0xBB, 0xBF, rest @ ..] => utf8(rest.to_vec()),
        _ => utf8(bytes),
    }
}

fn utf8(bytes: Vec<u8>) -> Result<String, (usize, String)> {
    String::from_utf8(bytes).map_err(|error| {
        let good = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        (
            1 + good.iter().filter(|byte| **byte == b'\n').count(),
            "this is not UTF-8; save the file as UTF-8".to_owned(),
        )
    })
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<String, (usize, String)> {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    let mut text = String::with_capacity(bytes.len() / 2);
    for decoded in char::decode_utf16(units) {
        match decoded {
            Ok(c) => text.push(c),
            Err(_) => {
                let line = 1 + text.matches('\n').count();
                return Err((line, "this is damaged UTF-16; save the file as UTF-8".to_owned()));
            }
        }
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_editors_write_is_read() {
        let wide =
            |text: &str, bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
        for text in ["1.5 a.png\r\n", "1.5 bä.png"] {
            let with_mark = |text: &str| format!("\u{FEFF}{text}");
            assert_eq!(decode(text.into()).as_deref(), Ok(text));
            assert_eq!(decode(with_mark(text).into()).as_deref(), Ok(text));
            assert_eq!(decode(wide(&with_mark(text), u16::to_le_bytes)).as_deref(), Ok(text));
            assert_eq!(decode(wide(&with_mark(text), u16::to_be_bytes)).as_deref(), Ok(text));
            assert_eq!(decode(wide(text, u16::to_le_bytes)).as_deref(), Ok(text));
            assert_eq!(decode(wide(text, u16::to_be_bytes)).as_deref(), Ok(text));
        }
        assert_eq!(decode(Vec::new()).as_deref(), Ok(""));
    }

    #[test]
    fn what_is_no_text_is_refused_by_its_line() {
        assert_eq!(decode(b"1 a.png\n2 b\xE4.png\n".to_vec()).unwrap_err().0, 2);
        assert_eq!(decode(b"\xFF\xFEa\0\n\0\0\xD8a\0".to_vec()).unwrap_err().0, 2);
    }
}
