//! The server's sentences name fields of its interfaces; whoever reads them here has flags.

/// Words of the interfaces, and the flags that set them.
const FLAGS: [(&str, &str); 7] = [
    ("set take_over to end its stream", "--take-over ends its stream"),
    ("leave out lines = false, or set this to false too", "leave out --no-lines, or add --no-primitives"),
    ("options.global_primitives", "--no-primitives"),
    ("options.n_features", "--n-features"),
    ("options.lines", "--no-lines"),
    ("options.loop_closing", "--no-loops"),
    ("options.refine_calibration", "--no-calibration"),
];

/// The sentence with flags for fields.
pub fn in_flags(sentence: &str) -> String {
    FLAGS.iter().fold(sentence.to_owned(), |sentence, (field, flag)| sentence.replace(field, flag))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_become_flags() {
        let refused = "another client streams into session a; set take_over to end its stream";
        assert_eq!(in_flags(refused), "another client streams into session a; --take-over ends its stream");
        assert_eq!(in_flags("options.n_features: must be"), "--n-features: must be");
    }
}
