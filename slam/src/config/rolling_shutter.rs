//! Rolling shutter.

/// Rolling shutter: the rows of an image are read one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RollingShutterConfig {
    /// Time from the first row to the last, nanoseconds. Default 0, a global shutter: how long a camera takes
    /// cannot be told from its size, and phones take 8 to 35 ms.
    pub readout_ns: i64,
}
